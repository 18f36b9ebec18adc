#!/usr/bin/env python3
"""Makes the sequence of this folder: a fire that burns for four thirds of a second and begins again.

    apt-get install python3-openvdb python3-numpy
    python3 make_fire.py [FOLDER]

A small simulation of a flame: semi-Lagrangian advection with MacCormack's correction, buoyancy, vorticity
confinement, and a pressure solve by Fourier transform in a box that repeats sideways. The frames at the end
are blended with those before the beginning, so that the loop has no seam. Each file has the fog volumes
`density` (soot) and `flame` (0 to 1, for temperatures from 1,500 to 3,000 K), as Blender's simulations do.
"""

import pathlib
import sys

import numpy as np

try:
    import openvdb as vdb
except ImportError:
    import pyopenvdb as vdb

SHAPE = (48, 48, 104)
FRAMES, BLEND, BEFORE = 32, 8, 34
STEPS = 3
DT = 1.0 / STEPS
VOXEL = 0.03
rng = np.random.default_rng(7)
CELLS = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float32) for n in SHAPE), indexing="ij"))


def sample(field, at):
    """Trilinear interpolation; repeats sideways, and ends at the bottom and the top."""
    low = np.floor(at).astype(np.int32)
    part = (at - low).astype(np.float32)
    ends = []
    for axis, size in enumerate(SHAPE):
        index = [low[axis], low[axis] + 1]
        ends.append([np.mod(i, size) if axis < 2 else np.clip(i, 0, size - 1) for i in index])
    out = np.zeros(at.shape[1:], np.float32)
    for corner in range(8):
        x, y, z = corner >> 2, corner >> 1 & 1, corner & 1
        weight = 1.0
        for axis, side in enumerate((x, y, z)):
            weight = weight * (part[axis] if side else 1.0 - part[axis])
        out += weight * field[ends[0][x], ends[1][y], ends[2][z]]
    return out


def advect(field, u, dt):
    back, forth = CELLS - dt * u, CELLS + dt * u
    once = sample(field, back)
    corrected = once + 0.5 * (field - sample(once, forth))
    # The correction must not leave the range of the values that it comes from.
    low = np.floor(back).astype(np.int32)
    lows, highs = np.full(SHAPE, np.inf, np.float32), np.full(SHAPE, -np.inf, np.float32)
    for corner in range(8):
        index = []
        for axis, size in enumerate(SHAPE):
            i = low[axis] + (corner >> axis & 1)
            index.append(np.mod(i, size) if axis < 2 else np.clip(i, 0, size - 1))
        value = field[tuple(index)]
        lows, highs = np.minimum(lows, value), np.maximum(highs, value)
    return np.clip(corrected, lows, highs)


K = np.meshgrid(*(2.0 * np.pi * np.fft.fftfreq(n) for n in SHAPE[:2]),
                2.0 * np.pi * np.fft.rfftfreq(SHAPE[2]), indexing="ij")
K2 = sum(k * k for k in K)
K2[0, 0, 0] = 1.0


def project(u):
    hat = [np.fft.rfftn(c) for c in u]
    along = sum(k * h for k, h in zip(K, hat)) / K2
    return np.stack([np.fft.irfftn(h - k * along, SHAPE) for k, h in zip(K, hat)]).astype(np.float32)


def confine(u, strength):
    d = [np.gradient(c) for c in u]
    curl = np.stack([d[2][1] - d[1][2], d[0][2] - d[2][0], d[1][0] - d[0][1]])
    size = np.sqrt((curl ** 2).sum(0)) + 1e-6
    n = np.stack(np.gradient(size))
    n /= np.sqrt((n ** 2).sum(0)) + 1e-6
    return strength * np.cross(n, curl, axis=0).astype(np.float32)


def noise(scale):
    """Smooth noise from -1 to 1."""
    hat = np.fft.rfftn(rng.standard_normal(SHAPE))
    out = np.fft.irfftn(hat * np.exp(-0.5 * K2 * scale * scale), SHAPE)
    return (out / np.abs(out).max()).astype(np.float32)


