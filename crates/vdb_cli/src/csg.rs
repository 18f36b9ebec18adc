//! `vdb csg`: solids combined.

use std::path::PathBuf;
use std::process::ExitCode;

use vdb_core::tools::{CsgOperation, Redistance, csg, redistance};
use vdb_core::{Grid, VdbFile, WriteOptions};

use crate::files::{grid_of, open, shown};
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::terminal;

/// Combine level sets with the same voxels
#[derive(clap::Args)]
pub struct Args {
    #[arg(value_enum)]
    operation: Operation,

    /// The solids, in order. Of each, the first level set is taken
    #[arg(required = true, num_args = 2.., value_name = "FILE")]
    files: Vec<PathBuf>,

    /// The file for the result
    #[arg(long, value_name = "FILE")]
    out: PathBuf,

    /// Compute all distances anew. Otherwise those near new edges are too short
    #[arg(long)]
    redistance: bool,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Operation {
    /// What is in any of them
    Union,
    /// What is in all of them
    Intersection,
    /// What is in the first one alone
    Difference,
}

impl From<Operation> for CsgOperation {
    fn from(operation: Operation) -> Self {
        match operation {
            Operation::Union => Self::Union,
            Operation::Intersection => Self::Intersection,
            Operation::Difference => Self::Difference,
        }
    }
}

/// Combines the solids. The exit code is a failure if they could not be combined.
pub fn run(args: &Args) -> ExitCode {
    terminal::finish(make(args))
}

fn make(args: &Args) -> Result<String, String> {
    let mut combined: Option<Grid> = None;
    for path in &args.files {
        let file = open(path, &args.limits)?;
        let grid = grid_of(&file, path, None)?;
        combined = Some(match combined {
            None => grid.clone(),
            Some(before) => csg(&before, grid, args.operation.into())
                .map_err(|error| format!("{}: {error}", shown(path)))?,
        });
    }
    let mut grid = combined.ok_or("name two files or more")?;
    if args.redistance {
        let progress = Progress::making(&args.out);
        // The width of the band stays, if it is a possible one.
        let half_width = half_width(&grid).clamp(1.0, 100.0);
        let options = Redistance {
            half_width,
            limits: args.limits.limits(),
            progress: Some(progress.callback()),
            ..Redistance::default()
        };
        grid = redistance(&grid, &options)
            .map_err(|error| format!("{}: {error}", shown(&args.out)))?;
    }
    let voxels = grid.tree.active_voxel_count();
    VdbFile::new(vec![grid])
        .save(&args.out, &WriteOptions::default())
        .map_err(|error| error.to_string())?;
    Ok(format!("{} solids became {voxels} voxels\n", args.files.len()))
}

/// The half width of the band of a level set, in voxels.
fn half_width(grid: &Grid) -> f32 {
    match &grid.tree {
        vdb_core::AnyTree::Float(tree) => {
            (f64::from(tree.background()) / grid.transform.voxel_size().x) as f32
        }
        _ => Redistance::default().half_width,
    }
}
