"""How far off optical depths are when density is sampled at the midpoints of steps: step_errors.py FILE.vdb...

Prints a table for the grid `density` of each file: the error (root mean square) of optical depth in per cent of the
root mean square of optical depth, for steps of several lengths in voxels. Rays pass through random points in the
middle 70 % of the box along each axis, within a few degrees of the directions named; density is interpolated
trilinearly, and the reference is the same sum with steps of 1/24 voxel. The column "formula" is
1.25 D(s/2) / (4 m) sqrt(s / n) of docs/internals/notebook.md, "Rough fogs", with D measured between adjacent voxels and
scaled to shorter distances. The last row has the factor that makes these errors relative to the mean optical depth of
the rays that meet density, and counts those rays only.

Needs numpy and pyopenvdb; on Debian: apt-get install python3-numpy python3-openvdb
"""

import sys

import numpy as np
import pyopenvdb

STEPS = [0.25, 0.5, 0.62, 0.75, 0.9, 1.0, 1.25, 1.5, 2.0]
REFERENCE_STEP = 1 / 24
DIRECTIONS = {
    "along an axis": (1, 0, 0),
    "20° off": (1, 0.3, 0.2),
    "39° off": (1, 0.7, 0.4),
    "diagonal": (1, 1, 1),
}
# Standard deviation of each component before normalising: 3° along an axis, 1.7° along the diagonal.
SPREAD = 0.05
RAYS = 2000


def load(path):
    """The densities in the bounding box of the active voxels, with a margin of two zeros."""
    grid = pyopenvdb.read(path, "density")
    low, high = grid.evalActiveVoxelBoundingBox()
    values = np.zeros(np.subtract(high, low) + 1, np.float32)
    grid.copyToArray(values, ijk=low)
    return np.pad(values.astype(np.float64), 2)


def interpolated(values, at):
    """Trilinear samples at points in index space, of the shape (..., 3)."""
    at = np.clip(at, 0, np.array(values.shape) - 1.001)
    corner = np.floor(at).astype(int)
    part = at - corner
    total = np.zeros(at.shape[:-1])
    for offset in np.ndindex(2, 2, 2):
        weight = np.where(offset, part, 1 - part).prod(-1)
        total += weight * values[tuple(np.moveaxis(corner + offset, -1, 0))]
    return total


def depths(values, origins, directions, step, starts, length):
    """The sums of density over midpoints of steps, times the step. Each ray starts at its own part of a step."""
    t = (np.arange(int(np.ceil(length / step))) + starts[:, None]) * step
    points = origins[:, None, :] + t[..., None] * directions[:, None, :]
    return step * interpolated(values, points).sum(1)


def root_mean_square(values):
    return np.sqrt(np.mean(np.square(values)))


def errors(values, direction, random):
    """The errors for all steps, in per cent, and the factor to those relative to the mean."""
    size = np.array(values.shape)
    length = 2 * np.linalg.norm(size)
    directions = np.array(direction, float) + SPREAD * random.normal(size=(RAYS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    targets = size / 2 + (random.random((RAYS, 3)) - 0.5) * 0.7 * size
    origins = targets - directions * length / 2
    starts = random.random(RAYS)
    # In parts, because the reference takes many samples.
    parts = np.array_split(np.arange(RAYS), RAYS // 50)

    def of(step):
        rays = ((origins[i], directions[i], step, starts[i], length) for i in parts)
        return np.concatenate([depths(values, *ray) for ray in rays])

    reference = of(REFERENCE_STEP)
    scale = root_mean_square(reference)
    lit = reference[reference > 0]
    factor = scale / lit.mean() * np.sqrt(len(reference) / len(lit))
    return [100 * root_mean_square(of(step) - reference) / scale for step in STEPS], factor


def formula(values, step):
    """The error from details that steps of at most two voxels miss, in per cent."""
    inner = values[1:-1, 1:-1, 1:-1]
    is_dense = inner > 0
    differences = [
        (np.roll(values, 1, axis) - 2 * values + np.roll(values, -1, axis))[1:-1, 1:-1, 1:-1][is_dense]
        for axis in range(3)
    ]
    distance = step / 2
    difference = root_mean_square(np.concatenate(differences)) * distance**1.5
    longest = max(values.shape) - 4
    return 100 * 1.25 * difference / (4 * inner[is_dense].mean()) * np.sqrt(step / longest)


def main():
    for path in sys.argv[1:]:
        values = load(path)
        inside = values[2:-2, 2:-2, 2:-2]
        counts = [(inside > 0).sum(axis) for axis in range(3)]
        per_ray = np.mean([count[count > 0].mean() for count in counts])
        print(f"{path}: {'×'.join(map(str, inside.shape))} voxels, {100 * (inside > 0).mean():.0f} % not empty,")
        print(f"{per_ray:.1f} of them on a line along an axis that meets any\n")
        print(f"| step, voxels | {' | '.join(DIRECTIONS)} | formula |")
        print("|---" * (len(DIRECTIONS) + 2) + "|")
        random = np.random.default_rng(1)
        columns = [errors(values, direction, random) for direction in DIRECTIONS.values()]
        for step, *row in zip(STEPS, *(own for own, _ in columns)):
            print(f"| {step:g} | {' | '.join(f'{error:.2f}' for error in [*row, formula(values, step)])} |")
        print(f"| relative to the mean | {' | '.join(f'× {factor:.2f}' for _, factor in columns)} | |\n")


main()
