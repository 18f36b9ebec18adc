//! Distances again, after a level set was changed.

use std::sync::Arc;

use rayon::prelude::*;

use super::from_mesh::{self, InsideRule};
use super::grid::{cube_edge, floats, replaced};
use super::nodes::{Leaf, Upper};
use super::{LevelSetToMesh, MeshToLevelSet, ToolError, level_set_to_mesh};
use crate::tree::{Found, Node, Vdb543};
use crate::work::debug_options;
use crate::{Grid, GridClass, Limits, ProgressFn, Transform};

/// Options of [`redistance`].
#[derive(Clone)]
pub struct Redistance {
    /// Voxels from the surface to either end of the band: 1 to 100. 3 by default.
    pub half_width: f32,
    /// The value of the surface, which becomes 0. Within the band, a level set grows by that distance
    /// or shrinks; [`offset`](fn@super::offset) goes farther.
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

debug_options!(Redistance { half_width, iso, limits });

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
    let tree = redistanced(floats(grid)?, cube_edge(&grid.transform)?, options)?;
    Ok(Grid { class: GridClass::LevelSet, ..replaced(grid, tree) })
}

/// The same for a tree whose voxels are cubes with this edge.
pub(super) fn redistanced(
    tree: &Vdb543<f32>,
    edge: f64,
    options: &Redistance,
) -> Result<Vdb543<f32>, ToolError> {
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
    let mut made = from_mesh::level_set_of_closed(mesh, &band, edge)?;
    keep_signs(&mut made, tree, options.iso);
    Ok(made)
}

/// Gives values the sides of the surface that the samples are on. The triangles separate these, but
/// the corners of triangles are rounded to f32, and beyond samples that are nearer than that.
fn keep_signs(made: &mut Vdb543<f32>, tree: &Vdb543<f32>, iso: f32) {
    let side = |value: &mut f32, sample: f32| {
        if sample < iso {
            *value = -value.abs().max(f32::MIN_POSITIVE);
        } else {
            *value = value.abs();
        }
    };
    let leaf = |leaf: &mut Leaf| match tree.find(leaf.origin()) {
        Found::Tile(tile) => {
            leaf.values_slice_mut().iter_mut().for_each(|value| side(value, tile.value));
        }
        Found::Leaf(own) => {
            let values = leaf.values_slice_mut().iter_mut();
            values.zip(own.values_slice()).for_each(|(value, sample)| side(value, *sample));
        }
    };
    made.children_mut().flat_map(|upper: &mut Upper| upper.children_mut()).for_each(|lower| {
        lower.children_mut().par_iter_mut().with_min_len(64).for_each(|own| leaf(own));
    });
}
