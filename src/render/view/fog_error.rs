//! The error of fog in the light cache, by the distances between its samples.

use vdb_core::tree::CoordBox;

use super::extinction::Extinction;
use super::lattice::Lattice;

/// Intervals between samples in a block of them, of which the edge is a whole number of cells.
pub(super) const BLOCK_INTERVALS: u32 = 8;
/// The shortest and the longest step of a ray, in voxels.
const MIN_STEP: f64 = 0.25;
const MAX_STEP: f64 = 16.0;
/// The step is found to within this ratio.
const STEP_PRECISION: f64 = 1.01;
/// Errors of spacings, and of steps where light fades, for an optical depth of 1 per cell and a spacing or step of 1
/// cell in a fog one cell across: a little more than the largest that were measured in clouds of fractal noise.
/// `docs/internals/notebook.md` has the measurements.
const SPACING_ERROR: f64 = 2.0;
const STEP_ERROR: f64 = 1.0;
/// Errors of spacings relative to the second differences that they miss, with multiple and with single scattering, and
/// errors of steps. They are typical of fogs of any roughness: some spacings were off by up to 1.6 times as much.
const SPACING_DETAIL_ERROR: f64 = 0.08;
const SINGLE_SPACING_DETAIL_ERROR: f64 = 0.2;
const STEP_DETAIL_ERROR: f64 = 0.9;
/// What the errors of spacings below a cell are multiplied by with single scattering: they were up to twice what the law
/// says, because they fall more slowly than the square of the spacing. With this factor, the densest cloud that was
/// measured keeps its error; ⅞ of a cell is then never better than a whole one.
const SINGLE_FINE_ERROR: f64 = 1.6;
/// With single scattering, the light of dense fog comes from the first part of a ray, so there are fewer steps whose
/// errors can average out. The ray is taken to end at this optical depth.
const SEEN_DEPTH: f64 = 2.0;
/// The part of the accepted error that the spacing may take.
const SPACING_PART: f64 = 0.8;
/// Steps of a ray along the longest edge of a fog, however thin and smooth, for a relative error of 1 %.
const STEPS: f64 = 65.0;

/// A distance between samples of the light cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Spacing {
    /// The edge of a block of [`BLOCK_INTERVALS`], in cells.
    pub block: i32,
}

impl Spacing {
    pub(super) const CELL: Self = Self { block: BLOCK_INTERVALS as i32 };

    /// In ascending order, from a quarter of a cell to the edge of a leaf. Below a cell, a finer spacing than needed
    /// would only take memory. Above it, what such a spacing leaves of the error makes for longer steps, and
    /// `light_cache/fill.wgsl` relies on powers of 2.
    pub(super) fn all() -> [Self; 10] {
        [2, 3, 4, 5, 6, 7, 8, 16, 32, 64].map(|block| Self { block })
    }

    pub fn in_cells(self) -> f64 {
        f64::from(self.block) / f64::from(BLOCK_INTERVALS)
    }
}

/// The accuracy that a camera asks of the light cache.
#[derive(Clone, Copy, Debug)]
pub(super) struct CacheAccuracy {
    /// The relative error of the radiance; 0 if the view does not use the cache.
    pub error: f32,
    /// Whether fog has single scattering: errors are larger then.
    pub single_scattering: bool,
}

/// What the samples of a fog have to resolve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Detail {
    /// The relative error of the radiance (root mean square) that is accepted.
    error: f64,
    single_scattering: bool,
    extinction: Extinction,
    /// The longest edge of a cell, in world units.
    cell: f64,
    /// The longest edge of the occupied cells, in cells.
    edge: f64,
    /// The voxels that are not empty along a ray, in cells: see [`FogDetail`](vdb_core::pack::FogDetail).
    thickness: f64,
}

impl Detail {
    pub fn new(
        accuracy: CacheAccuracy,
        extinction: Extinction,
        lattice: &Lattice,
        occupied: CoordBox,
    ) -> Self {
        let CoordBox { min, max } = occupied;
        let edge = (max.as_dvec3() - min.as_dvec3()).max_element() + 1.0;
        let CacheAccuracy { error, single_scattering } = accuracy;
        let (cell, thickness) = (lattice.cell_edge(), lattice.detail.thickness.into());
        Self { error: error.into(), single_scattering, extinction, cell, edge, thickness }
    }

