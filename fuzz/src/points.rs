//! Points, and the volumes made of them.

use vdb_core::synth::Random;
use vdb_core::tools::{
    PointNumber, PointsToFog, PointsToLevelSet, points_to_fog, points_to_level_set,
};
use vdb_core::{PointGrid, Points, VdbFile};

use super::{TREE_BYTES, limits, pick};

/// The most points of which a volume is made.
const POINTS: usize = 2000;

pub(super) fn check(file: &VdbFile, random: &mut Random) {
    for grid in &file.points {
        let points = &grid.points;
        assert!(points.bytes() <= TREE_BYTES, "{} bytes of points", points.bytes());
        assert_eq!(points.bounds().is_some(), !points.is_empty());
        for attribute in points.attributes() {
            let count = points.len() * attribute.values_per_point as usize;
            assert!(attribute.values.as_ref().is_none_or(|values| values.len() == count));
        }
        for group in points.groups() {
            let members = points.in_group(&group.name).expect("a group has members");
            assert_eq!(members.len(), points.len());
        }
        if points.len() <= POINTS {
            volumes(grid, random);
        }
    }
}

/// Whether all points are where voxels can be, so that they can be written.
pub(super) fn have_voxels(file: &VdbFile) -> bool {
    let is_there = |c: f64| !c.is_finite() || (-2_147_483_648.5..2_147_483_647.5).contains(&c);
    let points = file.points.iter().flat_map(|grid| grid.points.positions());
    points.flat_map(|position| position.to_array()).all(is_there)
}

/// Compares the points of two files. `first` is set if `a` has never been written: its points may
/// then be in another order, and it may have attributes that are not read.
pub(super) fn assert_same(a: &VdbFile, b: &VdbFile, first: bool) {
    assert_eq!(a.points.len(), b.points.len());
    for (a, b) in a.points.iter().zip(&b.points) {
        assert_eq!((&a.name, &a.transform), (&b.name, &b.transform));
        let (a, b) = (&a.points, &b.points);
        let places = |points: &Points| {
            let bits = |c: f64| if c.is_nan() { f64::NAN.to_bits() } else { c.to_bits() };
            let mut places: Vec<[u64; 3]> =
                points.positions().iter().map(|p| p.to_array().map(bits)).collect();
            if first {
                places.sort_unstable();
            }
            places
        };
        assert!(places(a) == places(b), "positions differ");
        let read = a.attributes().iter().filter(|attribute| attribute.is_read());
        for (own, theirs) in read.zip(b.attributes()) {
            assert_eq!((&own.name, own.values_per_point), (&theirs.name, theirs.values_per_point));
            // Debug output tells zeros apart, and NaN from other numbers.
            let same = || format!("{:?}", own.values) == format!("{:?}", theirs.values);
            assert!(first || same(), "the values of {:?} differ", own.name);
        }
    }
}

fn volumes(grid: &PointGrid, random: &mut Random) {
    let size = grid.transform.voxel_size().x * pick(random, &[0.5, 1.0, 2.0]);
    // In voxels, so that the time for each point has a bound.
    let radius = PointNumber::Constant(size * pick(random, &[0.0, 0.3, 1.0, 2.5]));
    let (fog, surface) = (PointsToFog::new(size), PointsToLevelSet::new(size, radius.clone()));
    if let Ok(fog) = points_to_fog(grid, &PointsToFog { radius, limits: limits(), ..fog }) {
        assert!(fog.tree.stats().bytes <= 2 * TREE_BYTES);
    }
    if let Ok(made) = points_to_level_set(grid, &PointsToLevelSet { limits: limits(), ..surface }) {
        assert!(made.tree.active_voxel_count() > 0);
    }
}
