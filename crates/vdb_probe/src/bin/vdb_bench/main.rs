//! Times the shaders; used by `scripts/bench`. See `vdb_bench --help`.

mod args;
mod camera;
mod chart;
mod measure;
mod model;
mod report;
mod timing;

use std::process::ExitCode;

fn main() -> ExitCode {
    vdb_probe::options::run("vdb_bench", args::Args::parse(), measure::run)
}
