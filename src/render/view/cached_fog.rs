//! Which fogs can be in the light cache, and the samples that they need there.

use bevy::math::{IVec3, UVec3};
use vdb_core::tree::CoordBox;

use super::extinction::{Extinction, FogBox, add_overlapping};
use super::fog_error::{BLOCK_INTERVALS, CacheAccuracy, Detail, Spacing};
use super::lattice::Lattice;
use crate::render::gpu::types;

/// The most samples along an axis: WebGPU's default limit of a texture.
const MAX_SAMPLES: u32 = 2048;
/// The most bytes of a lattice for one light: WebGPU's default limit of a binding.
const MAX_BYTES: u64 = 128 << 20;
/// The most samples of a lattice with a spacing below a cell that does not keep the error: 48 MiB of its texture, which
/// must not crowd out other fogs.
const MAX_FALLBACK_SAMPLES: u64 = 24 << 20;
/// Bytes of which lines are a multiple when they are copied to a texture.
const LINE_BYTES: u64 = 256;
/// From this many spacings per step of rays to lights, the cache is more accurate than these.
const RAY_STEP: f64 = 2.0;
/// A ramp alone, however steep, makes no step shorter than this.
const MIN_RAMP_STEP: f32 = 1.0;

/// The lattice of samples of one fog. It consists of whole blocks, so that few edits move it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct CacheLayout {
    /// The local cell at the first sample.
    pub origin: IVec3,
    /// Samples along each axis.
    pub samples: UVec3,
    pub spacing: Spacing,
}

impl CacheLayout {
    /// The samples for the occupied cells of a grid at a spacing; `None` if they are too many.
    fn new(occupied: CoordBox, spacing: Spacing) -> Option<Self> {
        let block = IVec3::splat(spacing.block);
        let first = occupied.min.div_euclid(block);
        let last = occupied.max.div_euclid(block);
        let blocks = last.checked_sub(first)?.as_uvec3() + 1;
        if blocks.max_element() >= MAX_SAMPLES / BLOCK_INTERVALS {
            return None;
        }
        let samples = blocks * BLOCK_INTERVALS + 1;
        let layout = Self { origin: first.checked_mul(block)?, samples, spacing };
        (layout.staging_bytes() <= MAX_BYTES).then_some(layout)
    }

    /// This many samples, four cells apart, for tests.
    #[cfg(test)]
    pub fn of_samples(samples: UVec3) -> Self {
        Self { origin: IVec3::ZERO, samples, spacing: Spacing { block: 32 } }
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
        let wanted = detail.spacing();
        let beats_rays = |spacing: Spacing| {
            extinction.shadow_largest.is_finite()
                && f64::from(shadow_step) >= RAY_STEP * spacing.in_cells()
        };
        // Rays through a ramp integrate it exactly, whatever their steps.
        let is_fallback = |layout: &CacheLayout| {
            let is_small = layout.samples.as_u64vec3().element_product() <= MAX_FALLBACK_SAMPLES;
            layout.spacing >= Spacing::CELL
                || (is_small && lattice.ramp.is_none() && beats_rays(layout.spacing))
        };
        let layout = Spacing::all()
            .into_iter()
            .filter(|spacing| wanted.is_none_or(|wanted| *spacing >= wanted))
            .filter_map(|spacing| CacheLayout::new(occupied, spacing))
            .find(|layout| wanted == Some(layout.spacing) || is_fallback(layout))?;
        Some(Self {
            layout,
            error: accuracy.error,
            step: with_ramp(detail.step(layout.spacing), lattice.steepness),
            replaces_rays: wanted == Some(layout.spacing) || beats_rays(layout.spacing),
        })
    }
}

