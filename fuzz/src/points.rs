//! Points, and the volumes made of them.

use vdb_core::synth::Random;
use vdb_core::tools::{
    PointNumber, PointsToFog, PointsToLevelSet, points_to_fog, points_to_level_set,
};
use vdb_core::{PointGrid, VdbFile};

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