    /// The error of linear interpolation between samples of optical depth.
    ///
    /// It is of second order. For clouds of fractal noise, whose details are a fixed part of the whole, it is
    /// [`SPACING_ERROR`] times the optical depth per cell and the square of the spacing, divided by the cells across.
    /// The second differences of rougher fogs are larger than this law assumes, and their error follows from them.
    fn spacing_error(&self, spacing: Spacing) -> f64 {
        let spacing = spacing.in_cells();
        let depth = self.cell * self.extinction.shadow_largest;
        let of_clouds = SPACING_ERROR * depth * spacing * spacing / self.edge;
        // Within a cell, density itself is linear.
        let cells = spacing.max(1.0);
        let difference = self.cell * self.extinction.shadow_difference(cells);
        let missed = cells * difference * (spacing / cells).powi(2);
        let factor =
            if self.single_scattering { SINGLE_SPACING_DETAIL_ERROR } else { SPACING_DETAIL_ERROR };
        let is_fine = self.single_scattering && spacing < 1.0;
        of_clouds.max(factor * missed) * if is_fine { SINGLE_FINE_ERROR } else { 1.0 }
    }

    /// The largest spacing of samples that keeps its part of the error; `None` if even the smallest does not.
    pub fn spacing(&self) -> Option<Spacing> {
        let permitted = SPACING_PART * self.error;
        Spacing::all().into_iter().rev().find(|spacing| self.spacing_error(*spacing) <= permitted)
    }

    /// The error of sampling density only once per step, at the midpoint. The step is in cells.
    ///
    /// Where light fades, it follows the same law as that of spacings. Along a whole ray, the error is that of the
    /// optical depth: the mean of a step differs from its middle by a quarter of the second difference over half its
    /// length, and the differences of steps are taken to be independent, so that they add up by their squares. Steps
    /// through empty voxels do not count. A ray sees fewer steps in dense fog with single scattering. In smooth fog,
    /// neither would keep steps from becoming a large part of the fog.
    fn step_error(&self, step: f64) -> f64 {
        let Extinction { mean, largest, .. } = self.extinction;
        let fading = STEP_ERROR * self.cell * largest * step * step / self.edge;
        let by_size = 0.01 * (STEPS * step / self.edge).powi(2);
        let mut seen = self.thickness;
        if self.single_scattering {
            seen = seen.min(SEEN_DEPTH / (self.cell * mean));
        }
        let steps = (seen / step).max(1.0);
        let missed = self.extinction.difference(step / 2.0) / (4.0 * mean) / steps.sqrt();
        // Without density, nothing is missed, and the mean is zero.
        let missed = if mean > 0.0 { STEP_DETAIL_ERROR * missed } else { 0.0 };
        fading.max(by_size).max(missed)
    }

    /// Cells between samples of density along a ray that keep the error, given the spacing of the samples of light.
    /// The error of both is the root of the sum of their squares.
    pub fn step(&self, spacing: Spacing) -> f32 {
        // If no spacing keeps its part, steps are as short as if one just did. So they are with spacings below a cell:
        // fog that needs them is so dense that light fades within a step. With all that such a spacing leaves, single
        // scattering in a cloud of 0.4 per cell was off by 1.06 % where 1 % was asked for.
        let limit = SPACING_PART * self.error;
        let is_below_cell = spacing < Spacing::CELL;
        let spacing_error =
            if is_below_cell { limit } else { self.spacing_error(spacing).min(limit) };
        let left = (self.error * self.error - spacing_error * spacing_error).sqrt();
        let (mut keeps, mut exceeds) = (MIN_STEP, MAX_STEP);
        if self.step_error(exceeds) <= left {
            return MAX_STEP as f32;
        }
        while exceeds / keeps > STEP_PRECISION {
            let middle = (keeps * exceeds).sqrt();
            if self.step_error(middle) <= left { keeps = middle } else { exceeds = middle }
        }
        keeps as f32
    }
}

#[cfg(test)]
pub(super) mod tests {
    use bevy::math::IVec3;
    use vdb_core::pack::FogDetail;

    use super::super::extinction::FogBox;
    use super::super::extinction::tests::fog;
    use super::*;
    use crate::render::gpu::types;

    /// A relative error with multiple scattering.
    pub fn multiple(error: f32) -> CacheAccuracy {
        CacheAccuracy { error, single_scattering: false }
    }

    /// The edge of a block of intervals, and the step, for a fog whose longest edge has this many cells.
    fn of(
        accuracy: CacheAccuracy,
        (volume, lattice): (types::Volume, Lattice),
        edge: f64,
    ) -> (Option<i32>, f32) {
        let extinction = FogBox::new(0, &volume, &lattice).unwrap().total;
        let CacheAccuracy { error, single_scattering } = accuracy;
        let thickness = lattice.detail.thickness.into();
        let error = error.into();
        let detail = Detail { error, single_scattering, extinction, cell: 1.0, edge, thickness };
        let spacing = detail.spacing();
        (spacing.map(|spacing| spacing.block), detail.step(spacing.unwrap_or(Spacing::CELL)))
    }

