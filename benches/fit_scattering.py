"""Fits the octaves of multiple scattering to path tracing, for scripts/fit-scattering.

use: fit_scattering.py FILE

FILE holds rays, as crates/vdb_core/examples/scattered_light.rs writes them. Prints the constants of
assets/shaders/trace/scattering.wgsl, with the error and the brightness before and after the fit. The error of a
case is the mean difference of its rays, relative to their mean radiance.
"""

import sys

import numpy as np
from scipy.optimize import least_squares

ALBEDOS = np.array([0.8, 0.9, 0.97, 0.99, 1.0])
STEPS = 48
# Rays of the renderer end at this optical depth.
OPAQUE_DEPTH = 16.0

# The constants of the shader by name. All are positive.
CONSTANTS = {
    "OCTAVE_EXTINCTION.x": 0.987,
    "OCTAVE_EXTINCTION.y": 0.247,
    "BUILD_UP": 0.678,
    "ESCAPE.x": 1.13,
    "ESCAPE.y": 0.567,
    "ESCAPE.z": 4.54,
    "OCTAVE_AMPLITUDE.x": 2.89,
    "OCTAVE_AMPLITUDE.y": 0.609,
    "OCTAVE_DEPTH.x": 1.1,
    "OCTAVE_DEPTH.y": 29.0,
}


def phase(anisotropy, cosine):
    """Henyey–Greenstein, per steradian."""
    squared = anisotropy * anisotropy
    return (1 - squared) / (4 * np.pi * (1 + squared - 2 * anisotropy * cosine) ** 1.5)


class Rays:
    def __init__(self, path):
        numbers = np.fromfile(path, dtype="<f4").reshape(-1, 4 + len(ALBEDOS) + 3 * STEPS)
        self.case = numbers[:, 0].astype(int)
        self.anisotropy, self.cosine, self.depth = numbers[:, 1:4].T
        self.radiance = numbers[:, 4 : 4 + len(ALBEDOS)]
        steps = numbers[:, 4 + len(ALBEDOS) :].reshape(-1, STEPS, 3)
        self.before, self.beyond, self.to_sun = np.moveaxis(steps, 2, 0)
        # The mean radiance of the case of each ray.
        counts = np.bincount(self.case)[:, None]
        sums = np.stack([np.bincount(self.case, weights=column) for column in self.radiance.T], axis=1)
        self.case_mean = (sums / np.maximum(counts, 1))[self.case]

    def model(self, constants):
        """The radiance of each ray for each albedo, by the formulas of the shader."""
        k1, k2, build_up, e1, e1_isotropic, e2, a1, a2, d1, d2 = constants
        isotropic = 1 - np.maximum(self.anisotropy, 0)
        depth = np.minimum(self.depth, OPAQUE_DEPTH)
        weight = self.before - self.beyond
        mean = 0.5 * (self.before + self.beyond)
        arriving = np.exp(-self.to_sun)
        towards = np.sqrt(isotropic)[:, None] * self.to_sun
        # The mean of exp(-e V) between both ends of a step, in which V is evenly distributed.
        def leaving(e):
            x = np.maximum(0.5 * e * weight, 1e-6)
            return np.exp(-e * mean) * np.sinh(x) / x

        second = np.exp(-k1 * towards - build_up * arriving) * leaving((e1 - e1_isotropic * isotropic)[:, None])
        third = np.exp(-k2 * towards) * leaving(e2)

        def octave(power, light):
            return phase(self.anisotropy**power, self.cosine) * (weight * light).sum(axis=1)

        albedo = ALBEDOS[None, :]
        return (
            albedo * octave(1, arriving)[:, None]
            + albedo**2 * (a1 * depth / (depth + d1) * octave(2, second))[:, None]
            + albedo**12 * (a2 * depth / (1 + isotropic * depth / d2) * octave(8, third))[:, None]
        )

    def residuals(self, logarithms):
        found = self.model(np.exp(logarithms))
        return ((found - self.radiance) / self.case_mean).ravel()

    def report(self, constants):
        found = self.model(constants)
        errors = np.abs(found - self.radiance) / self.case_mean
        cases = np.bincount(self.case)
        used = cases > 0

        def by_case(values):
            return np.bincount(self.case, weights=values.mean(axis=1))[used] / cases[used]

        brightness = by_case(found / self.case_mean)
        low, high = np.percentile(brightness, [5, 95])
        error = by_case(errors).mean()
        return f"error {error:.4f}, brightness of a case {low:.2f} to {high:.2f} (5th to 95th percentile)"


def main():
    rays = Rays(sys.argv[1])
    start = np.array(list(CONSTANTS.values()))
    print(f"{len(rays.case)} rays of {len(np.unique(rays.case))} cases")
    print("constants of the shader:", rays.report(start))
    # Nearly absolute differences, so that the noise of few paths with much light does not decide.
    fit = least_squares(rays.residuals, np.log(start), loss="soft_l1", f_scale=0.17, x_scale=0.1)
    fitted = np.exp(fit.x)
    print("fitted:", rays.report(fitted))
    for name, constant in zip(CONSTANTS, fitted):
        print(f"{name:20} {constant:.3g}")


if __name__ == "__main__":
    main()
