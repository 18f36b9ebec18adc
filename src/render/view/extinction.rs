//! The extinctions that rays meet in fogs and their detail, which decide how fine the samples in the light cache are.

use bevy::math::DVec3;

use super::lattice::Lattice;
use crate::render::gpu::types;

/// Second differences of a fog's extinction at distances of 1, 2 and 4 of its cells: see
/// [`FogDetail`](vdb_core::pack::FogDetail). Per world unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Differences(pub [f64; 3]);

impl Differences {
    /// The second difference at a distance, in cells. It is taken never to fall with distance, although that of what
    /// repeats after a few cells does.
    ///
    /// Density is linear within a cell, with a kink where cells meet. The shorter a distance below one cell, the fewer
    /// second differences span a kink, and the less each of them sees of it.
    pub fn at(self, distance: f64) -> f64 {
        let Self([one, two, four]) = self;
        let two = two.max(one);
        let four = four.max(two);
        let between = |low: f64, high: f64, part: f64| low.powf(1.0 - part) * high.powf(part);
        match distance {
            d if d < 1.0 => one * d * d.sqrt(),
            d if d < 2.0 => between(one, two, d.log2()),
            d if d < 4.0 => between(two, four, d.log2() - 1.0),
            _ if four == 0.0 => 0.0,
            // It goes on growing as it has grown so far, at most as in a smooth fog.
            d => four * (four / two).min(4.0).powf(d.log2() - 2.0),
        }
    }
}

/// The extinctions that rays meet in a fog, per world unit, for view rays and for rays to lights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Extinction {
    /// The mean over voxels that are not empty, plus that of each other fog times the fraction of this fog's box that
    /// it overlaps.
    pub mean: f64,
    /// The largest, for view rays: the root of the sum of squares over all fogs. Errors of steps come from details that
    /// a step misses, and details of different fogs are taken to be independent.
    pub largest: f64,
    /// Second differences for view rays, combined in the same way.
    pub differences: Differences,
    /// The largest, for rays to lights: the sum over fogs that cast shadows, because optical depths add up.
    pub shadow_largest: f64,
    /// Second differences for rays to lights, combined in the same way.
    pub shadow_differences: Differences,
}

impl Extinction {
    /// The second difference for view rays at a distance in cells. It is at most twice the largest extinction, because
    /// no three values between 0 and a maximum have a second difference above twice that maximum.
    pub fn difference(&self, distance: f64) -> f64 {
        self.differences.at(distance).min(2.0 * self.largest)
    }

    /// The second difference for rays to lights.
    pub fn shadow_difference(&self, distance: f64) -> f64 {
        self.shadow_differences.at(distance).min(2.0 * self.shadow_largest)
    }
}

