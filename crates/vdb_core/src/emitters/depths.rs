//! What smoke lets out of the light of a fire within.

use glam::{DAffine3, DMat3, DVec3, IVec3, Vec3};

use super::cells::{self, Lattice};
use super::values::COARSE;
use crate::pack::PackedGrid;

/// The largest number of cubes.
const MAX_CUBES: u64 = 1 << 15;

/// The mean densities of a packed fog grid in cubes of voxels, for optical depths that need not be
/// exact.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensityCubes {
    /// The lowest corner of the first cube, in index space.
    origin: DVec3,
    /// The edge of a cube in voxels.
    edge: f64,
    size: IVec3,
    means: Vec<f32>,
}

impl DensityCubes {
    /// The means of a grid that was packed as fog.
    pub fn new(grid: &PackedGrid) -> Self {
        let Some(occupied) = grid.occupied else { return Self::default() };
        let lattice = Lattice::over(occupied, 0, MAX_CUBES);
        let edge = 2.0_f64.powi(lattice.log2_edge as i32);
        let mut means = vec![0.0_f64; lattice.cubes()];
        cells::visit(grid, lattice.log2_edge >= COARSE, |cells| {
            // The mean of the corners is that of the trilinear interpolant.
            let mean = cells.corners.iter().map(|corner| f64::from(*corner)).sum::<f64>() / 8.0;
            lattice.divide(cells, |cube, part| {
                let log2_part = 3 * (part.log2_edge as i32 - lattice.log2_edge as i32);
                means[cube] += 2.0_f64.powi(log2_part) * mean;
            });
        });
        Self {
            origin: grid.base.as_dvec3() + edge * lattice.low.as_dvec3(),
            edge,
            size: lattice.size,
            means: means.into_iter().map(|mean| mean as f32).collect(),
        }
    }

    /// ∫ density dt along a ray `from + t · dir` in index space from a point to infinity, with one
    /// sample for each half of a cube.
    fn depth(&self, from: DVec3, dir: DVec3) -> f64 {
        let speed = dir.length();
        if self.means.is_empty() || speed == 0.0 {
            return 0.0;
        }
        let from = (from - self.origin) / self.edge;
        let unit = dir / speed;
        // The part of the ray within the box.
        let ends = [DVec3::ZERO, self.size.as_dvec3()].map(|plane| (plane - from) / unit);
        let inside = |axis: usize| {
            let is_still = unit[axis] == 0.0;
            let is_inside = (0.0..f64::from(self.size[axis])).contains(&from[axis]);
            match (is_still, is_inside) {
                (true, true) => (f64::NEG_INFINITY, f64::INFINITY),
                (true, false) => (f64::INFINITY, f64::NEG_INFINITY),
                _ => (ends[0][axis].min(ends[1][axis]), ends[0][axis].max(ends[1][axis])),
            }
        };
        let begin = (0..3).map(|axis| inside(axis).0).fold(0.0, f64::max);
        let end = (0..3).map(|axis| inside(axis).1).fold(f64::INFINITY, f64::min);
        if begin >= end {
            return 0.0;
        }
        let steps = ((end - begin) * 2.0).ceil().max(1.0);
        let step = (end - begin) / steps;
        let sum: f64 = (0..steps as usize)
            .map(|i| from + unit * (begin + (i as f64 + 0.5) * step))
            .map(|at| {
                let cube = at.as_ivec3().clamp(IVec3::ZERO, self.size - 1);
                let index = (cube.x * self.size.y + cube.y) * self.size.z + cube.z;
                f64::from(self.means[index as usize])
            })
            .sum();
        sum * step * self.edge / speed
    }
}

/// The number of directions in which light leaves a fire.
const DIRECTIONS: usize = 14;

/// The directions, and the weight of each in a mean over the sphere: the 14 points of Lebedev
/// (1976), by which polynomials up to the fifth degree are integrated exactly.
fn direction(i: usize) -> (DVec3, f64) {
    if i < 6 {
        let mut axis = DVec3::ZERO;
        axis[i / 2] = [1.0, -1.0][i % 2];
        (axis, 1.0 / 15.0)
    } else {
        let sign = |bit: usize| if (i - 6) >> bit & 1 == 0 { 1.0 } else { -1.0 };
        (DVec3::new(sign(0), sign(1), sign(2)) / 3.0_f64.sqrt(), 3.0 / 40.0)
    }
}

