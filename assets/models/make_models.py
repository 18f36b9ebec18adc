"""Makes the bundled models with stock OpenVDB (Debian: python3-openvdb, python3-numpy).

use: /usr/bin/python3 make_models.py TEAPOT.obj[.gz]
"""

import gzip
import os
import sys

import numpy as np
import pyopenvdb as vdb

HERE = os.path.dirname(os.path.abspath(__file__))


def save(file, grid, name):
    grid.name = name
    grid.saveFloatAsHalf = True
    path = os.path.join(HERE, file)
    vdb.write(path, grids=[grid])
    low, high = grid.evalActiveVoxelBoundingBox()
    size = [b - a + 1 for a, b in zip(low, high)]
    print(file, size, grid.activeVoxelCount(), "active voxels,", os.path.getsize(path), "bytes")


def read_obj(path):
    """Points and triangles; polygons are cut into fans."""
    points, triangles = [], []
    with (gzip.open if path.endswith(".gz") else open)(path, "rt", errors="replace") as lines:
        for line in lines:
            words = line.split()
            if words[:1] == ["v"]:
                points.append([float(x) for x in words[1:4]])
            elif words[:1] == ["f"]:
                corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
                triangles += [[corners[0], b, c] for b, c in zip(corners[1:], corners[2:])]
    return np.array(points, np.float32), np.array(triangles, np.uint32)


def weld(points, triangles):
    """One point for all that lie at the same place; triangles without area are dropped."""
    points, index = np.unique(points.round(5) + 0.0, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles.astype(int)]
    flat = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    return points, triangles[~flat]


def rounded(points, triangles, parts=5, strength=0.75):
    """Cuts each triangle in parts² and bends them as the normals at its corners say (Phong
    tessellation, Boubekeur and Alexa 2008): the facets of the mesh are larger than voxels."""
    points, triangles = weld(points.astype(float), triangles)
    corners = points[triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, triangles[:, k], faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    n = normals[triangles]
    row = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    weights = np.array([[parts - i - j, i, j] for i, j in row]) / parts
    flat = np.einsum("wk,tkx->twx", weights, corners)
    # Onto the plane through each corner, and the mean of the three.
    above = np.einsum("twkx,tkx->twk", flat[:, :, None] - corners[:, None], n)
    bent = flat - strength * np.einsum("wk,twk,tkx->twx", weights, above, n)
    at = {ij: k for k, ij in enumerate(row)}
    cut = []
    for i, j in row:
        if i + j < parts:
            cut.append([at[i, j], at[i + 1, j], at[i, j + 1]])
        if i + j < parts - 1:
            cut.append([at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]])
    first = len(row) * np.arange(len(triangles))
    return bent.reshape(-1, 3), (first[:, None, None] + np.array(cut)).reshape(-1, 3)


def capped(points, triangles):
    """Closes the holes of a mesh, each with a fan around its middle: an open mesh has no inside."""
    points, triangles = weld(points, triangles)
    edges = {(a, b) for t in triangles.tolist() for a, b in zip(t, t[1:] + t[:1])}
    # An edge that is not met from the other side as well is at a hole; `ways` goes around it.
    ways = {}
    for a, b in edges:
        if (b, a) not in edges:
            ways.setdefault(b, []).append(a)
    caps = []
    while ways:
        start = at = next(iter(ways))
        loop = []
        while at in ways:
            loop.append(at)
            onward = ways[at].pop()
            if not ways[at]:
                del ways[at]
            at = onward
        print("  a hole of", len(loop), "edges," if at == start else "edges, not closed,", "capped")
        middle = len(points)
        points = np.vstack([points, points[loop].mean(axis=0)])
        caps += [[middle, a, b] for a, b in zip(loop, loop[1:] + loop[:1])]
    triangles = np.vstack([triangles, np.array(caps, int).reshape(-1, 3)])
    return points.astype(np.float32), triangles.astype(np.uint32)


def teapot(path, voxels=256):
    """A level set with a band of two voxels on each side, the least there is; stands on y = 0."""
    points, triangles = capped(*rounded(*read_obj(path)))
    points -= [0.0, points[:, 1].min(), 0.0]
    voxel = float((points.max(0) - points.min(0)).max() / voxels)
    grid = vdb.FloatGrid.createLevelSetFromPolygons(
        points,
        triangles=triangles,
        transform=vdb.createLinearTransform(voxelSize=voxel),
        halfWidth=2.0,
    )
    save("teapot.vdb", grid, "surface")


def noise(shape, cells, random):
    """Trilinear value noise with smoothed cells, from 0 to 1."""
    counts = [max(2, round(cells * n / max(shape))) + 2 for n in shape]
    values = random.random(counts, dtype=np.float32)
    for axis, n in enumerate(shape):
        at = np.linspace(0.0, counts[axis] - 1.001, n)
        cell = at.astype(int)
        part = (at - cell).astype(np.float32)
        part = (part * part * (3 - 2 * part)).reshape([-1 if a == axis else 1 for a in range(3)])
        values = np.take(values, cell, axis) * (1 - part) + np.take(values, cell + 1, axis) * part
    return values


def cloud(shape=(128, 80, 128), seed=11):
    """fBm in an ellipsoid, flat below as a cumulus is; in a box 10 units wide."""
    random = np.random.default_rng(seed)
    total = np.zeros(shape, np.float32)
    for octave in range(6):
        total += 0.55**octave * noise(shape, 4 * 2**octave, random)
    total /= total.max()
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, n, dtype=np.float32) for n in shape], indexing="ij")
    y = np.where(y < -0.4, 2.4 * (y + 0.4) - 0.4, y)
    density = np.clip(7 * (total - 0.3 - 0.6 * (x * x + y * y + z * z)), 0, 1)
    # 8 bits are enough to see and pack better than the noise below them.
    density = np.round(density * 255) / 255
    grid = vdb.FloatGrid()
    grid.copyFromArray(density.astype(np.float32), tolerance=0.0)
    grid.gridClass = vdb.GridClass.FOG_VOLUME
    # Behind the teapot and above it: together they make a scene.
    size = 10.0 / max(shape)
    grid.transform = vdb.createLinearTransform(
        [[size, 0, 0, 0], [0, size, 0, 0], [0, 0, size, 0], [-4.0, 1.2, -9.5, 1]]
    )
    grid.prune()
    save("cloud.vdb", grid, "density")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    teapot(sys.argv[1])
    cloud()
