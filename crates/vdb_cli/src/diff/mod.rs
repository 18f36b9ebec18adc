//! `vdb diff`: compares two files, number by number.

mod trees;

use std::path::PathBuf;
use std::process::ExitCode;

use glam::DVec3;
use serde::Serialize;
use vdb_core::display::quoted;
use vdb_core::{Grid, Transform, VdbFile};

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
    let find =
        |file: &VdbFile, name: &str| file.grids.iter().position(|grid| grid.unique_name == name);
    all.into_iter()
        .map(|name| match (find(a, &name), find(b, &name)) {
            (Some(first), Some(second)) => {
                grids(name, &a.grids[first], &b.grids[second], args.tolerance)
            }
            (first, _) => {
                let (path, other) = if first.is_none() { (&args.a, b) } else { (&args.b, a) };
                let skipped = [a, b]
                    .iter()
                    .any(|file| file.skipped.iter().any(|grid| grid.unique_name == name));
                let points = [a, b]
                    .iter()
                    .any(|file| file.points.iter().any(|grid| grid.unique_name == name));
                let what = match (skipped, find(other, &name)) {
                    _ if points => "cannot be compared, as it has points".to_owned(),
                    (true, _) => "cannot be compared, as it is not read".to_owned(),
                    _ => format!("missing in {}", shown(path)),
                };
                Compared { grid: name, equal: false, different: vec![what], values: None }
            }
        })
        .collect()
}

fn grids(name: String, a: &Grid, b: &Grid, tolerance: f64) -> Compared {
    let mut different = Vec::new();
    if a.class != b.class {
        different.push(format!("class: {} and {}", a.class.name(), b.class.name()));
    }
    let far = distance(&a.transform, &b.transform);
    if far > ROUNDING {
        different.push(format!("transform: up to {far} voxels apart"));
    }
    let values = trees::compare(&a.tree, &b.tree, tolerance);
    if values.is_none() {
        let (a, b) = (a.tree.value_type(), b.tree.value_type());
        different.push(format!("type: {a} and {b}"));
    }
    let equal = different.is_empty() && values.as_ref().is_some_and(Differences::none);
    Compared { grid: name, equal, different, values }
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
