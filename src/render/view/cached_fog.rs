//! Which fogs can be in the light cache, and the samples that they need there.

use bevy::math::{DMat3, DVec3, IVec3, UVec3};
use vdb_core::tree::CoordBox;

use super::lattice::Lattice;
use crate::render::gpu::{MAX_GROUPS, types};

/// Intervals between samples along an edge of a brick of the light cache.
pub(crate) const BRICK_INTERVALS: u32 = 8;
/// The most bricks of a fog for a light: 106 MB, within WebGPU's default limit of a binding.
const MAX_BRICKS: u32 = 1 << 16;
/// Workgroups that fill a brick of the light cache, along z; each fills a third of its samples.
pub(crate) const GROUPS_PER_BRICK: u32 = 3;
/// The most bricks along an axis, so that their workgroups are one dispatch.
const MAX_BRICKS_OF_AXIS: u32 = MAX_GROUPS / GROUPS_PER_BRICK;
/// log₂ of the largest spacing in cells: an edge of a leaf.
const MAX_LOG: u32 = 3;
/// The shortest and the longest step of a ray, in voxels.
const MIN_STEP: f64 = 0.25;
const MAX_STEP: f64 = 8.0;

/// The lattice of samples of one fog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct CacheLayout {
    /// The local cell at the first sample.
    pub origin: IVec3,
    /// Bricks along each axis.
    pub bricks: UVec3,
    /// log₂ of the cells between samples.
    pub log: u32,
}

impl CacheLayout {
    /// The samples for the occupied cells of a grid at a spacing; `None` if they are too many.
    fn new(occupied: CoordBox, log: u32) -> Option<Self> {
        // Bricks at multiples of their size do not move when voxels are edited.
        let shift = log + BRICK_INTERVALS.ilog2();
        let first = occupied.min >> shift as i32;
        let last = occupied.max >> shift as i32;
        let bricks = last.checked_sub(first)?.as_uvec3() + 1;
        let count = bricks.x.checked_mul(bricks.y)?.checked_mul(bricks.z)?;
        let fits = count <= MAX_BRICKS && bricks.max_element() <= MAX_BRICKS_OF_AXIS;
        fits.then_some(Self { origin: first << shift as i32, bricks, log })
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
    /// Whether the samples are within the accepted error. Others are only for pipelines that cannot light
    /// fog by rays.
    pub is_within_error: bool,
}

impl CachedFog {
    /// The samples that keep the radiance of a fog within a relative error or, if there are none,
    /// the finest that fit. `None` if the fog is empty or too large.
    fn new(error: f32, extinction: Extinction, lattice: &Lattice) -> Option<Self> {
        let occupied = lattice.occupied?;
        let detail = Detail::new(error, &extinction, cell_edge(lattice), occupied);
        let wanted = detail.spacing_log();
        let layout =
            (wanted.unwrap_or(0)..=MAX_LOG).find_map(|log| CacheLayout::new(occupied, log))?;
        Some(Self {
            layout,
            error,
            step: detail.step(),
            is_within_error: wanted == Some(layout.log),
        })
    }
}

/// Steps of a ray along the longest edge of a fog for a relative error of 1 %.
const STEPS: f64 = 100.0;

/// What the samples of a fog have to resolve.
#[derive(Clone, Copy, Debug)]
struct Detail {
    /// The relative error of the radiance (root mean square) that is accepted.
    error: f32,
    /// Optical depth through the densest cell, as far as its details matter.
    depth_per_cell: f64,
    /// Optical depth through the densest cell for rays to lights.
    shadow_per_cell: f64,
    /// The longest edge of the occupied cells.
    edge: f64,
}

impl Detail {
    fn new(error: f32, extinction: &Extinction, cell_edge: f64, occupied: CoordBox) -> Self {
        let CoordBox { min, max } = occupied;
        Self {
            error,
            depth_per_cell: extinction.of_steps() * cell_edge,
            shadow_per_cell: extinction.casters * cell_edge,
            edge: (max.as_dvec3() - min.as_dvec3()).max_element() + 1.0,
        }
    }

