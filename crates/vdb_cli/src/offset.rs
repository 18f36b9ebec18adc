//! `vdb offset`: level sets that grow or shrink.

use std::process::ExitCode;

use vdb_core::tools::{Offset, offset};

use crate::change::{self, ChangeArgs};

/// Move the surfaces of level sets outwards or inwards
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    change: ChangeArgs,

    /// How far outwards, in world units; inwards if it is negative
    #[arg(
        long,
        value_name = "D",
        allow_negative_numbers = true,
        required_unless_present = "voxels"
    )]
    distance: Option<f64>,

    /// The same in voxels of each grid
    #[arg(long, value_name = "N", allow_negative_numbers = true, conflicts_with = "distance")]
    voxels: Option<f64>,
}

/// Moves the surfaces. The exit code is a failure if none could be moved.
pub fn run(args: &Args) -> ExitCode {
    change::run(
        &args.change,
        |grid, progress| {
            let in_voxels = args.voxels.map(|voxels| voxels * grid.transform.voxel_size().x);
            // One of both is there, as clap demands.
            let distance = args.distance.or(in_voxels).unwrap_or(f64::NAN);
            let limits = args.change.limits.limits();
            offset(grid, &Offset { distance, limits, progress: Some(progress) })
        },
        None,
    )
}
