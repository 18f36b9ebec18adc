//! `vdb to-mesh`: the surface of a grid as triangles.

use std::path::PathBuf;
use std::process::ExitCode;

use vdb_core::tools::{LevelSetToMesh, level_set_to_mesh};
use vdb_core::{AnyTree, GridClass};

use crate::files::{grid_of, open, shown};
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::{mesh, terminal};

/// Make triangles of the surface of a grid: a .glb, .obj, .ply or .stl file without holes
#[derive(clap::Args)]
pub struct Args {
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// The file for the triangles
    #[arg(long, value_name = "MESH")]
    out: PathBuf,

    /// The grid; by default the first level set, or else the first grid of floats
    #[arg(long, value_name = "NAME")]
    grid: Option<String>,

    /// The value at the surface: 0 by default for level sets. Fog is inside where it is denser
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    iso: Option<f32>,

    #[command(flatten)]
    limits: LimitArgs,
}

/// Makes the mesh. The exit code is a failure if it could not be made.
pub fn run(args: &Args) -> ExitCode {
    terminal::finish(make(args))
}

fn make(args: &Args) -> Result<String, String> {
    mesh::check_name(&args.out)?;
    let file = open(&args.file, &args.limits)?;
    let grid = grid_of(&file, &args.file, args.grid.as_deref())?;
    let AnyTree::Float(tree) = &grid.tree else {
        return Err(format!("{}: the grid is not one of floats", shown(&args.file)));
    };
    let is_level_set = grid.class == GridClass::LevelSet;
    let iso = match args.iso {
        Some(iso) => iso,
        None if is_level_set => 0.0,
        None => {
            let path = shown(&args.file);
            return Err(format!("{path}: the grid is no level set; give the value with --iso"));
        }
    };
    let progress = Progress::making(&args.file);
    let options = LevelSetToMesh {
        iso,
        inside_is_above: !is_level_set,
        limits: args.limits.limits(),
        progress: Some(progress.callback()),
    };
    let made = level_set_to_mesh(tree, &grid.transform, &options)
        .map_err(|error| format!("{}: {error}", shown(&args.file)))?;
    drop(progress);
    mesh::write(&args.out, &made)?;
    Ok(format!("{} vertices, {} triangles\n", made.positions.len(), made.triangles.len()))
}