    #[test]
    fn spacing_follows_the_error() {
        let of = |error, density, edge| {
            of(multiple(error), fog(IVec3::ZERO, IVec3::splat(8), density), edge)
        };
        let expect = |(error, density, edge), block, step: f32| {
            let found = of(error, density, edge);
            assert!(
                found.0 == block && (0.98 * step..=step).contains(&found.1),
                "{density}: {found:?}"
            );
        };
        expect((0.01, 0.03, 512.0), Some(64), 6.1);
        expect((0.01, 0.12, 512.0), Some(32), 5.4);
        // The spacing leaves more.
        expect((0.01, 0.1, 512.0), Some(32), 6.35);
        // Less than a cell.
        expect((0.01, 0.5, 64.0), Some(5), 0.77);
        expect((0.01, 5.0, 64.0), None, 0.28);
        // Small grids have small details.
        expect((0.01, 0.03, 65.0), Some(16), 0.97);
        // Light fades within a quarter of a cell.
        expect((0.01, 4.2, 64.0), None, 0.304);
        assert_eq!(of(1.0, 0.0, 1e6), (Some(64), MAX_STEP as f32));
        assert_eq!(of(0.01, 0.26, 64.0).0, Some(7));
        assert_eq!(of(0.01, 1.1, 64.0).0, Some(3));
        for bad in [f32::NAN, f32::INFINITY] {
            assert_eq!(of(0.01, bad, 64.0).0, None);
        }
        assert_eq!(of(0.01, f32::INFINITY, 64.0).1, MIN_STEP as f32);
    }

    #[test]
    fn rough_fogs_have_finer_samples() {
        let of = |roughness: f32| {
            let (volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(8), 0.2);
            lattice.detail.differences = [0.02, 0.05, 0.1].map(|difference| difference * roughness);
            lattice.detail.thickness = 72.0;
            of(multiple(0.01), (volume, lattice), 256.0)
        };
        assert_eq!(of(0.0), of(1.0), "the law of clouds");
        let (spacing, step) = of(10.0);
        assert!(spacing == Some(8) && (1.0..2.0).contains(&step), "{spacing:?} {step}");
        assert!(of(20.0).1 < step && of(5.0).1 > step);
    }

    #[test]
    fn thin_fogs_and_those_with_holes_have_shorter_steps() {
        let of = |thickness, density| {
            let (volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(8), density);
            lattice.detail = FogDetail { differences: [0.6, 0.7, 0.8], mean: 0.5, thickness };
            [false, true].map(|single_scattering| {
                let accuracy = CacheAccuracy { error: 0.01, single_scattering };
                of(accuracy, (volume, lattice), 64.0).1
            })
        };
        let [thick, thin] = [32.0, 8.0].map(|thickness| of(thickness, 0.02));
        // Below a voxel, errors grow as the square of the step.
        let ratio = 4_f32.powf(0.25);
        for (thick, thin) in thick.into_iter().zip(thin) {
            assert!((0.97..1.03).contains(&(thick / thin / ratio)), "{thick} {thin}");
        }
        // In dense fog, a ray ends before it has seen as many.
        let [thick, thin] = [64.0, 32.0].map(|thickness| of(thickness, 0.4));
        assert!(thick[0] > thin[0] && thick[1] == thin[1], "{thick:?} {thin:?}");
    }

    #[test]
    fn single_scattering_has_finer_samples() {
        let below_a_cell = |single_scattering| {
            let (volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(8), 0.4);
            lattice.detail.differences = [0.0; 3];
            of(CacheAccuracy { error: 0.01, single_scattering }, (volume, lattice), 80.0).0
        };
        assert_eq!([false, true].map(below_a_cell), [Some(7), Some(5)]);
        let of = |single_scattering, density: f32, roughness: f32| {
            let (volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(8), density);
            lattice.detail.mean = 0.5;
            lattice.detail.thickness = 72.0;
            lattice.detail.differences = [0.1, 0.2, 0.3].map(|difference| difference * roughness);
            of(CacheAccuracy { error: 0.01, single_scattering }, (volume, lattice), 256.0)
        };
        // From a cell up, the law of clouds is the same.
        assert_eq!(of(true, 0.02, 0.1), of(false, 0.02, 0.1));
        assert_eq!([false, true].map(|single| of(single, 0.2, 1.0).0), [Some(16), Some(8)]);
        // A ray that sees all of a fog needs about the same steps; one that sees a part of it, shorter ones.
        let steps = |density| [false, true].map(|single| of(single, density, 3.0).1);
        let [multiple, single] = steps(0.02);
        assert!((multiple / single - 1.0).abs() < 0.05, "{multiple} {single}");
        let [multiple, single] = steps(0.4);
        assert!((1.2..2.0).contains(&(multiple / single)), "{multiple} {single}");
    }
}
