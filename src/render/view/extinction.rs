//! The extinctions that rays meet in fogs, which decide how fine their samples in the light cache are.

use bevy::math::DVec3;

use super::lattice::Lattice;
use crate::render::gpu::types;

/// The largest extinctions per world unit that rays meet in a fog.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Extinction {
    /// For view rays: the root of the sum of squares over all fogs. Errors of steps come from details that a step
    /// misses, and details of different fogs are taken to be independent.
    pub all: f64,
    /// For rays to lights: the sum over fogs that cast shadows, because optical depths add up.
    pub casters: f64,
}

impl Extinction {
    fn add(&mut self, other: Self, weight: f64) {
        self.all = self.all.hypot(other.all * weight);
        self.casters += other.casters * weight;
    }
}

/// Bounds and extinction of a fog, in world space.
pub(super) struct FogBox {
    pub entry: usize,
    min: DVec3,
    max: DVec3,
    /// Of the fog itself.
    own: Extinction,
    /// Of this fog and of all whose boxes overlap its box.
    pub total: Extinction,
}

impl FogBox {
    /// `None` if an entry is not a fog, or is empty.
    pub fn new(entry: usize, volume: &types::Volume, lattice: &Lattice) -> Option<Self> {
        if volume.kind != types::KIND_FOG {
            return None;
        }
        let (min, max) = lattice.world_box()?;
        let all = f64::from(volume.density_scale) * f64::from(lattice.majorant);
        let casts = volume.flags & types::NO_CASTER == 0;
        let own = Extinction { all, casters: if casts { all } else { 0.0 } };
        Some(Self { entry, min, max, own, total: own })
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Adds the extinction of a fog that overlaps this one: its root mean square over this box, so
    /// that a small fog hardly affects the samples of a large one.
    fn add(&mut self, other: &Self) {
        let overlap = self.max.min(other.max) - self.min.max(other.min);
        let fraction = (overlap / (self.max - self.min)).element_product();
        self.total.add(other.own, fraction.sqrt());
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

/// Combines the extinctions of each fog and of all that overlap it.
pub(super) fn add_overlapping(fogs: &mut [FogBox]) {
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

#[cfg(test)]
pub(super) mod tests {
    use bevy::math::{DAffine3, IVec3};
    use vdb_core::tree::CoordBox;

    use super::*;

    /// A fog of unit cells with this density, which casts shadows.
    pub fn fog(min: IVec3, max: IVec3, density: f32) -> (types::Volume, Lattice) {
        let volume =
            types::Volume { kind: types::KIND_FOG, density_scale: 1.0, ..Default::default() };
        let occupied = CoordBox { min, max: max - 1 };
        let lattice = Lattice::of_cells(DAffine3::IDENTITY, occupied, density);
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
    fn extinctions_of_overlapping_fogs_are_combined() {
        let cube = |at: IVec3, edge, density| fog(at, at + edge, density);
        let same = [cube(IVec3::ZERO, 64, 0.25), cube(IVec3::ZERO, 64, 0.5)];
        assert_eq!(totals(&same), [[0.25_f64.hypot(0.5), 0.75]; 2]);
        let apart = |axis| {
            let mut at = IVec3::ZERO;
            at[axis] = 100;
            [cube(IVec3::ZERO, 64, 0.25), cube(at, 64, 0.5), cube(at / 2, 64, 1.0)]
        };
        for axis in 0..3 {
            let found = totals(&apart(axis));
            let share = (14.0_f64 / 64.0).sqrt();
            let middle = 1.0_f64.hypot(0.25 * share).hypot(0.5 * share);
            let all = [0.25_f64.hypot(share), 0.5_f64.hypot(share), middle];
            let casters = [0.25 + share, 0.5 + share, 1.0 + 0.75 * share];
            for (found, expected) in found.into_iter().zip(all.into_iter().zip(casters)) {
                assert!((found[0] - expected.0).abs() < 1e-12, "{found:?}");
                assert!((found[1] - expected.1).abs() < 1e-12, "{found:?}");
            }
            assert_eq!(totals(&apart(axis)[..2]), [[0.25; 2], [0.5; 2]]);
        }
    }

    #[test]
    fn fogs_without_shadows_dim_only_view_rays() {
        let mut fogs = [fog(IVec3::ZERO, IVec3::splat(64), 0.25); 2];
        fogs[1].0.flags = types::NO_CASTER;
        fogs[1].1.majorant = 0.5;
        assert_eq!(totals(&fogs), [[0.25_f64.hypot(0.5), 0.25]; 2]);
        assert_eq!(totals(&fogs[1..]), [[0.5, 0.0]]);
        fogs[1].0.kind = types::KIND_EMISSION;
        assert_eq!(totals(&fogs), [[0.25; 2]], "only fogs attenuate");
    }

    #[test]
    fn a_small_dense_fog_hardly_counts_in_a_large_thin_one() {
        let large = fog(IVec3::ZERO, IVec3::splat(512), 0.01);
        let small = fog(IVec3::splat(240), IVec3::splat(256), 4.0);
        let share = (16.0_f64 / 512.0).powf(1.5);
        let found = totals(&[large, small]);
        let thin = f64::from(0.01_f32);
        assert!((found[0][0] - thin.hypot(4.0 * share)).abs() < 1e-12, "{found:?}");
        assert!((found[0][1] - (thin + 4.0 * share)).abs() < 1e-12, "{found:?}");
        assert!((found[1][1] - (thin + 4.0)).abs() < 1e-12, "{found:?}");
    }
}