/// The step through a fog whose ramp is this steep. Between samples, the ramp is integrated over values that
/// are taken for linear: their error is that of the square of the step, and a ramp multiplies it by its steepness.
fn with_ramp(step: f32, steepness: f32) -> f32 {
    step.min((step / steepness.sqrt()).max(MIN_RAMP_STEP))
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
    use super::super::extinction::tests::fog;
    use super::super::fog_error::tests::multiple;
    use super::*;

    #[test]
    fn all_cells_are_between_samples() {
        for (min, max) in [(IVec3::ZERO, IVec3::ZERO), (IVec3::new(-5, 31, 33), IVec3::splat(64))] {
            for spacing in Spacing::all() {
                let layout = CacheLayout::new(CoordBox { min, max }, spacing).unwrap();
                assert!(layout.origin.cmple(min).all());
                assert!((layout.origin + spacing.block).cmpgt(min).all());
                let cells = (layout.samples - 1).as_dvec3() * spacing.in_cells();
                let end = layout.origin + cells.as_ivec3();
                let before = end - spacing.block;
                assert!(end.cmpgt(max).all() && before.cmple(max).all(), "{layout:?}");
            }
        }
        let lowest = CoordBox { min: IVec3::MIN, max: IVec3::MIN + 3 };
        let has_blocks = Spacing::all().map(|spacing| CacheLayout::new(lowest, spacing).is_some());
        let has_multiple = Spacing::all().map(|spacing| i32::MIN % spacing.block == 0);
        assert_eq!(has_blocks, has_multiple, "others would begin below all coordinates");
        let all = CoordBox { min: IVec3::MIN, max: IVec3::MAX };
        assert_eq!(CacheLayout::new(all, Spacing::CELL), None);
        let long = |length| CoordBox { min: IVec3::ZERO, max: IVec3::new(0, 0, length - 1) };
        let most = (MAX_SAMPLES - BLOCK_INTERVALS) as i32;
        assert!(CacheLayout::new(long(most), Spacing::CELL).is_some());
        assert_eq!(
            CacheLayout::new(long(most + 1), Spacing::CELL),
            None,
            "too many samples in a line"
        );
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
        assert!(found[0].replaces_rays && found[0].layout.spacing > Spacing::CELL, "{found:?}");
        assert!(!found[1].replaces_rays && found[1].layout.spacing == Spacing::CELL, "{found:?}");
        let dense = fog(IVec3::ZERO, IVec3::splat(512), 4.0);
        let found = of(&[large, dense]);
        assert!(found.iter().all(|fog| fog.is_some_and(|fog| !fog.replaces_rays)), "{found:?}");
    }

    #[test]
    fn fogs_whose_error_cannot_be_kept_have_the_finest_samples_that_fit() {
        let of = |edge, density| {
            let (volume, lattice) = fog(IVec3::ZERO, IVec3::splat(edge), density);
            let found = find_cached_fogs(multiple(0.01), &[volume], &[&lattice])[0];
            found.map(|fog| (fog.layout.spacing.in_cells(), fog.replaces_rays))
        };
        assert_eq!(of(64, 0.03), Some((2.0, true)));
        assert_eq!(of(64, 1.0), Some((0.5, true)));
        assert_eq!(of(64, 4.0), Some((0.25, true)));
        assert_eq!(of(64, 5.0), Some((1.0, false)), "too dense");
        assert_eq!(of(512, 4.0), Some((2.0, false)), "too dense, and too large for the finest");
        assert_eq!(of(4096, 0.001), None, "too large");
        assert_eq!(of(64, f32::INFINITY), Some((1.0, false)));
    }

    #[test]
    fn rays_take_the_place_of_the_cache_only_if_they_are_finer() {
        let of_density = |edge, density, ramp, shadow_step| {
            let (mut volume, mut lattice) = fog(IVec3::ZERO, IVec3::splat(edge), density);
            volume.shadow_step = shadow_step;
            lattice.ramp = ramp;
            let found = find_cached_fogs(multiple(0.01), &[volume], &[&lattice])[0];
            found.map(|fog| (fog.layout.spacing.in_cells(), fog.replaces_rays))
        };
        let of = |edge, shadow_step| of_density(edge, 5.0, None, shadow_step);
        assert_eq!(of(32, 0.25), Some((1.0, false)));
        assert_eq!([1.0, 2.0, 8.0].map(|step| of(64, step)), [Some((0.25, true)); 3]);
        assert_eq!([0.5, 1.0, 8.0].map(|step| of(32, step)), [Some((0.25, true)); 3]);
        // A quarter of a voxel would take too much memory, and three eighths are not finer than half a step.
        assert_eq!([0.5, 1.0].map(|step| of(100, step)), [Some((1.0, false)), Some((0.375, true))]);
        assert_eq!([1.0, 2.0].map(|step| of(200, step)), [Some((1.0, false)), Some((0.75, true))]);
        // One that keeps the error, but does not fit.
        assert_eq!(of_density(100, 6.2, None, 1.0), Some((0.375, true)));
        let with_ramp = |step| of_density(32, 5.0, Some(1), step);
        assert_eq!(
            [1.0, 2.0].map(with_ramp),
            [Some((1.0, false)), Some((1.0, true))],
            "rays are exact"
        );
        for bad in [f32::NAN, f32::INFINITY] {
            assert_eq!(of_density(32, bad, None, 8.0), Some((1.0, false)));
        }
        assert_eq!([2.0, 4.0].map(|step| of(512, step)), [Some((2.0, false)), Some((2.0, true))]);
    }
}
