//! Times the shaders; used by `scripts/bench` and `scripts/bench-report`. See `vdb_bench --help`.

mod args;
mod camera;
mod chart;
mod check;
mod measure;
mod model;
mod report;
mod submission;
mod system;
mod timing;

use std::process::ExitCode;

fn main() -> ExitCode {
    vdb_probe::options::run("vdb_bench", args::Args::parse(), measure::run)
}
