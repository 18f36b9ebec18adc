//! Times the shaders, as `scripts/bench` calls it: `vdb_bench --help`.

mod args;
mod camera;
mod chart;
mod measure;
mod model;
mod report;
mod timing;

use std::process::ExitCode;

fn main() -> ExitCode {
    let args = match args::Args::parse() {
        Ok(Some(args)) => args,
        Ok(None) => return ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("vdb_bench: {message}");
            return ExitCode::from(2);
        }
    };
    match measure::run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("vdb_bench: {message}");
            ExitCode::FAILURE
        }
    }
}
