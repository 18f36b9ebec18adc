//! The frames between which others are made.

use glam::DAffine3;

use crate::tree::Vdb543;
use crate::{AnyTree, Error, Grid, GridClass};

/// The longest displacement by velocities from one frame to the next, in voxels. Faster ones are
/// shortened to it.
pub const MAX_DISPLACEMENT: f64 = 128.0;

/// A frame of a sequence: a grid of floats, and the velocities that move it.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The densities, temperatures or other values to carry; not a level set.
    pub grid: &'a Grid,
    /// Its velocities, `vec3s` or `vec3d` in world axes; the resolution and the transform may differ
    /// from those of `grid`. In a [staggered](GridClass::Staggered) grid, component `i` lies half a
    /// voxel below the voxel's centre along axis `i`. Velocities extend one voxel beyond the active
    /// ones; farther out, those of the other frame apply, or zero if it has none there either.
    pub velocity: Option<&'a Grid>,
}

/// The tree of a grid that can be carried.
pub(super) fn floats(grid: &Grid) -> Result<&Vdb543<f32>, Error> {
    let refuse = |what: String| Err(Error::not_supported(what).in_grid(&grid.unique_name));
    if grid.class == GridClass::LevelSet {
        return refuse(
            "a level set, of which no frames in between are made: its values would no longer be \
             distances; use densities"
                .into(),
        );
    }
    match &grid.tree {
        AnyTree::Float(tree) => Ok(tree),
        tree => refuse(format!(
            "values of type {}, of which no frames in between are made; use a grid of floats",
            tree.value_type()
        )),
    }
}

/// The matrix of a grid's transform.
pub(super) fn matrix(grid: &Grid) -> Result<DAffine3, Error> {
    grid.transform.linear().ok_or_else(|| {
        let what = "a frustum transform, in which no frames in between are made; resample the grid \
                    to cubic voxels";
        Error::not_supported(what).in_grid(&grid.unique_name)
    })
}
