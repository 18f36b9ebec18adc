//! What tools ask of the grids that they are given.

use std::sync::Arc;

use super::ToolError;
use crate::tree::Vdb543;
use crate::{AnyTree, Grid, GridClass, ProgressFn, Transform};

/// The tree of a grid of floats.
pub(super) fn floats(grid: &Grid) -> Result<&Vdb543<f32>, ToolError> {
    match &grid.tree {
        AnyTree::Float(tree) => Ok(tree),
        _ => Err(ToolError::NotFloats),
    }
}

/// A grid with another tree, and the name and the metadata of the first.
pub(super) fn replaced(grid: &Grid, tree: Vdb543<f32>) -> Grid {
    with_any_tree(grid, AnyTree::Float(tree.into()))
}

/// The same with a tree of any type.
pub(super) fn with_any_tree(grid: &Grid, tree: AnyTree) -> Grid {
    Grid { tree, file_bytes: 0, instance_of: None, ..grid.clone() }
}

/// The edge of the voxels of a transform, which must be cubes.
pub(super) fn cube_edge(transform: &Transform) -> Result<f64, ToolError> {
    let size = transform.voxel_size();
    let equal = (size - size.x).abs().max_element() <= 1e-6 * size.x;
    let right = transform.linear().is_some_and(|world_from_index| {
        let [x, y, z] = [0, 1, 2].map(|axis| world_from_index.matrix3.col(axis));
        let cosines = [x.dot(y), y.dot(z), z.dot(x)];
        cosines.iter().all(|dot| dot.abs() <= 1e-6 * size.x * size.x)
    });
    if equal && right { Ok(size.x) } else { Err(ToolError::NotCubes { size: size.to_array() }) }
}

/// The tree of a level set.
pub(super) fn level_set_tree(grid: &Grid) -> Result<&Vdb543<f32>, ToolError> {
    let tree = floats(grid)?;
    if grid.class != GridClass::LevelSet {
        return Err(ToolError::NotLevelSet { class: grid.class.name() });
    }
    Ok(tree)
}

/// The half width of the band of a level set, in voxels with this edge.
pub(super) fn half_width(tree: &Vdb543<f32>, edge: f64) -> Result<f32, ToolError> {
    let background = tree.background();
    let half_width = (f64::from(background) / edge) as f32;
    if half_width >= 1.0 && half_width.is_finite() {
        Ok(half_width.min(MOST_HALF_WIDTH))
    } else {
        Err(ToolError::NoBand { background, edge })
    }
}

/// The tree, the edge of a voxel, and the half width of the band in voxels of a level set.
pub(super) fn level_set(grid: &Grid) -> Result<(&Vdb543<f32>, f64, f32), ToolError> {
    let tree = level_set_tree(grid)?;
    let edge = cube_edge(&grid.transform)?;
    Ok((tree, edge, half_width(tree, edge)?))
}

/// The widest half of a band, in voxels.
const MOST_HALF_WIDTH: f32 = 100.0;

/// The progress of one of several passes.
pub(super) fn pass(
    progress: Option<&Arc<ProgressFn>>,
    pass: u64,
    passes: u64,
) -> Option<Arc<ProgressFn>> {
    /// Steps of a pass.
    const STEPS: u64 = 1000;
    let progress = progress?.clone();
    Some(Arc::new(move |done, all| {
        let part = (u128::from(done) * u128::from(STEPS) / u128::from(all.max(1))) as u64;
        progress(pass * STEPS + part, passes * STEPS)
    }))
}
