//! What commands share that make a file of one with other grids.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use serde::Serialize;
use vdb_core::display::quoted;
use vdb_core::tools::ToolError;
use vdb_core::{Grid, PointGrid, ProgressFn, VdbFile, WriteOptions};

use crate::files::{HAS_POINTS, grid_of, open, shown};
use crate::left_out::LeftOut;
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::terminal;

#[derive(clap::Args)]
pub struct ChangeArgs {
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// The file for the result: a .vdb, which may be FILE itself
    #[arg(long, value_name = "FILE")]
    out: PathBuf,

    /// The only grid to keep; by default all that this can be done with
    #[arg(long, value_name = "NAME")]
    grid: Option<String>,

    /// Print JSON: the grids that were made, and those that were left out
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    pub limits: LimitArgs,
}

/// What was made, as `--json` prints it.
#[derive(Serialize)]
struct Report {
    from: String,
    to: String,
    grids: Vec<Made>,
    left_out: Vec<LeftOut>,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Made {
    /// With the numbers of active voxels.
    Grid {
        grid: String,
        voxels_before: u64,
        voxels: u64,
    },
    Points {
        grid: String,
        points_before: usize,
        points: usize,
    },
}

/// How grids of points are changed, if they are.
pub type PointTool<'a> = &'a dyn Fn(&PointGrid) -> Result<PointGrid, ToolError>;

/// Changes the grids of a file with a tool, and those of points with another. The exit code is a
/// failure if none could be changed, and 2 if the options do not fit.
pub fn run(
    args: &ChangeArgs,
    tool: impl Fn(&Grid, Arc<ProgressFn>) -> Result<Grid, ToolError>,
    point_tool: Option<PointTool>,
) -> ExitCode {
    if !args.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("vdb")) {
        let out = shown(&args.out);
        terminal::complain(&format!("{out}: the name of the new file must end in .vdb"));
        return ExitCode::from(2);
    }
    let made = change(args, tool, point_tool).map(|report| {
        report.left_out.iter().for_each(|left_out| left_out.complain(&args.file));
        said(&report, args.json)
    });
    terminal::finish(made)
}

fn change(
    args: &ChangeArgs,
    tool: impl Fn(&Grid, Arc<ProgressFn>) -> Result<Grid, ToolError>,
    point_tool: Option<PointTool>,
) -> Result<Report, String> {
    let file = open(&args.file, &args.limits)?;
    let named = args.grid.as_deref();
    let points = named.and_then(|name| file.point_grid(name)).filter(|_| point_tool.is_some());
    let (chosen, points): (Vec<&Grid>, Vec<&PointGrid>) = match (named, points) {
        (None, _) => (file.grids.iter().collect(), file.points.iter().collect()),
        (Some(_), Some(points)) => (Vec::new(), vec![points]),
        (Some(name), None) => (vec![grid_of(&file, &args.file, Some(name))?], Vec::new()),
    };
    let (mut made, mut new, mut left_out) = (Vec::new(), VdbFile::new(Vec::new()), Vec::new());
    if named.is_none() {
        left_out.extend(file.skipped.iter().map(LeftOut::skipped));
    }
    let failed = |grid: &str, error: ToolError| {
        format!("{}: grid {}: {error}", shown(&args.file), quoted(grid))
    };
    for grid in chosen {
        let progress = Progress::making(&args.file);
        match tool(grid, progress.callback()) {
            Ok(changed) => {
                made.push(Made::Grid {
                    grid: grid.unique_name.clone(),
                    voxels_before: grid.tree.active_voxel_count(),
                    voxels: changed.tree.active_voxel_count(),
                });
                new.grids.push(changed);
            }
            Err(error) if does_not_fit(&error) => {
                left_out.push(LeftOut::grid(&grid.unique_name, error.to_string()));
            }
            Err(error) => return Err(failed(&grid.unique_name, error)),
        }
    }
    for grid in points {
        let Some(tool) = point_tool else {
            let reason = format!("it has points; {HAS_POINTS}");
            left_out.push(LeftOut::grid(&grid.unique_name, reason));
            continue;
        };
        let changed = tool(grid).map_err(|error| failed(&grid.unique_name, error))?;
        made.push(Made::Points {
            grid: grid.unique_name.clone(),
            points_before: grid.points.len(),
            points: changed.points.len(),
        });
        left_out.extend(LeftOut::attributes(grid));
        new.points.push(changed);
    }
    if made.is_empty() {
        let path = shown(&args.file);
        return Err(match left_out.first() {
            Some(LeftOut { grid, reason, .. }) => {
                format!("{path}: grid {}: {reason}", quoted(grid))
            }
            None => format!("{path}: no grids"),
        });
    }
    new.save(&args.out, &WriteOptions::default()).map_err(|error| error.to_string())?;
    let text = |path: &Path| path.to_string_lossy().into_owned();
    Ok(Report { from: text(&args.file), to: text(&args.out), grids: made, left_out })
}

/// Whether a tool is not made for a grid, as opposed to having failed.
fn does_not_fit(error: &ToolError) -> bool {
    use ToolError::{NotCubes, NotFloats, NotLevelSet, NotLinear};
    matches!(error, NotFloats | NotLevelSet { .. } | NotLinear | NotCubes { .. })
}

fn said(report: &Report, json: bool) -> String {
    if json {
        let text = serde_json::to_string_pretty(report);
        return text.map_or_else(|error| error.to_string(), |text| text + "\n");
    }
    let line = |made: &Made| match made {
        Made::Grid { grid, voxels_before, voxels } => {
            format!("{}: {voxels_before} voxels became {voxels}\n", quoted(grid))
        }
        Made::Points { grid, points_before, points } => {
            format!("{}: {points_before} points became {points}\n", quoted(grid))
        }
    };
    report.grids.iter().map(line).collect()
}
