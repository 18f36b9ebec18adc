"""Makes the bundled models with stock OpenVDB (Debian: python3-openvdb, python3-numpy).

use: /usr/bin/python3 make_models.py TeapotGeometry.js

The file, from three.js (npm pack three@0.160.0, examples/jsm/geometries), has Newell's control points.
"""

import os
import re
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


def read_patches(path):
    """The control points of the teapot's 32 bicubic Bézier patches; z is up."""
    with open(path, encoding="utf-8") as file:
        text = file.read()

    def numbers(name):
        body = text[text.index(f"const {name} = [") :]
        body = re.sub(r"/\*.*?\*/|//[^\n]*", "", body[body.index("[") + 1 : body.index("]")], flags=re.S)
        return [float(number.replace(" ", "")) for number in body.replace("\n", " ").split(",") if number.strip()]

    vertices = np.array(numbers("teapotVertices")).reshape(-1, 3)
    return vertices[np.array(numbers("teapotPatches"), int).reshape(-1, 4, 4)]


def tessellated(patches, parts=128):
    """Points and triangles, with `parts` along each edge of a patch: facets of a voxel or less, which do not show."""
    u = np.linspace(0.0, 1.0, parts + 1)
    weights = np.stack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u * u * (1 - u), u**3], -1)
    points = np.einsum("ia,jb,pabx->pijx", weights, weights, patches)
    row = parts + 1
    low = (np.arange(parts)[:, None] * row + np.arange(parts)).reshape(-1)
    squares = np.stack([low, low + row, low + row + 1, low, low + row + 1, low + 1], -1)
    first = row * row * np.arange(len(patches))
    triangles = first[:, None, None] + squares.reshape(-1, 3)
    # To y up.
    points = points.reshape(-1, 3)[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    return points, triangles.reshape(-1, 3)


def weld(points, triangles):
    """One point for all that lie at the same place; triangles without area are dropped."""
    points, index = np.unique(points.round(5) + 0.0, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles.astype(int)]
    flat = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    return points, triangles[~flat]


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
    points, triangles = capped(*tessellated(read_patches(path)))
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
