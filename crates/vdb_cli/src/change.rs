//! What commands share that make a file of one with other grids.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use serde::Serialize;
use vdb_core::display::quoted;
use vdb_core::tools::ToolError;
use vdb_core::{Grid, ProgressFn, VdbFile, WriteOptions};

use crate::files::{HAS_POINTS, grid_of, open, shown};
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
struct Made {
    grid: String,
    /// Active voxels.
    voxels_before: u64,
    voxels: u64,
}

#[derive(Serialize)]
struct LeftOut {
    grid: String,
    reason: String,
}

/// Changes the grids of a file with a tool. The exit code is a failure if none could be changed, and 2
/// if the options do not fit.
pub fn run(
    args: &ChangeArgs,
    tool: impl Fn(&Grid, Arc<ProgressFn>) -> Result<Grid, ToolError>,
) -> ExitCode {
    if !args.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("vdb")) {
        let out = shown(&args.out);
        terminal::complain(&format!("{out}: the name of the new file must end in .vdb"));
        return ExitCode::from(2);
    }
    let made = change(args, tool).map(|report| {
        for LeftOut { grid, reason } in &report.left_out {
            let (path, name) = (shown(&args.file), quoted(grid));
            terminal::complain(&format!("{path}: grid {name} is left out: {reason}"));
        }
        said(&report, args.json)
    });
    terminal::finish(made)
}

fn change(
    args: &ChangeArgs,
    tool: impl Fn(&Grid, Arc<ProgressFn>) -> Result<Grid, ToolError>,
) -> Result<Report, String> {
    let file = open(&args.file, &args.limits)?;
    let chosen = match &args.grid {
        Some(name) => vec![grid_of(&file, &args.file, Some(name))?],
        None => file.grids.iter().collect(),
    };
    let (mut made, mut grids, mut left_out) = (Vec::new(), Vec::new(), Vec::new());
    if args.grid.is_none() {
        left_out.extend(file.skipped.iter().map(|skipped| LeftOut {
            grid: skipped.unique_name.clone(),
            reason: skipped.reason.to_string(),
        }));
        left_out.extend(file.points.iter().map(|points| LeftOut {
            grid: points.unique_name.clone(),
            reason: format!("it has points; {HAS_POINTS}"),
        }));
    }
    for grid in chosen {
        let progress = Progress::making(&args.file);
        match tool(grid, progress.callback()) {
            Ok(changed) => {
                grids.push(Made {
                    grid: grid.unique_name.clone(),
                    voxels_before: grid.tree.active_voxel_count(),
                    voxels: changed.tree.active_voxel_count(),
                });
                made.push(changed);
            }
            Err(error) if does_not_fit(&error) => {
                left_out.push(LeftOut { grid: grid.unique_name.clone(), reason: error.to_string() })
            }
            Err(error) => {
                let (path, name) = (shown(&args.file), quoted(&grid.unique_name));
                return Err(format!("{path}: grid {name}: {error}"));
            }
        }
    }
    if made.is_empty() {
        let path = shown(&args.file);
        return Err(match left_out.first() {
            Some(LeftOut { grid, reason }) => format!("{path}: grid {}: {reason}", quoted(grid)),
            None => format!("{path}: no grids"),
        });
    }
    let save = |path: &Path| VdbFile::new(made).save(path, &WriteOptions::default());
    save(&args.out).map_err(|error| error.to_string())?;
    let text = |path: &Path| path.to_string_lossy().into_owned();
    Ok(Report { from: text(&args.file), to: text(&args.out), grids, left_out })
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
    let line = |made: &Made| {
        let Made { grid, voxels_before, voxels } = made;
        format!("{}: {voxels_before} voxels became {voxels}\n", quoted(grid))
    };
    report.grids.iter().map(line).collect()
}
