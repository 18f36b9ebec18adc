//! `vdb smooth`: volumes without their details.

use std::process::ExitCode;

use vdb_core::tools::{Filter, Smooth, smooth};

use crate::change::{self, ChangeArgs};

/// Smooth level sets or fog
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    change: ChangeArgs,

    /// How values are smoothed
    #[arg(long, value_enum, default_value_t = Kind::Gaussian)]
    filter: Kind,

    /// For `gaussian` and `mean`: voxels that are mixed on each side, from 1 to 8
    #[arg(long, value_name = "W", default_value = "1")]
    width: u32,

    /// How often
    #[arg(long, value_name = "N", default_value = "1")]
    iterations: u32,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Kind {
    /// Four means in a row, which is nearly a Gaussian
    Gaussian,
    /// The mean of the voxels around each
    Mean,
    /// For level sets: what is most curved moves most
    Curvature,
}

/// Smooths the grids. The exit code is a failure if none could be smoothed.
pub fn run(args: &Args) -> ExitCode {
    let filter = match args.filter {
        Kind::Gaussian => Filter::Gaussian { width: args.width },
        Kind::Mean => Filter::Mean { width: args.width },
        Kind::Curvature => Filter::MeanCurvature,
    };
    change::run(
        &args.change,
        |grid, progress| {
            let limits = args.change.limits.limits();
            let iterations = args.iterations;
            smooth(grid, &Smooth { filter, iterations, limits, progress: Some(progress) })
        },
        None,
    )
}
