//! `vdb diff`: compares two files, number by number.

mod points;
mod trees;

use std::path::PathBuf;
use std::process::ExitCode;

use glam::DVec3;
use serde::Serialize;
use vdb_core::display::quoted;
use vdb_core::{Grid, PointGrid, Transform, VdbFile};

use crate::files::{open, shown};
use crate::limits::LimitArgs;
use crate::terminal;
use trees::Differences;

/// Compare two files grid by grid and value by value: exit code 0 if they are equal within the
/// tolerance, 1 if not, 2 if one cannot be read
#[derive(clap::Args)]
pub struct Args {
    #[arg(value_name = "A")]
    a: PathBuf,

    #[arg(value_name = "B")]
    b: PathBuf,

    /// The greatest difference of two values that counts as none
    #[arg(long, value_name = "T", default_value_t = 0.0, value_parser = tolerance)]
    tolerance: f64,

    /// Print JSON
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    limits: LimitArgs,
}

fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number >= 0.0 => Ok(number),
        _ => Err("it must be a number, 0 or more".into()),
    }
}

/// The exit code of files that differ.
const DIFFERENT: u8 = 1;
/// The exit code of files that cannot be compared.
const FAILED: u8 = 2;

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    a: String,
    b: String,
    tolerance: f64,
    equal: bool,
    grids: Vec<Compared>,
}

/// Two grids of one name.
#[derive(Serialize)]
struct Compared {
    grid: String,
    equal: bool,
    /// What differs apart from values; empty if nothing does.
    different: Vec<String>,
    #[serde(flatten)]
    values: Option<Differences>,
    /// The number of points, if both grids have points.
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<usize>,
}

/// Compares the files.
pub fn run(args: &Args) -> ExitCode {
    let files = open(&args.a, &args.limits).and_then(|a| Ok((a, open(&args.b, &args.limits)?)));
    let (a, b) = match files {
        Ok(files) => files,
        Err(error) => {
            terminal::complain(&error);
            return ExitCode::from(FAILED);
        }
    };
    let grids = compare(&a, &b, args);
    let report = Report {
        a: args.a.to_string_lossy().into_owned(),
        b: args.b.to_string_lossy().into_owned(),
        tolerance: args.tolerance,
        equal: grids.iter().all(|grid| grid.equal),
        grids,
    };
    let code = ExitCode::from(if report.equal { 0 } else { DIFFERENT });
    let said = if args.json {
        serde_json::to_string_pretty(&report)
            .map_or_else(|error| error.to_string(), |text| text + "\n")
    } else {
        text(&report)
    };
    terminal::print(&said, code).break_value().unwrap_or(code)
}

/// Compares grids of the same unique name; one that only one file has, or can read, is a
/// difference.
fn compare(a: &VdbFile, b: &VdbFile, args: &Args) -> Vec<Compared> {
    let names = |file: &VdbFile| {
        let read = file.grids.iter().map(|grid| grid.unique_name.clone());
        let points = file.points.iter().map(|grid| grid.unique_name.clone());
        let skipped = file.skipped.iter().map(|grid| grid.unique_name.clone());
        read.chain(points).chain(skipped).collect::<Vec<_>>()
    };
    let mut all = names(a);
    all.extend(names(b));
    all.sort();
    all.dedup();
    all.into_iter().map(|name| compared(name, [a, b], args)).collect()
}

/// Compares what two files have under a name.
fn compared(name: String, files: [&VdbFile; 2], args: &Args) -> Compared {
    let voxels = files.map(|file| file.grids.iter().find(|grid| grid.unique_name == name));
    let of_points = files.map(|file| file.points.iter().find(|grid| grid.unique_name == name));
    let is_skipped = |file: &&VdbFile| file.skipped.iter().any(|grid| grid.unique_name == name);
    let what = match (voxels, of_points) {
        ([Some(a), Some(b)], _) => return grids(name, a, b, args.tolerance),
        (_, [Some(a), Some(b)]) => return points(name, a, b, args.tolerance),
        _ if files.iter().any(is_skipped) => "cannot be compared, as it is not read".to_owned(),
        ([None, _], [None, _]) => format!("missing in {}", shown(&args.a)),
        ([_, None], [_, None]) => format!("missing in {}", shown(&args.b)),
        _ => "has voxels in one file and points in the other".to_owned(),
    };
    Compared { grid: name, equal: false, different: vec![what], values: None, points: None }
}

/// What differs between the transforms of two grids.
fn transforms(a: &Transform, b: &Transform) -> Option<String> {
    let far = distance(a, b);
    (far > ROUNDING).then(|| format!("transform: up to {far} voxels apart"))
}

fn points(name: String, a: &PointGrid, b: &PointGrid, tolerance: f64) -> Compared {
    let mut different: Vec<_> = transforms(&a.transform, &b.transform).into_iter().collect();
    different.extend(points::compare(&a.points, &b.points, tolerance));
    let equal = different.is_empty();
    Compared { grid: name, equal, different, values: None, points: Some(a.points.len()) }
}

fn grids(name: String, a: &Grid, b: &Grid, tolerance: f64) -> Compared {
    let mut different = Vec::new();
    if a.class != b.class {
        different.push(format!("class: {} and {}", a.class.name(), b.class.name()));
    }
    different.extend(transforms(&a.transform, &b.transform));
    let values = trees::compare(&a.tree, &b.tree, tolerance);
    if values.is_none() {
        let (a, b) = (a.tree.value_type(), b.tree.value_type());
        different.push(format!("type: {a} and {b}"));
    }
    let equal = different.is_empty() && values.as_ref().is_some_and(Differences::none);
    Compared { grid: name, equal, different, values, points: None }
}

/// How far apart positions may be in voxels, for the order of operations in f64 differs between
/// maps: 1,000 voxels from the origin they are known to 1e-13 voxels.
const ROUNDING: f64 = 1e-9;

/// The greatest distance between the positions of some voxels, in voxels of the first transform.
fn distance(a: &Transform, b: &Transform) -> f64 {
    const FAR: f64 = 1000.0;
    let size = a.voxel_size().min_element();
    let points = [DVec3::ZERO, DVec3::X * FAR, DVec3::Y * FAR, DVec3::Z * FAR, DVec3::splat(FAR)];
    let apart = |p: &DVec3| (a.world_from_index(*p) - b.world_from_index(*p)).length() / size;
    points.iter().map(apart).fold(0.0, f64::max)
}

fn text(report: &Report) -> String {
    let mut out = String::new();
    for compared in &report.grids {
        let mut parts = compared.different.clone();
        if let Some(values) = &compared.values {
            parts.push(values.to_string());
        }
        if let (true, Some(points)) = (compared.equal, compared.points) {
            parts.push(format!("{points} points"));
        }
        let verdict = if compared.equal { "equal" } else { "different" };
        out += &format!("{}: {verdict}: {}\n", quoted(&compared.grid), parts.join("; "));
    }
    out += match (report.equal, report.grids.is_empty()) {
        (true, true) => "equal: neither file has grids\n",
        (true, false) => "equal\n",
        (false, _) => "different\n",
    };
    out
}