/// Optical depths from some points outwards.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EscapeDepths {
    depths: Vec<[f32; DIRECTIONS]>,
}

impl EscapeDepths {
    /// The optical depths from points, given in the file's world, for an extinction of 1 per unit
    /// of density and of length there.
    pub fn new(points: &[DVec3], density: &DensityCubes, world_from_index: DAffine3) -> Self {
        let index_from_world = world_from_index.inverse();
        let depths = points.iter().map(|point| {
            let from = index_from_world.transform_point3(*point);
            std::array::from_fn(|i| {
                let dir = index_from_world.transform_vector3(direction(i).0);
                density.depth(from, dir) as f32
            })
        });
        Self { depths: depths.collect() }
    }

    /// The fraction of the light of each point that leaves the smoke, as RGB, scattered or not: in the
    /// mean over the light that leaves, so that smoke on one side of a fire hardly dims the other
    /// ones.
    ///
    /// Of light that is not scattered, `p` leaves, the mean of `e^-τ` with the weight `e^-τ`. After
    /// each scattering, a fraction `s` of what remains does: the geometric mean of `p`, as from the
    /// point, and of Wigner's approximation `1 / (1 + 4τ/3)`, as from anywhere in a ball of the same
    /// depth. With the albedo `ω`, the series of scatterings sums up to
    /// `p + (1 - p) ω s / (1 - ω (1 - s))`.
    /// Anisotropic scattering counts as isotropic scattering with an extinction of `1 - ω g` times the
    /// true one and an albedo of `ω (1 - g) / (1 - ω g)` (the similarity relation; van de Hulst 1980,
    /// "Multiple light scattering").
    pub fn escaping(&self, smoke: &Smoke) -> Vec<Vec3> {
        let albedo = smoke.albedo.clamp(Vec3::ZERO, Vec3::ONE);
        let anisotropy = smoke.anisotropy.clamp(-0.99, 0.99);
        let reduced = 1.0 - anisotropy * albedo.element_sum() / 3.0;
        let albedo = albedo * (1.0 - anisotropy) / (Vec3::ONE - anisotropy * albedo);
        let directions: [(f32, f32); DIRECTIONS] = std::array::from_fn(|i| {
            let (dir, weight) = direction(i);
            // The map turns and stretches directions: a solid angle changes by |det M| / |M d|³.
            let stretch = (smoke.scene_from_world * dir).length();
            let weight = if stretch > 0.0 { weight / stretch.powi(3) } else { 0.0 };
            (weight as f32, stretch as f32 * smoke.density_scale * reduced)
        });
        let fraction = |depths: &[f32; DIRECTIONS]| {
            let parts = directions.iter().zip(depths);
            let (mut light, mut squares) = (0.0, 0.0);
            for ((weight, scale), depth) in parts {
                let through = (-scale * depth).exp();
                light += weight * through;
                squares += weight * through * through;
            }
            let straight = squares / light;
            if straight.is_nan() || straight <= 0.0 {
                return Vec3::ZERO;
            }
            let again = (straight / (1.0 - 4.0 / 3.0 * straight.ln())).sqrt();
            let scattered = albedo * again / (Vec3::ONE - albedo * (1.0 - again));
            Vec3::splat(straight) + (1.0 - straight) * scattered
        };
        self.depths.iter().map(fraction).collect()
    }
}

/// Smoke around a fire, in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoke {
    /// The linear part of the transform that places the file's world in the scene.
    pub scene_from_world: DMat3,
    /// Extinction per unit of density and of length in the scene. 0 or more.
    pub density_scale: f32,
    /// The single-scattering albedo, as RGB: 0 to 1.
    pub albedo: Vec3,
    /// The mean cosine of the scattering angle: -1 to 1.
    pub anisotropy: f32,
}
