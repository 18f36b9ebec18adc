//! Points of files as volumes.

use vdb_core::tools::{
    PointNumber, PointsToFog, PointsToLevelSet, ToolError, points_to_fog, points_to_level_set,
};
use vdb_core::{Grid, PointGrid, Points};

use super::settings::{VdbLoaderSettings, VdbPoints};

/// The volume of the points of a grid; `None` if they are to be left out.
pub(super) fn volume(
    points: &PointGrid,
    settings: &VdbLoaderSettings,
) -> Option<Result<Grid, ToolError>> {
    let own_size = points.transform.voxel_size().min_element();
    let voxel_size = settings.point_voxel_size.map_or(own_size, f64::from);
    let radius = match settings.point_radius {
        Some(radius) => PointNumber::Constant(radius.into()),
        None if points.points.floats(Points::RADIUS).is_some() => {
            PointNumber::Attribute { name: Points::RADIUS.into(), scale: 1.0 }
        }
        None => PointNumber::Constant(voxel_size),
    };
    let limits = settings.limits.clone();
    let made = match settings.points {
        VdbPoints::Skip => return None,
        VdbPoints::Fog => {
            let options = PointsToFog { radius, limits, ..PointsToFog::new(voxel_size) };
            points_to_fog(points, &options)
        }
        VdbPoints::Balls => {
            let options = PointsToLevelSet { limits, ..PointsToLevelSet::new(voxel_size, radius) };
            points_to_level_set(points, &options)
        }
    };
    Some(made.map(|mut grid| {
        grid.name.clone_from(&points.name);
        grid.unique_name.clone_from(&points.unique_name);
        grid
    }))
}
