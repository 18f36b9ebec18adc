//! `vdb from-points`: points to fog or to a level set.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use vdb_core::display::quoted;
use vdb_core::tools::{
    PointNumber, PointsToFog, PointsToLevelSet, ToolError, points_to_fog, points_to_level_set,
};
use vdb_core::{Grid, PointGrid, Points, ProgressFn, VdbFile, WriteOptions};

use crate::files::{open, shown};
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::terminal;

/// Make fog or a level set of the points in a file
#[derive(clap::Args)]
pub struct Args {
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// The file for the volume
    #[arg(long, value_name = "FILE")]
    out: PathBuf,

    /// The grid of points; by default the first one
    #[arg(long, value_name = "NAME")]
    grid: Option<String>,

    /// What to make
    #[arg(long = "as", value_enum)]
    kind: Kind,

    /// The size of a voxel in world units
    #[arg(long, value_name = "S")]
    voxel_size: f64,

    /// The radius of all points in world units; by default the attribute `pscale`, or 0 for fog of
    /// points without it
    #[arg(long, value_name = "R", conflicts_with = "radius_attribute")]
    radius: Option<f64>,

    /// The attribute with the radius of each point
    #[arg(long, value_name = "NAME")]
    radius_attribute: Option<String>,

    /// A factor for the radius of each point
    #[arg(long, value_name = "F", default_value = "1")]
    radius_scale: f64,

    /// For fog: the mean density within the radius of each point; 1 by default
    #[arg(long, value_name = "D", conflicts_with = "density_attribute")]
    density: Option<f64>,

    /// For fog: the attribute with the density of each point
    #[arg(long, value_name = "NAME")]
    density_attribute: Option<String>,

    /// For level sets: voxels with a distance on each side of the surface; 3 by default
    #[arg(long, value_name = "W")]
    half_width: Option<f32>,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Kind {
    /// Density, which adds up where points are close to each other
    Fog,
    /// The surface of the union of balls around the points
    LevelSet,
}

/// Makes the volume. The exit code is a failure if it could not be made, and 2 if the options do not
/// fit.
pub fn run(args: &Args) -> ExitCode {
    let of_fog = args.density.is_some() || args.density_attribute.is_some();
    let wrong = match args.kind {
        Kind::Fog if args.half_width.is_some() => Some("`--half-width` is for level sets"),
        Kind::LevelSet if of_fog => Some("a level set has no density"),
        _ => None,
    };
    if let Some(wrong) = wrong {
        terminal::complain(wrong);
        return ExitCode::from(2);
    }
    terminal::finish(make(args))
}

fn make(args: &Args) -> Result<String, String> {
    let file = open(&args.file, &args.limits)?;
    let points = points_of(&file, args)?;
    let progress = Progress::making(&args.file);
    let grid = volume(points, args, progress.callback())
        .map_err(|error| format!("{}: {error}", shown(&args.file)))?;
    drop(progress);
    let voxels = grid.tree.active_voxel_count();
    VdbFile::new(vec![grid])
        .save(&args.out, &WriteOptions::default())
        .map_err(|error| error.to_string())?;
    let count = points.points.len();
    Ok(format!("{count} points became {voxels} voxels of {}\n", args.voxel_size))
}

/// The grid with the points.
fn points_of<'a>(file: &'a VdbFile, args: &Args) -> Result<&'a PointGrid, String> {
    let path = shown(&args.file);
    match &args.grid {
        None => file.points.first().ok_or_else(|| format!("{path}: no grid of points")),
        Some(name) => file.point_grid(name).ok_or_else(|| {
            let skipped =
                file.skipped.iter().find(|grid| grid.name == *name || grid.unique_name == *name);
            match skipped {
                Some(grid) => format!("{path}: {}", grid.reason),
                None if file.grid(name).is_some() => {
                    format!("{path}: {} is no grid of points", quoted(name))
                }
                None => format!("{path}: no grid is called {}", quoted(name)),
            }
        }),
    }
}

fn volume(points: &PointGrid, args: &Args, progress: Arc<ProgressFn>) -> Result<Grid, ToolError> {
    let attribute = |name: &str, scale| PointNumber::Attribute { name: name.to_owned(), scale };
    let (limits, progress) = (args.limits.limits(), Some(progress));
    let radius = match (args.radius, &args.radius_attribute) {
        (Some(radius), _) => PointNumber::Constant(radius * args.radius_scale),
        (None, Some(name)) => attribute(name, args.radius_scale),
        (None, None)
            if args.kind == Kind::Fog && points.points.floats(Points::RADIUS).is_none() =>
        {
            PointNumber::Constant(0.0)
        }
        (None, None) => attribute(Points::RADIUS, args.radius_scale),
    };
    match args.kind {
        Kind::Fog => {
            let density = match &args.density_attribute {
                Some(name) => attribute(name, 1.0),
                None => PointNumber::Constant(args.density.unwrap_or(1.0)),
            };
            let sized = PointsToFog::new(args.voxel_size);
            points_to_fog(points, &PointsToFog { radius, density, limits, progress, ..sized })
        }
        Kind::LevelSet => {
            let sized = PointsToLevelSet::new(args.voxel_size, radius);
            let half_width = args.half_width.unwrap_or(sized.half_width);
            let options = PointsToLevelSet { half_width, limits, progress, ..sized };
            points_to_level_set(points, &options)
        }
    }
}
