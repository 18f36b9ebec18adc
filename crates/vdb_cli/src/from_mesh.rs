//! `vdb from-mesh`: triangles to a level set.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;

use vdb_core::tools::{InsideRule, MeshToLevelSet, mesh_to_level_set};
use vdb_core::{VdbFile, WriteOptions};

use crate::files::shown;
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::{mesh, terminal};

/// Make a level set of a mesh: of a .glb, .obj, .ply or .stl file. Holes are closed
#[derive(clap::Args)]
pub struct Args {
    #[arg(value_name = "MESH")]
    mesh: PathBuf,

    /// The file for the level set
    #[arg(long, value_name = "FILE")]
    out: PathBuf,

    /// Voxels along the longest edge of the mesh's box
    #[arg(long, value_name = "N", required_unless_present = "voxel_size")]
    voxels: Option<NonZeroU32>,

    /// The size of a voxel, in units of the mesh
    #[arg(long, value_name = "S", conflicts_with = "voxels")]
    voxel_size: Option<f64>,

    /// Voxels with a distance on each side of the surface
    #[arg(long, value_name = "W", default_value = "3")]
    half_width: f32,

    /// What counts as inside
    #[arg(long, value_enum, default_value_t = Inside::Around)]
    inside: Inside,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Inside {
    /// What the surface goes around, also where it is inside out
    Around,
    /// Only where the surface is counter-clockwise seen from outside
    Positive,
    /// Where it goes around an odd number of times: a shell in a shell is hollow
    Odd,
}

/// Makes the level set. The exit code is a failure if it could not be made.
pub fn run(args: &Args) -> ExitCode {
    terminal::finish(make(args))
}

fn make(args: &Args) -> Result<String, String> {
    let (positions, triangles) = mesh::read(&args.mesh, &args.limits)?;
    let sized = match (args.voxel_size, args.voxels) {
        (Some(size), _) => MeshToLevelSet::new(size),
        (None, voxels) => {
            MeshToLevelSet::with_voxels(&positions, voxels.map_or(1, NonZeroU32::get))
        }
    };
    let progress = Progress::making(&args.mesh);
    let options = MeshToLevelSet {
        half_width: args.half_width,
        inside: match args.inside {
            Inside::Around => InsideRule::NonZero,
            Inside::Positive => InsideRule::Positive,
            Inside::Odd => InsideRule::Odd,
        },
        limits: args.limits.limits(),
        progress: Some(progress.callback()),
        ..sized
    };
    let grid = mesh_to_level_set(&positions, &triangles, &options)
        .map_err(|error| format!("{}: {error}", shown(&args.mesh)))?;
    drop(progress);
    let voxels = grid.tree.active_voxel_count();
    VdbFile::new(vec![grid])
        .save(&args.out, &WriteOptions::default())
        .map_err(|error| error.to_string())?;
    Ok(format!("{} triangles became {voxels} voxels of {}\n", triangles.len(), options.voxel_size))
}