    /// log₂ of the largest spacing of samples, in cells, that keeps the error; `None` if even a spacing
    /// of one cell does not.
    ///
    /// Linear interpolation errs by the square of the spacing. For clouds of fractal noise, whose
    /// details are a fixed part of the whole, the error is 2.5 times the optical depth per cell and
    /// the square of the spacing, divided by the cells across. `docs/internals/notebook.md` has the
    /// measurements.
    fn spacing_log(&self) -> Option<u32> {
        let spacing = (f64::from(self.error) * self.edge / (2.5 * self.shadow_per_cell)).sqrt();
        // An error of 0.01 is a little less in f32.
        let log = spacing.log2() + 1e-6;
        (log >= 0.0).then(|| (log as u32).min(MAX_LOG))
    }

    /// Cells between samples of density along a ray that keep the error.
    ///
    /// For clouds of fractal noise, it is 0.35 % of the mean radiance times the root of the optical
    /// depth per cell and the square of the step.
    fn step(&self) -> f32 {
        let error = f64::from(self.error);
        let by_depth = (error / (0.0035 * self.depth_per_cell.sqrt())).sqrt();
        let by_size = self.edge / STEPS * (error / 0.01).sqrt();
        by_depth.min(by_size).clamp(MIN_STEP, MAX_STEP) as f32
    }
}

/// The longest edge of a cell, in world units.
pub(crate) fn cell_edge(lattice: &Lattice) -> f64 {
    let axes = lattice.world_from_local.matrix3;
    [axes.x_axis, axes.y_axis, axes.z_axis]
        .map(|axis| axis.length())
        .into_iter()
        .fold(0.0, f64::max)
}

/// The largest extinctions per world unit that rays meet in a fog.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Extinction {
    /// Of all fogs, which view rays meet.
    all: f64,
    /// The square of `all` without the products of fogs whose details are independent.
    squares: f64,
    /// Of fogs that cast shadows, which rays to lights meet.
    casters: f64,
}

impl Extinction {
    /// Of a fog by itself.
    fn of_fog(all: f64, casts: bool) -> Self {
        Self { all, squares: all * all, casters: if casts { all } else { 0.0 } }
    }

    /// Adds a fog to those that overlap `own`.
    fn add(&mut self, own: &Self, other: &Self, weight: f64, is_aligned: bool) {
        let added = other.all * weight;
        self.all += added;
        self.casters += other.casters * weight;
        self.squares += added * added;
        if is_aligned {
            self.squares += 2.0 * own.all * added;
        }
    }

    /// The extinction of a fog that needs the same steps.
    ///
    /// The error of steps is proportional to the relative variation of the extinction. Independent details
    /// average out: of fogs with extinctions `d`, it is `√(Σ d²) / Σ d` of that of one fog. It is also
    /// proportional to the root of the extinction, so together `Σ d² / Σ d` counts.
    fn of_steps(&self) -> f64 {
        if self.all > 0.0 { self.squares / self.all } else { 0.0 }
    }
}

/// Bounds and extinction of a fog, in world space.
struct FogBox {
    entry: usize,
    min: DVec3,
    max: DVec3,
    /// Cells in world space.
    axes: DMat3,
    /// Of the fog itself.
    own: Extinction,
    /// Of this fog and of all whose boxes overlap its box.
    total: Extinction,
}

