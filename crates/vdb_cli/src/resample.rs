//! `vdb resample`: the same volumes with other voxels.

use std::path::PathBuf;
use std::process::ExitCode;

use vdb_core::tools::{Interpolation, Resample, resample};

use crate::change::{self, ChangeArgs};
use crate::files::{grid_of, open};
use crate::terminal;

/// Make grids with other voxels, at the same place in the world
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    change: ChangeArgs,

    /// The size of a voxel in world units. Origin and axes stay
    #[arg(long, value_name = "S", allow_negative_numbers = true, required_unless_present = "like")]
    voxel_size: Option<f64>,

    /// A file whose voxels to take: those of its first level set, or else of its first grid of floats
    #[arg(long, value_name = "FILE", conflicts_with = "voxel_size")]
    like: Option<PathBuf>,

    /// Take the value of the nearest voxel, instead of mixing eight. Level sets are not affected
    #[arg(long)]
    nearest: bool,
}

/// Resamples the grids. The exit code is a failure if none could be resampled.
pub fn run(args: &Args) -> ExitCode {
    let like = match &args.like {
        None => None,
        Some(path) => {
            let transform = open(path, &args.change.limits)
                .and_then(|file| Ok(grid_of(&file, path, None)?.transform.clone()));
            match transform {
                Ok(transform) => Some(transform),
                Err(error) => return terminal::finish(Err(error)),
            }
        }
    };
    change::run(
        &args.change,
        |grid, progress| {
            let options = match (&like, args.voxel_size) {
                (Some(transform), _) => Resample::new(transform.clone()),
                // Without a file, clap demands a size.
                (None, size) => Resample::with_voxel_size(grid, size.unwrap_or(f64::NAN))?,
            };
            let interpolation =
                if args.nearest { Interpolation::Nearest } else { Interpolation::Trilinear };
            let limits = args.change.limits.limits();
            resample(grid, &Resample { interpolation, limits, progress: Some(progress), ..options })
        },
        None,
    )
}
