//! Which fogs can be in the light cache, and the samples that they need there.

use bevy::math::{IVec3, UVec3};
use vdb_core::tree::CoordBox;

use super::extinction::{Extinction, FogBox, add_overlapping};
use super::lattice::Lattice;
use crate::render::gpu::types;

/// Lattices begin and end at multiples of this many intervals between samples, so that few edits move them.
const ALIGNMENT: u32 = 8;
/// The most samples along an axis: WebGPU's default limit of a texture.
const MAX_SAMPLES: u32 = 2048;
/// The most bytes of a lattice for one light: WebGPU's default limit of a binding.
const MAX_BYTES: u64 = 128 << 20;
/// The most samples of a lattice with a spacing below a cell that does not keep the error: 48 MiB of its texture, which
/// must not crowd out other fogs.
const MAX_FALLBACK_SAMPLES: u64 = 24 << 20;
/// Bytes of which lines are a multiple when they are copied to a texture.
const LINE_BYTES: u64 = 256;
/// log₂ of the smallest and the largest spacing in cells. The largest is an edge of a leaf.
const MIN_LOG: i32 = -2;
const MAX_LOG: i32 = 3;
/// log₂ of the smallest spacing for pipelines that cannot light fog by rays. They draw only until others are compiled.
const MIN_COARSE_LOG: i32 = 0;
/// The shortest and the longest step of a ray, in voxels.
const MIN_STEP: f64 = 0.25;
const MAX_STEP: f64 = 16.0;
/// The step is found to within this ratio.
const STEP_PRECISION: f64 = 1.01;
/// A ramp alone, however steep, makes no step shorter than this.
const MIN_RAMP_STEP: f32 = 1.0;

/// The lattice of samples of one fog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct CacheLayout {
    /// The local cell at the first sample.
    pub origin: IVec3,
    /// Samples along each axis.
    pub samples: UVec3,
    /// log₂ of the cells between samples.
    pub log: i32,
}

impl CacheLayout {
    /// The samples for the occupied cells of a grid at a spacing; `None` if they are too many.
    fn new(occupied: CoordBox, log: i32) -> Option<Self> {
        let shift = log + ALIGNMENT.ilog2() as i32;
        let first = occupied.min >> shift;
        let last = occupied.max >> shift;
        let blocks = last.checked_sub(first)?.as_uvec3() + 1;
        if blocks.max_element() >= MAX_SAMPLES / ALIGNMENT {
            return None;
        }
        let samples = blocks * ALIGNMENT + 1;
        let layout = Self { origin: first << shift, samples, log };
        (layout.staging_bytes() <= MAX_BYTES).then_some(layout)
    }

    /// Cells between samples.
    pub fn spacing(&self) -> f64 {
        f64::from(self.log).exp2()
    }

    /// Words of a line of samples, which are 16-bit floats, in a buffer that is copied to a texture.
    pub fn line_words(&self) -> u32 {
        ((u64::from(self.samples.x) * 2).next_multiple_of(LINE_BYTES) / 4) as u32
    }