impl FogBox {
    /// `None` if an entry is not a fog, or is empty.
    fn new(entry: usize, volume: &types::Volume, lattice: &Lattice) -> Option<Self> {
        if volume.kind != types::KIND_FOG {
            return None;
        }
        let (min, max) = lattice.world_box()?;
        let all = f64::from(volume.density_scale) * f64::from(lattice.majorant);
        let casts = volume.flags & types::NO_CASTER == 0;
        let own = Extinction::of_fog(all, casts);
        let axes = lattice.world_from_local.matrix3;
        Some(Self { entry, min, max, axes, own, total: own })
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Adds the extinction of a fog that overlaps this one: its root mean square over this box, so
    /// that a small fog hardly affects the samples of a large one.
    fn add(&mut self, other: &Self) {
        let overlap = self.max.min(other.max) - self.min.max(other.min);
        let fraction = (overlap / (self.max - self.min)).element_product();
        // Grids of one simulation have their details in the same places. They have the same cells.
        let is_aligned = self.axes == other.axes;
        self.total.add(&self.own, &other.own, fraction.sqrt(), is_aligned);
    }
}

/// The axis along which boxes overlap least: their edges are short compared with all of them
/// together.
fn sweep_axis(fogs: &[FogBox]) -> usize {
    let crowding = |axis: usize| {
        let min = fogs.iter().map(|fog| fog.min[axis]).fold(f64::INFINITY, f64::min);
        let max = fogs.iter().map(|fog| fog.max[axis]).fold(f64::NEG_INFINITY, f64::max);
        fogs.iter().map(|fog| fog.max[axis] - fog.min[axis]).sum::<f64>() / (max - min)
    };
    let crowdings = [0, 1, 2].map(crowding);
    (0..3).min_by(|&a, &b| crowdings[a].total_cmp(&crowdings[b])).unwrap_or(0)
}

/// Adds up the extinctions of fogs that overlap.
fn add_overlapping(fogs: &mut [FogBox]) {
    let axis = sweep_axis(fogs);
    fogs.sort_unstable_by(|a, b| a.min[axis].total_cmp(&b.min[axis]));
    for first in 0..fogs.len() {
        let (before, after) = fogs.split_at_mut(first + 1);
        let own = &mut before[first];
        let end = own.max[axis];
        for other in after.iter_mut().take_while(|other| other.min[axis] <= end) {
            if own.overlaps(other) {
                own.add(other);
                other.add(own);
            }
        }
    }
}

/// For each entry of a view's list, its samples in the light cache for a relative error, if it is a
/// fog that fits; none without an accepted error.
pub(super) fn find_cached_fogs(
    error: f32,
    volumes: &[types::Volume],
    lattices: &[&Lattice],
) -> Vec<Option<CachedFog>> {
    let mut found = vec![None; lattices.len()];
    if error <= 0.0 {
        return found;
    }
    let entries = volumes.iter().zip(lattices).enumerate();
    let mut fogs: Vec<_> =
        entries.filter_map(|(i, (volume, lattice))| FogBox::new(i, volume, lattice)).collect();
    add_overlapping(&mut fogs);
    for fog in fogs {
        found[fog.entry] = CachedFog::new(error, fog.total, lattices[fog.entry]);
    }
    found
}

#[cfg(test)]
mod tests {
    use bevy::math::{DAffine3, DQuat};

    use super::*;

    #[test]
    fn spacing_follows_the_error() {
        let of = |error, depth_per_cell, edge| {
            let shadow_per_cell = depth_per_cell;
            let detail = Detail { error, depth_per_cell, shadow_per_cell, edge };
            (detail.spacing_log(), detail.step())
        };
        let (log, step) = of(0.01, 0.03, 512.0);
        assert!(log == Some(3) && (3.5..4.1).contains(&step), "{log:?} {step}");
        let (log, step) = of(0.01, 0.12, 512.0);
        assert!(log == Some(2) && (2.8..3.0).contains(&step), "{log:?} {step}");
        assert_eq!(of(0.01, 0.03, 50.0), (Some(1), 0.5), "small grids have small details");
        assert_eq!(of(0.01, 0.4, 64.0).0, None, "light fades within a cell");
        assert_eq!(of(1.0, 0.0, 1e6), (Some(MAX_LOG), MAX_STEP as f32));
        for bad in [f64::NAN, f64::INFINITY] {
            assert_eq!(of(0.01, bad, 64.0).0, None);
        }
    }

