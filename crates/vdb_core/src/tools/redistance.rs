//! Distances again, after a level set was changed.

use std::sync::Arc;

use super::from_mesh::{self, InsideRule};
use super::{LevelSetToMesh, MeshToLevelSet, ToolError, level_set_to_mesh};
use crate::{AnyTree, Grid, GridClass, Limits, ProgressFn, Transform};

/// Options of [`redistance`].
#[derive(Clone)]
pub struct Redistance {
    /// Voxels from the surface to either end of the band: 1 to 100. 3 by default.
    pub half_width: f32,
    /// The value of the surface, which becomes 0. With another value than 0, a level set grows or
    /// shrinks by that distance.
    pub iso: f32,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl Default for Redistance {
    fn default() -> Self {
        Self { half_width: 3.0, iso: 0.0, limits: Limits::default(), progress: None }
    }
}

/// Computes all distances of a level set anew, from the surface that its values have now: after
/// [`csg`](fn@super::csg), edits and filters, which keep the sign and little else.
///
/// The distances are those to the triangles of [`level_set_to_mesh`], so they differ from those to
/// the curved surface by the height of an arc over a voxel, and edges are cut off within a cell.
/// Signs stay as they are. The result has the name and the metadata of the grid.
///
/// # Errors
/// If the grid is not of floats, or its voxels are no cubes, if an option is out of its range, if
/// nothing is inside, if the result would exceed the limits, or if it was cancelled.
pub fn redistance(grid: &Grid, options: &Redistance) -> Result<Grid, ToolError> {
    let AnyTree::Float(tree) = &grid.tree else { return Err(ToolError::NotFloats) };
    let size = grid.transform.voxel_size();
    let is_cube = (size - size.x).abs().max_element() <= 1e-6 * size.x;
    if !is_cube || !grid.transform.is_linear() {
        return Err(ToolError::NotCubes { size: size.to_array() });
    }
    let surface = LevelSetToMesh {
        iso: options.iso,
        limits: options.limits.clone(),
        ..LevelSetToMesh::default()
    };
    // In index space, where neither rotation nor translation matter.
    let mesh = level_set_to_mesh(tree, &Transform::default(), &surface)?;
    let band = MeshToLevelSet {
        half_width: options.half_width,
        inside: InsideRule::Positive,
        limits: options.limits.clone(),
        progress: options.progress.clone(),
        ..MeshToLevelSet::new(1.0)
    };
    from_mesh::input::any(&mesh.triangles)?;
    let tree = from_mesh::level_set(&mesh.positions, &mesh.triangles, &band, size.x)?;
    Ok(Grid {
        class: GridClass::LevelSet,
        tree: AnyTree::Float(tree.into()),
        file_bytes: 0,
        instance_of: None,
        ..grid.clone()
    })
}
