//! Light that is scattered by the remainder of the phase function more than once.

use glam::{DVec3, UVec3, Vec3, Vec4};

use super::chebyshev::relaxation_factors;
use super::lattice::{Lattice, cells, index};
use super::medium::Medium;
use super::octants::FogOctants;
use super::phase::Phase;
use super::sweep::{Level, directions};

/// Sweeps on each level, from coarse to fine, and the lowest eigenvalue of `1 - K` that they damp, where K is a
/// sweep. The lowest ones belong to the smoothest light, which is found on the coarsest level.
const PLAN: [(usize, f64); 3] = [(12, 0.02), (8, 0.05), (8, 0.1)];

/// The optical properties of fog, for one colour channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// The extinction coefficient for a density of 1, 0 or more: the factor of the extinctions and depths of
    /// [`FogSample`](super::FogSample).
    pub extinction: f32,
    /// The albedo ω, 0 to 1.
    pub albedo: f32,
    /// The phase function.
    pub phase: Phase,
}

/// Scattered light on a lattice, per unit of the irradiance of the light: what a
/// [view ray](super::InScattering) needs beside the closed forms.
#[derive(Clone, Debug, PartialEq)]
pub struct ScatteredLight {
    lattice: Lattice,
    cells_per_unit: f64,
    /// `(φ, F)` in the middle of each cell.
    light: Vec<Vec4>,
}

impl ScatteredLight {
    /// Solves for the light of a sun. `to_light` is a unit vector in the frame of the lattice, which must be that
    /// of the depths in `octants`.
    ///
    /// Discrete ordinates in 14 directions, on three levels of detail. Each starts from the light of the
    /// coarser one; sweeps with the factors of Chebyshev's iteration approach the solution within 1 % on
    /// average in deep fog (`docs/internals/notebook.md`).
    pub fn solve(octants: &FogOctants, optics: &Optics, to_light: DVec3) -> Self {
        let Optics { extinction, albedo, phase } = optics;
        let albedo = f64::from(albedo.clamp(0.0, 1.0));
        let v = phase.extinction_scale(albedo) as f32;
        let asymmetry = 3.0 * phase.remainder_anisotropy();
        let k = phase.scaled_albedo(albedo) / (4.0 * std::f64::consts::PI);
        let scattering = Vec3::splat((k * asymmetry) as f32).extend(k as f32);
        let scattering = Vec4::new(scattering.w, scattering.x, scattering.y, scattering.z);
        let mut media = vec![Medium::new(octants, extinction.max(0.0), v)];
        while media.len() < PLAN.len()
            && let Some(coarser) = media.last().and_then(Medium::coarser)
        {
            media.push(coarser);
        }
        // A remainder that scatters backwards makes eigenvalues of K negative: it reverses a flux.
        let highest = 1.0 + (-phase.remainder_anisotropy()).max(0.0);
        let mut light = Vec::new();
        let mut coarser = UVec3::ZERO;
        for (medium, (sweeps, lowest)) in media.iter().rev().zip(PLAN) {
            light = refined(&light, coarser, medium.size);
            coarser = medium.size;
            let mut level = Level::new(medium, &directions(), -to_light.as_vec3());
            for factor in relaxation_factors(sweeps, [lowest, highest]) {
                level.sweep(&mut light, scattering, factor);
            }
        }
        let lattice = octants.lattice;
        Self { lattice, cells_per_unit: 1.0 / lattice.edge, light }
    }

    /// The fluence φ (the integral of radiance over all directions) and the three components of the flux F
    /// at a point in the frame of the lattice: interpolated between the middles of cells, and constant outside of
    /// them. Without light that has not been scattered, or in the forward peak alone.
    #[inline]
    pub fn at(&self, point: DVec3) -> Vec4 {
        let at = ((point - self.lattice.low) * self.cells_per_unit - 0.5).as_vec3();
        trilinear(&self.light, self.lattice.size, at)
    }
}

/// The value at a point, given in cells from the middle of the first one; constant beyond the middles of
/// the outermost ones.
#[inline]
fn trilinear(values: &[Vec4], size: UVec3, at: Vec3) -> Vec4 {
    let at = at.clamp(Vec3::ZERO, (size - 1).as_vec3());
    let low = at.as_uvec3();
    let [u, v, w] = (at - low.as_vec3()).to_array();
    let first = index(low, size);
    // The last cell has no next one, which then has a weight of 0.
    let next = |axis: usize| match low[axis] + 1 < size[axis] {
        true => index(UVec3::AXES[axis], size),
        false => 0,
    };
    let [x, y, z] = [0, 1, 2].map(next);
    let line = |at: usize| values[at].lerp(values[at + x], u);
    let plane = |at: usize| line(at).lerp(line(at + y), v);
    plane(first).lerp(plane(first + z), w)
}

/// The light of a level on the next finer one; darkness if there is none.
fn refined(light: &[Vec4], coarse: UVec3, fine: UVec3) -> Vec<Vec4> {
    let at = |cell: UVec3| 0.5 * (cell.as_vec3() + 0.5) - 0.5;
    let value = |cell| match light.is_empty() {
        true => Vec4::ZERO,
        false => trilinear(light, coarse, at(cell)),
    };
    cells(fine).map(value).collect()
}
