//! `vdb crop`: what is inside a box.

use std::process::ExitCode;
use std::str::FromStr;

use glam::DVec3;
use vdb_core::tools::{Crop, crop, crop_points};
use vdb_core::{Grid, PointGrid};

use crate::change::{self, ChangeArgs};

/// Keep what is inside a box in world space. Level sets are cut as solids are
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    change: ChangeArgs,

    /// The lower corner in world units; without it, or where it is -inf, there is no bound
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, required_unless_present = "max")]
    min: Option<Corner>,

    /// The upper corner
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    max: Option<Corner>,
}

#[derive(Clone, Copy)]
struct Corner(DVec3);

impl FromStr for Corner {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> =
            text.split(',').map(|number| number.trim().parse()).collect::<Result<_, _>>().map_err(
                |_| "a corner is three numbers with commas, such as 1,-2.5,3".to_owned(),
            )?;
        match numbers[..] {
            [x, y, z] => Ok(Self(DVec3::new(x, y, z))),
            _ => Err(format!("a corner is three numbers, and these are {}", numbers.len())),
        }
    }
}

/// Crops the grids, and the points. The exit code is a failure if none could be cropped.
pub fn run(args: &Args) -> ExitCode {
    let low = args.min.map_or(DVec3::NEG_INFINITY, |corner| corner.0);
    let high = args.max.map_or(DVec3::INFINITY, |corner| corner.0);
    let limits = args.change.limits.limits();
    let points = |grid: &PointGrid| crop_points(grid, &Crop::new(low, high));
    let tool = |grid: &Grid, progress| {
        crop(grid, &Crop { low, high, limits: limits.clone(), progress: Some(progress) })
    };
    change::run(&args.change, tool, Some(&points))
}