def main(folder):
    middle = (np.array(SHAPE[:2]) - 1) / 2
    x, y, z = CELLS[0] - middle[0], CELLS[1] - middle[1], CELLS[2]
    bed = np.exp(-((x * x + y * y) / 6.0 ** 2) ** 2) * np.exp(-((z - 6.0) / 2.5) ** 2)
    # Above and below, air is brought to rest.
    rest = np.clip((z - SHAPE[2] + 18) / 18, 0, 1) + np.clip((4 - z) / 4, 0, 1)
    wander = [noise(5.0) for _ in range(2)]
    u = np.zeros((3, *SHAPE), np.float32)
    flame, soot = np.zeros(SHAPE, np.float32), np.zeros(SHAPE, np.float32)
    frames = []
    for step in range((BEFORE + BLEND + FRAMES) * STEPS):
        time = step * DT
        # The fuel bed flickers: noise that moves through it.
        at = CELLS + np.array([0.0, 0.0, -1.9 * time], np.float32)[:, None, None, None]
        at[2] = np.mod(at[2], SHAPE[2] - 1)
        feed = bed * np.clip(0.6 + 2.2 * sample(wander[0], at), 0, 1.4)
        flame = np.maximum(flame, feed)
        u[2] += DT * (0.62 * flame + 0.12 * np.minimum(soot, 1.0))
        u[0] += DT * 0.10 * sample(wander[1], at) * flame
        u += DT * confine(u, 0.35)
        u *= (1.0 - 0.5 * rest)
        u = project(u)
        u = np.stack([advect(c, u, DT) for c in u])
        flame, soot = advect(flame, u, DT), advect(soot, u, DT)
        burnt = flame
        flame = np.clip(flame - DT * (0.022 + 0.040 * flame), 0, 1.4)
        soot = soot + 0.55 * (burnt - flame) * (burnt < 0.5)
        soot = soot * (1 - DT * 0.045) - DT * 0.004
        soot = np.clip(soot, 0, 2) * (1 - 0.5 * np.clip((z - SHAPE[2] + 14) / 14, 0, 1))
        if (step + 1) % STEPS == 0:
            frames.append((soot.copy(), flame.copy()))
            print(f"{len(frames)}: speed {np.abs(u).max():.2f}, flame {flame.sum():.0f}, "
                  f"soot {soot.sum():.0f}", flush=True)
    frames = frames[BEFORE:]
    folder.mkdir(parents=True, exist_ok=True)
    bytes_all = 0
    for i in range(FRAMES):
        own = frames[BLEND + i]
        # The last frames lead to the one before the first.
        weight = max(0.0, (i + 1 - (FRAMES - BLEND)) / (BLEND + 1))
        before = frames[i - FRAMES + BLEND] if weight > 0 else own
        pair = [(1 - weight) * a + weight * b for a, b in zip(own, before)]
        grids = []
        for name, field, step, least in (("density", pair[0], 1 / 32, 3), ("flame", pair[1], 1 / 64, 1)):
            field = np.round(field / step) * step
            # Specks that nobody sees would be half of the file.
            field[field < least * step] = 0
            field[..., :3] = 0
            grid = vdb.FloatGrid()
            grid.copyFromArray(np.ascontiguousarray(field.astype(np.float32).transpose(0, 2, 1)[:, :, ::-1]),
                               ijk=(8, 8, 8))
            grid.prune()
            grid.name, grid.gridClass = name, vdb.GridClass.FOG_VOLUME
            # All voxels in one node, which makes small files.
            transform = vdb.createLinearTransform(VOXEL)
            transform.translate([-VOXEL * (8 + SHAPE[0] / 2), -VOXEL * 8, -VOXEL * (8 + SHAPE[1] / 2)])
            grid.transform = transform
            grid.saveFloatAsHalf = True
            grids.append(grid)
        path = folder / f"fire_{i + 1:04}.vdb"
        vdb.write(str(path), grids=grids)
        bytes_all += path.stat().st_size
    print(f"{FRAMES} files, {bytes_all / 1e6:.2f} MB")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).parent)
