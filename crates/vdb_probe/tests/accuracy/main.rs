//! The accuracy suite: the shaders against the f64 reference tracer, over a matrix of extremes. It
//! prints one table and fails when a bound is broken; `docs/reference/accuracy.md` lists the bounds.
//!
//! | variable | |
//! |---|---|
//! | `BEVY_VDB_RAYS` | factor on the numbers of rays, 1 by default |
//! | `BEVY_VDB_SEED` | where the random numbers begin |
//! | `BEVY_VDB_ACCURACY_OUT` | a folder for `accuracy.txt`, `accuracy.csv` and `accuracy.svg` |
//! | `BEVY_VDB_BROWSER_OUT` | a folder for rays and the right answers, for `scripts/browser`; no bound is checked then |
//!
//! It is a slow test, which runs if it is asked for: with `--include-ignored` all of it, and with parts of names
//! of cases those that have one of them.

mod altered;
mod browser;
mod cameras;
mod case;
mod chart;
mod corpus;
#[path = "../../../vdb_core/tests/corpus_files/mod.rs"]
mod corpus_files;
mod fog;
mod grids;
mod nudged;
mod report;
mod shift;
mod smooth;
mod views;
mod voxels;

use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use vdb_probe::{Gpu, Probe, ProbeKind};

use case::Suite;
use report::Report;

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name)
        .map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // What cargo and editors ask of every test program.
    if arguments.iter().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    let (options, filters): (Vec<String>, Vec<String>) =
        arguments.into_iter().partition(|argument| argument.starts_with('-'));
    // As Rust's own test harness does it, whose other options mean nothing here.
    let is_asked_for = |option: &String| option == "--include-ignored" || option == "--ignored";
    if filters.is_empty() && !options.iter().any(is_asked_for) {
        println!("test accuracy ... ignored, slow: a million rays beside the reference tracer");
        return ExitCode::SUCCESS;
    }
    let Some(gpu) = Gpu::find() else { return ExitCode::SUCCESS };
    let start = Instant::now();
    let (times, seed) = (number("BEVY_VDB_RAYS", 1) as usize, number("BEVY_VDB_SEED", 1));
    let mut suite = Suite {
        gpu: &gpu,
        times,
        seed,
        filters,
        report: Report::new(gpu.name(), seed, times),
        voxels: Probe::new(&gpu, ProbeKind::Voxels),
        smooth: Probe::new(&gpu, ProbeKind::Smooth),
        fog: Probe::new(&gpu, ProbeKind::Fog),
    };
    if let Some(folder) = std::env::var_os("BEVY_VDB_BROWSER_OUT") {
        return match browser::write(&suite, Path::new(&folder)) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{}: {error}", Path::new(&folder).display());
                ExitCode::FAILURE
            }
        };
    }
    println!("{}", suite.report.heading());
    voxels::run(&mut suite);
    altered::run(&mut suite);
    smooth::run(&mut suite);
    fog::run(&mut suite);
    cameras::run(&mut suite);
    shift::run(&mut suite);
    corpus::run(&mut suite);
    nudged::run(&mut suite);
    let report = &suite.report;
    println!("\n{} {:.1} s", report.sum(), start.elapsed().as_secs_f64());
    if let Some(folder) = std::env::var_os("BEVY_VDB_ACCURACY_OUT")
        && let Err(error) = write(report, Path::new(&folder))
    {
        eprintln!("{}: {error}", Path::new(&folder).display());
        return ExitCode::FAILURE;
    }
    match report.broken() {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}

fn write(report: &Report, folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("accuracy.txt"), report.table())?;
    std::fs::write(folder.join("accuracy.csv"), report.csv())?;
    std::fs::write(folder.join("accuracy.svg"), chart::svg(report))
}