    #[test]
    fn all_cells_are_within_bricks() {
        for (min, max) in [(IVec3::ZERO, IVec3::ZERO), (IVec3::new(-5, 31, 33), IVec3::splat(64))] {
            for log in 0..=MAX_LOG {
                let layout = CacheLayout::new(CoordBox { min, max }, log).unwrap();
                let size = (BRICK_INTERVALS << log) as i32;
                assert!(layout.origin.cmple(min).all());
                let end = layout.origin + layout.bricks.as_ivec3() * size;
                assert!(end.cmpgt(max).all() && (end - size).cmple(max).all(), "{layout:?}");
            }
        }
        let all = CoordBox { min: IVec3::MIN, max: IVec3::MAX };
        assert_eq!(CacheLayout::new(all, 0), None);
        let long = |length| CoordBox { min: IVec3::ZERO, max: IVec3::new(0, 0, length - 1) };
        let most = (MAX_BRICKS_OF_AXIS * BRICK_INTERVALS) as i32;
        assert!(CacheLayout::new(long(most), 0).is_some());
        assert_eq!(CacheLayout::new(long(most + 1), 0), None, "too many workgroups");
    }
    /// A fog of unit cells with this density, which casts shadows.
    fn fog(min: IVec3, max: IVec3, density: f32) -> (types::Volume, Lattice) {
        let volume =
            types::Volume { kind: types::KIND_FOG, density_scale: 1.0, ..Default::default() };
        let lattice = Lattice {
            world_from_local: DAffine3::IDENTITY,
            occupied: Some(CoordBox { min, max: max - 1 }),
            majorant: density,
            content: Some(0),
        };
        (volume, lattice)
    }

    /// The extinctions of all fogs and of casters, in the order of the fogs.
    fn totals(fogs: &[(types::Volume, Lattice)]) -> Vec<[f64; 2]> {
        let fogs = fogs.iter().enumerate();
        let mut boxes: Vec<_> =
            fogs.filter_map(|(i, (volume, lattice))| FogBox::new(i, volume, lattice)).collect();
        add_overlapping(&mut boxes);
        boxes.sort_by_key(|fog| fog.entry);
        boxes.iter().map(|fog| [fog.total.all, fog.total.casters]).collect()
    }

    #[test]
    fn extinctions_of_overlapping_fogs_add_up() {
        let cube = |at: IVec3, edge, density| fog(at, at + edge, density);
        let same = [cube(IVec3::ZERO, 64, 0.25), cube(IVec3::ZERO, 64, 0.5)];
        assert_eq!(totals(&same), [[0.75; 2]; 2]);
        let apart = |axis| {
            let mut at = IVec3::ZERO;
            at[axis] = 100;
            [cube(IVec3::ZERO, 64, 0.25), cube(at, 64, 0.5), cube(at / 2, 64, 1.0)]
        };
        for axis in 0..3 {
            let found = totals(&apart(axis));
            let share = (14.0_f64 / 64.0).sqrt();
            let expected = [0.25 + share, 0.5 + share, 1.0 + 0.75 * share];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!(found.into_iter().all(|own| (own - expected).abs() < 1e-12), "{found:?}");
            }
            assert_eq!(totals(&apart(axis)[..2]), [[0.25; 2], [0.5; 2]]);
        }
    }