/// Bounds and extinction of a fog, in world space.
pub(super) struct FogBox {
    pub entry: usize,
    min: DVec3,
    max: DVec3,
    cell: f64,
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
        let largest = f64::from(volume.density_scale) * f64::from(lattice.majorant);
        let mean = largest * f64::from(lattice.detail.mean);
        let differences = Differences(lattice.detail.differences.map(|d| largest * f64::from(d)));
        let mut own = Extinction { mean, largest, differences, ..Extinction::default() };
        if volume.flags & types::NO_CASTER == 0 {
            own = Extinction { shadow_largest: largest, shadow_differences: differences, ..own };
        }
        Some(Self { entry, min, max, cell: lattice.cell_edge(), own, total: own })
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Adds the extinction of a fog that overlaps this one: its mean and its root mean square over this box, so
    /// that a small fog hardly affects the samples of a large one.
    fn add(&mut self, other: &Self) {
        let overlap = self.max.min(other.max) - self.min.max(other.min);
        let fraction = (overlap / (self.max - self.min)).element_product();
        let weight = fraction.sqrt();
        self.total.mean += fraction * other.own.mean;
        self.total.largest = self.total.largest.hypot(weight * other.own.largest);
        self.total.shadow_largest += weight * other.own.shadow_largest;
        for (i, cells) in [1.0, 2.0, 4.0].into_iter().enumerate() {
            let distance = cells * self.cell / other.cell;
            let own = &mut self.total.differences.0[i];
            *own = own.hypot(weight * other.own.difference(distance));
            self.total.shadow_differences.0[i] += weight * other.own.shadow_difference(distance);
        }
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

    /// The extinctions of fogs with all that overlap them, in the order of the fogs.
    fn combined(fogs: &[(types::Volume, Lattice)]) -> Vec<Extinction> {
        let fogs = fogs.iter().enumerate();
        let mut boxes: Vec<_> =
            fogs.filter_map(|(i, (volume, lattice))| FogBox::new(i, volume, lattice)).collect();
        add_overlapping(&mut boxes);
        boxes.sort_by_key(|fog| fog.entry);
        boxes.into_iter().map(|fog| fog.total).collect()
    }

    /// The extinctions for view rays and for rays to lights. Second differences at a cell's distance are in proportion.
    fn totals(fogs: &[(types::Volume, Lattice)]) -> Vec<[f64; 2]> {
        let relative = |differences: Differences| differences.0[0] * 64.0;
        let both = |fog: Extinction| {
            let found = [fog.differences, fog.shadow_differences].map(relative);
            let [all, casters] = [fog.largest - found[0], fog.shadow_largest - found[1]];
            assert!(all.abs() < 1e-12 && casters.abs() < 1e-12, "{fog:?}");
            found
        };
        combined(fogs).into_iter().map(both).collect()
    }

    #[test]
    fn differences_go_on_below_and_beyond_what_is_measured() {
        let of = Differences([0.01, 0.04, 0.08]);
        let near = |distance, expected: f64| {
            let found = of.at(distance);
            assert!((found / expected - 1.0).abs() < 1e-9, "{distance}: {found}");
        };
        near(0.25, 0.01 / 8.0);
        near(1.0, 0.01);
        near(f64::sqrt(2.0), 0.02);
        near(2.0, 0.04);
        near(4.0, 0.08);
        near(16.0, 0.32);
        assert_eq!(Differences([0.0, 0.0, 1.0]).at(8.0), 4.0, "at most as the square");
        assert_eq!([1.5, 2.0, 8.0].map(|at| Differences([3.0, 0.0, 1.0]).at(at)), [3.0; 3]);
        assert_eq!([0.5, 1.5, 3.0, 64.0].map(|at| Differences::default().at(at)), [0.0; 4]);
    }

    #[test]
    fn a_finer_fog_differs_by_no_more_than_all_of_it() {
        let fine = fog(IVec3::ZERO, IVec3::splat(4), 0.25);
        let mut finer = fog(IVec3::ZERO, IVec3::splat(4000), 0.25);
        finer.1.world_from_local = DAffine3::from_scale(DVec3::splat(1e-3));
        let [found, _] = combined(&[fine, finer])[..] else { panic!() };
        assert!(found.differences.0.into_iter().all(|difference| difference < 0.51), "{found:?}");
    }

    #[test]
    fn fogs_meet_in_the_cells_of_each() {
        let fine = fog(IVec3::ZERO, IVec3::splat(64), 0.25);
        let mut coarse = fog(IVec3::ZERO, IVec3::splat(32), 1.0);
        coarse.1.world_from_local = DAffine3::from_scale(DVec3::splat(2.0));
        let [first, second] = combined(&[fine, coarse])[..] else { panic!() };
        // One fine cell is half a coarse one, and one coarse cell is two fine ones.
        let all = |fog: Extinction| fog.shadow_differences.0.map(|difference| difference * 64.0);
        assert_eq!(all(first)[1..], [0.75 + 1.0, 1.5 + 3.0]);
        assert!((all(first)[0] - 0.25 - f64::sqrt(0.125)).abs() < 1e-12);
        assert_eq!(all(second)[..2], [1.0 + 0.75, 3.0 + 1.5]);
        assert_eq!([first.mean, second.mean], [0.625; 2]);
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