    /// Bytes of the samples for one light in that buffer.
    pub fn staging_bytes(&self) -> u64 {
        [4 * self.line_words(), self.samples.y, self.samples.z].into_iter().map(u64::from).product()
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

/// A fog that fits into the light cache.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CachedFog {
    pub layout: CacheLayout,
    /// The accepted relative error of the radiance.
    pub error: f32,
    /// Voxels between samples of density along a view ray.
    pub step: f32,
    /// Whether the samples are within the accepted error, or at least finer than those that rays to lights would
    /// take. Others are only for pipelines that cannot light fog by rays.
    pub replaces_rays: bool,
}

impl CachedFog {
    /// The samples that keep the radiance of a fog within a relative error or, if there are none that fit, the
    /// finest of those that are more accurate than rays to lights and take little memory or, failing these, of those at
    /// least a cell apart. `None` if the fog is empty or too large. `shadow_step` is that of rays to lights, in voxels.
    fn new(
        accuracy: CacheAccuracy,
        extinction: Extinction,
        shadow_step: f32,
        lattice: &Lattice,
    ) -> Option<Self> {
        let occupied = lattice.occupied?;
        let detail = Detail::new(accuracy, extinction, lattice, occupied);
        let wanted = detail.spacing_log();
        let beats_rays = |log: i32| {
            extinction.shadow_largest.is_finite()
                && f64::from(shadow_step) >= RAY_STEP * f64::from(log).exp2()
        };
        // Rays through a ramp integrate it exactly, whatever their steps.
        let is_fallback = |layout: &CacheLayout| {
            let is_small = layout.samples.as_u64vec3().element_product() <= MAX_FALLBACK_SAMPLES;
            layout.log >= MIN_COARSE_LOG
                || (is_small && lattice.ramp.is_none() && beats_rays(layout.log))
        };
        let layout = (wanted.unwrap_or(MIN_LOG)..=MAX_LOG)
            .filter_map(|log| CacheLayout::new(occupied, log))
            .find(|layout| wanted == Some(layout.log) || is_fallback(layout))?;
        Some(Self {
            layout,
            error: accuracy.error,
            step: with_ramp(detail.step(layout.log), lattice.steepness),
            replaces_rays: wanted == Some(layout.log) || beats_rays(layout.log),
        })
    }
}

/// The step through a fog whose ramp is this steep. Between samples, the ramp is integrated over values that
/// are taken for linear: their error is that of the square of the step, and a ramp multiplies it by its steepness.
fn with_ramp(step: f32, steepness: f32) -> f32 {
    step.min((step / steepness.sqrt()).max(MIN_RAMP_STEP))
}

/// From this many spacings per step of rays to lights, the cache is more accurate than these.
const RAY_STEP: f64 = 2.0;
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
/// With single scattering, the light of dense fog comes from the first part of a ray, so there are fewer steps whose
/// errors can average out. The ray is taken to end at this optical depth.
const SEEN_DEPTH: f64 = 2.0;
/// The part of the accepted error that the spacing may take.
const SPACING_PART: f64 = 0.8;
/// Steps of a ray along the longest edge of a fog, however thin and smooth, for a relative error of 1 %.
const STEPS: f64 = 65.0;

/// What the samples of a fog have to resolve.
#[derive(Clone, Copy, Debug)]
struct Detail {
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
    fn new(
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

    /// The error of linear interpolation between samples of optical depth `2^log` cells apart.
    ///
    /// It is of second order. For clouds of fractal noise, whose details are a fixed part of the whole, it is
    /// [`SPACING_ERROR`] times the optical depth per cell and the square of the spacing, divided by the cells across.
    /// The second differences of rougher fogs are larger than this law assumes, and their error follows from them.
    fn spacing_error(&self, log: i32) -> f64 {
        let spacing = f64::from(log).exp2();
        let depth = self.cell * self.extinction.shadow_largest;
        let of_clouds = SPACING_ERROR * depth * spacing * spacing / self.edge;
        // Within a cell, density itself is linear.
        let cells = spacing.max(1.0);
        let difference = self.cell * self.extinction.shadow_difference(cells);
        let missed = cells * difference * (spacing / cells).powi(2);
        let factor =
            if self.single_scattering { SINGLE_SPACING_DETAIL_ERROR } else { SPACING_DETAIL_ERROR };
        of_clouds.max(factor * missed)
    }

    /// log₂ of the largest spacing of samples, in cells, that keeps its part of the error; `None` if even the smallest
    /// spacing does not.
    fn spacing_log(&self) -> Option<i32> {
        let permitted = SPACING_PART * self.error;
        (MIN_LOG..=MAX_LOG).rev().find(|log| self.spacing_error(*log) <= permitted)
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
    fn step(&self, log: i32) -> f32 {
        // If no spacing keeps its part, steps are as short as if one just did. So they are with spacings below a cell:
        // fog that needs them is so dense that light fades within a step. With all that such a spacing leaves, single
        // scattering in a cloud of 0.4 per cell was off by 1.06 % where 1 % was asked for.
        let limit = SPACING_PART * self.error;
        let spacing_error = if log < 0 { limit } else { self.spacing_error(log).min(limit) };
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

/// The samples in the light cache of each entry of a view's list: `None` for those that are no fog or do not fit, and
/// for all if the accepted error is 0.
pub(super) fn find_cached_fogs(
    accuracy: CacheAccuracy,
    volumes: &[types::Volume],
    lattices: &[&Lattice],
) -> Vec<Option<CachedFog>> {
    let mut found = vec![None; lattices.len()];
    if accuracy.error <= 0.0 {
        return found;
    }
    let entries = volumes.iter().zip(lattices).enumerate();
    let mut fogs: Vec<_> =
        entries.filter_map(|(i, (volume, lattice))| FogBox::new(i, volume, lattice)).collect();
    add_overlapping(&mut fogs);
    for fog in fogs {
        let (shadow_step, lattice) = (volumes[fog.entry].shadow_step, lattices[fog.entry]);
        found[fog.entry] = CachedFog::new(accuracy, fog.total, shadow_step, lattice);
    }
    found
}

#[cfg(test)]
mod tests {
    use vdb_core::pack::FogDetail;

    use super::super::extinction::tests::fog;
    use super::*;

    /// A relative error with multiple scattering.
    fn multiple(error: f32) -> CacheAccuracy {
        CacheAccuracy { error, single_scattering: false }
    }

    /// log₂ of the spacing, and the step, for a fog whose longest edge has this many cells.
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
        let log = detail.spacing_log();
        (log, detail.step(log.unwrap_or(0)))
    }

    #[test]
    fn spacing_follows_the_error() {
        let of = |error, density, edge| {
            of(multiple(error), fog(IVec3::ZERO, IVec3::splat(8), density), edge)
        };
        let expect = |(error, density, edge), log, step: f32| {
            let found = of(error, density, edge);
            assert!(
                found.0 == log && (0.98 * step..=step).contains(&found.1),
                "{density}: {found:?}"
            );
        };
        expect((0.01, 0.03, 512.0), Some(3), 6.1);
        expect((0.01, 0.12, 512.0), Some(2), 5.4);
        // The spacing leaves more.
        expect((0.01, 0.1, 512.0), Some(2), 6.35);
        // Less than a cell.
        expect((0.01, 0.5, 64.0), Some(-1), 0.77);
        expect((0.01, 5.0, 64.0), None, 0.28);
        // Small grids have small details.
        expect((0.01, 0.03, 65.0), Some(1), 0.97);
        // Light fades within a quarter of a cell.
        expect((0.01, 4.2, 64.0), None, 0.304);
        assert_eq!(of(1.0, 0.0, 1e6), (Some(MAX_LOG), MAX_STEP as f32));
        assert_eq!(of(0.01, 0.26, 64.0).0, Some(-1));
        assert_eq!(of(0.01, 1.1, 64.0).0, Some(-2));
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
        assert!(spacing == Some(0) && (1.0..2.0).contains(&step), "{spacing:?} {step}");
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
        let of = |single_scattering, density: f32, roughness: f32| {
            let (volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(8), density);
            lattice.detail.mean = 0.5;
            lattice.detail.thickness = 72.0;
            lattice.detail.differences = [0.1, 0.2, 0.3].map(|difference| difference * roughness);
            of(CacheAccuracy { error: 0.01, single_scattering }, (volume, lattice), 256.0)
        };
        // The law of clouds is the same.
        assert_eq!(of(true, 0.02, 0.1), of(false, 0.02, 0.1));
        assert_eq!([false, true].map(|single| of(single, 0.2, 1.0).0), [Some(1), Some(0)]);
        // A ray that sees all of a fog needs about the same steps; one that sees a part of it, shorter ones.
        let steps = |density| [false, true].map(|single| of(single, density, 3.0).1);
        let [multiple, single] = steps(0.02);
        assert!((multiple / single - 1.0).abs() < 0.05, "{multiple} {single}");
        let [multiple, single] = steps(0.4);
        assert!((1.2..2.0).contains(&(multiple / single)), "{multiple} {single}");
    }

    #[test]
    fn all_cells_are_between_samples() {
        for (min, max) in [(IVec3::ZERO, IVec3::ZERO), (IVec3::new(-5, 31, 33), IVec3::splat(64))] {
            for log in MIN_LOG..=MAX_LOG {
                let layout = CacheLayout::new(CoordBox { min, max }, log).unwrap();
                let size = (ALIGNMENT << (log - MIN_LOG)) as i32 >> -MIN_LOG;
                assert!(layout.origin.cmple(min).all());
                let cells = (layout.samples - 1).as_dvec3() * layout.spacing();
                let end = layout.origin + cells.as_ivec3();
                assert!(end.cmpgt(max).all() && (end - size).cmple(max).all(), "{layout:?}");
            }
        }
        let all = CoordBox { min: IVec3::MIN, max: IVec3::MAX };
        assert_eq!(CacheLayout::new(all, 0), None);
        let long = |length| CoordBox { min: IVec3::ZERO, max: IVec3::new(0, 0, length - 1) };
        let most = (MAX_SAMPLES - ALIGNMENT) as i32;
        assert!(CacheLayout::new(long(most), 0).is_some());
        assert_eq!(CacheLayout::new(long(most + 1), 0), None, "too many samples in a line");
    }

    #[test]
    fn a_small_dense_fog_in_a_large_thin_one_leaves_it_in_the_cache() {
        let large = fog(IVec3::ZERO, IVec3::splat(512), 0.01);
        let small = fog(IVec3::splat(240), IVec3::splat(256), 8.0);
        let of = |fogs: &[(types::Volume, Lattice)]| {
            let volumes: Vec<_> = fogs.iter().map(|fog| fog.0).collect();
            let lattices: Vec<_> = fogs.iter().map(|fog| &fog.1).collect();
            find_cached_fogs(multiple(0.01), &volumes, &lattices)
        };
        let found = of(&[large, small]).into_iter().map(|fog| fog.unwrap()).collect::<Vec<_>>();
        assert!(found[0].replaces_rays && found[0].layout.log > 0, "{found:?}");
        assert!(!found[1].replaces_rays && found[1].layout.log == 0, "{found:?}");
        let dense = fog(IVec3::ZERO, IVec3::splat(512), 4.0);
        let found = of(&[large, dense]);
        assert!(found.iter().all(|fog| fog.is_some_and(|fog| !fog.replaces_rays)), "{found:?}");
    }

    #[test]
    fn fogs_whose_error_cannot_be_kept_have_the_finest_samples_that_fit() {
        let of = |edge, density| {
            let (volume, lattice) = fog(IVec3::ZERO, IVec3::splat(edge), density);
            let found = find_cached_fogs(multiple(0.01), &[volume], &[&lattice])[0];
            found.map(|fog| (fog.layout.log, fog.replaces_rays))
        };
        assert_eq!(of(64, 0.03), Some((1, true)));
        assert_eq!(of(64, 1.0), Some((-1, true)));
        assert_eq!(of(64, 4.0), Some((-2, true)));
        assert_eq!(of(64, 5.0), Some((0, false)), "too dense");
        assert_eq!(of(512, 4.0), Some((1, false)), "too dense, and too large for the finest");
        assert_eq!(of(4096, 0.001), None, "too large");
        assert_eq!(of(64, f32::INFINITY), Some((0, false)));
    }

    #[test]
    fn rays_take_the_place_of_the_cache_only_if_they_are_finer() {
        let of_density = |edge, density, ramp, shadow_step| {
            let (mut volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(edge), density);
            volume.shadow_step = shadow_step;
            lattice.ramp = ramp;
            let found = find_cached_fogs(multiple(0.01), &[volume], &[&lattice])[0];
            found.map(|fog| (fog.layout.log, fog.replaces_rays))
        };
        let of = |edge, shadow_step| of_density(edge, 5.0, None, shadow_step);
        assert_eq!(of(32, 0.25), Some((0, false)));
        assert_eq!([1.0, 2.0, 8.0].map(|step| of(64, step)), [Some((-2, true)); 3]);
        assert_eq!([0.5, 1.0, 8.0].map(|step| of(32, step)), [Some((-2, true)); 3]);
        // A quarter of a voxel would take too much memory, and half of one is not finer than half a step.
        assert_eq!([0.5, 1.0].map(|step| of(100, step)), [Some((0, false)), Some((-1, true))]);
        assert_eq!([1.0, 2.0].map(|step| of(200, step)), [Some((0, false)), Some((0, true))]);
        // One that keeps the error, but does not fit.
        assert_eq!(of_density(100, 6.2, None, 1.0), Some((-1, true)));
        let with_ramp = |step| of_density(32, 5.0, Some(1), step);
        assert_eq!(
            [1.0, 2.0].map(with_ramp),
            [Some((0, false)), Some((0, true))],
            "rays are exact"
        );
        for bad in [f32::NAN, f32::INFINITY] {
            assert_eq!(of_density(32, bad, None, 8.0), Some((0, false)));
        }
        assert_eq!([2.0, 4.0].map(|step| of(512, step)), [Some((1, false)), Some((1, true))]);
    }
}