    #[test]
    fn independent_details_average_out() {
        let of_steps = |turned: &[bool]| {
            let fogs: Vec<_> = turned
                .iter()
                .map(|is_turned| {
                    let (volume, mut lattice) = fog(IVec3::splat(-32), IVec3::splat(32), 0.25);
                    let angle = if *is_turned { std::f64::consts::FRAC_PI_2 } else { 0.0 };
                    lattice.world_from_local = DAffine3::from_quat(DQuat::from_rotation_y(angle));
                    (volume, lattice)
                })
                .collect();
            let fogs = fogs.iter().enumerate();
            let mut boxes: Vec<_> =
                fogs.filter_map(|(i, (volume, lattice))| FogBox::new(i, volume, lattice)).collect();
            add_overlapping(&mut boxes);
            boxes.iter().map(|fog| fog.total.of_steps()).collect::<Vec<_>>()
        };
        let near = |found: &[f64], expected: &[f64]| {
            let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(found.len() == expected.len() && off < 1e-6, "{found:?} {expected:?}");
        };
        near(&of_steps(&[false]), &[0.25]);
        near(&of_steps(&[false, false]), &[0.5; 2]);
        near(&of_steps(&[false, true]), &[0.25; 2]);
        assert_eq!(Extinction::default().of_steps(), 0.0);
    }

    #[test]
    fn fogs_without_shadows_dim_only_view_rays() {
        let mut fogs = [fog(IVec3::ZERO, IVec3::splat(64), 0.25); 2];
        fogs[1].0.flags = types::NO_CASTER;
        fogs[1].1.majorant = 0.5;
        assert_eq!(totals(&fogs), [[0.75, 0.25]; 2]);
        assert_eq!(totals(&fogs[1..]), [[0.5, 0.0]]);
        fogs[1].0.kind = types::KIND_EMISSION;
        assert_eq!(totals(&fogs), [[0.25; 2]], "only fogs attenuate");
    }

    #[test]
    fn a_small_dense_fog_in_a_large_thin_one_leaves_it_in_the_cache() {
        let large = fog(IVec3::ZERO, IVec3::splat(512), 0.01);
        let small = fog(IVec3::splat(240), IVec3::splat(256), 4.0);
        let share = (16.0_f64 / 512.0).powf(1.5);
        let found = totals(&[large, small]);
        assert!((found[0][0] - (f64::from(0.01_f32) + 4.0 * share)).abs() < 1e-12, "{found:?}");
        assert!((found[1][0] - (f64::from(0.01_f32) + 4.0)).abs() < 1e-12, "{found:?}");
        let of = |fogs: &[(types::Volume, Lattice)]| {
            let volumes: Vec<_> = fogs.iter().map(|fog| fog.0).collect();
            let lattices: Vec<_> = fogs.iter().map(|fog| &fog.1).collect();
            find_cached_fogs(0.01, &volumes, &lattices)
        };
        let found = of(&[large, small]).into_iter().map(|fog| fog.unwrap()).collect::<Vec<_>>();
        assert!(found[0].is_within_error && found[0].layout.log > 0, "{found:?}");
        assert!(!found[1].is_within_error && found[1].layout.log == 0, "{found:?}");
        let dense = fog(IVec3::ZERO, IVec3::splat(512), 4.0);
        let found = of(&[large, dense]);
        assert!(found.iter().all(|fog| fog.is_some_and(|fog| !fog.is_within_error)), "{found:?}");
    }

    #[test]
    fn fogs_whose_error_cannot_be_kept_have_the_finest_samples_that_fit() {
        let of = |edge, density| {
            let (volume, lattice) = fog(IVec3::ZERO, IVec3::splat(edge), density);
            let found = find_cached_fogs(0.01, &[volume], &[&lattice])[0];
            found.map(|fog| (fog.layout.log, fog.is_within_error))
        };
        assert_eq!(of(64, 0.03), Some((1, true)));
        assert_eq!(of(64, 4.0), Some((0, false)), "too dense");
        assert_eq!(of(512, 4.0), Some((1, false)), "too dense, and too large for the finest");
        assert_eq!(of(4096, 0.001), None, "too large");
        assert_eq!(of(64, f32::INFINITY), Some((0, false)));
    }
}
