//! The grid that is shown: of a file, or one that is made.

use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::VdbGrid;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::tree::Vdb543;
use bevy_vdb::vdb_core::{AnyTree, VdbFile};

use crate::Args;
use crate::studio::Studio;

/// The first grid of the file, or without one a grid that is made, with its name; its middle is at the
/// origin, and its longest edge has a length of `edge`. Prints a line about it.
pub fn grid(
    studio: &mut Studio,
    args: &Args,
    kind: PackKind,
    edge: f64,
    made: impl FnOnce() -> (String, Vdb543<f32>),
) -> Result<Handle<VdbGrid>, String> {
    let (name, tree) = match &args.model {
        Some(path) => {
            let file = VdbFile::open(path).map_err(|error| error.to_string())?;
            let grid = file.grids.into_iter().next().ok_or("the file has no grid")?;
            let AnyTree::Float(tree) = grid.tree else {
                return Err("the first grid of the file is not a float grid".into());
            };
            (path.display().to_string(), (*tree).clone())
        }
        None => made(),
    };
    let bbox = tree.active_bbox().ok_or("the grid is empty")?;
    let voxels = f64::from((bbox.max - bbox.min).max_element() + 1);
    println!("{name}, {voxels} voxels along its longest edge; medians of {} frames\n", args.frames);
    let middle = (bbox.min + bbox.max).as_dvec3() * 0.5;
    let world_from_index =
        DAffine3::from_scale(DVec3::splat(edge / voxels)) * DAffine3::from_translation(-middle);
    let grid = VdbGrid::new("model", tree, world_from_index, kind);
    let grid = grid.map_err(|error| error.to_string())?;
    Ok(studio.app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid))
}
