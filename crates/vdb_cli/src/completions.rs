//! `vdb completions`: what shells need to complete command lines.

use std::process::ExitCode;

use clap::Command;
use clap_complete::{Shell, generate};

use crate::terminal;

/// Print the completions of a shell: see your shell's manual for the place to save them
#[derive(clap::Args)]
pub struct Args {
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the script for a command.
pub fn run(args: &Args, mut command: Command) -> ExitCode {
    let mut script = Vec::new();
    generate(args.shell, &mut command, "vdb", &mut script);
    let code = ExitCode::SUCCESS;
    let text = String::from_utf8_lossy(&script);
    terminal::print(&text, code).break_value().unwrap_or(code)
}
