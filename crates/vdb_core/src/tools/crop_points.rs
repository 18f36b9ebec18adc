//! Points in a box.

use super::{Crop, ToolError};
use crate::PointGrid;

/// Keeps the points that are in a box in world space, with their attributes and groups. Points
/// without a place, at NaN, are left out. Transforms of all kinds will do.
///
/// Of the options, only the box is used. The result takes no more memory than the points.
///
/// # Errors
/// If the box has no inside.
pub fn crop_points(grid: &PointGrid, options: &Crop) -> Result<PointGrid, ToolError> {
    let [low, high] = options.corners()?;
    let is_inside = |position| low.cmple(position).all() && position.cmple(high).all();
    let kept: Vec<bool> = grid.world_positions().map(is_inside).collect();
    Ok(grid.with_points(grid.points.kept(&kept)))
}
