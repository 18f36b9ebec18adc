//! `vdb`, a command-line tool for OpenVDB files. Each subcommand is a module.

mod between;
mod change;
mod completions;
mod convert;
mod cook;
mod crop;
mod csg;
mod diff;
mod files;
mod from_mesh;
mod from_points;
mod info;
mod left_out;
mod limits;
mod mesh;
mod offset;
mod pages;
mod progress;
mod render;
mod resample;
mod smooth;
mod terminal;
mod to_mesh;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};

/// Works with OpenVDB files
#[derive(Parser)]
#[command(name = "vdb", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Between(between::Args),
    Completions(completions::Args),
    Convert(convert::Args),
    Cook(cook::Args),
    Crop(crop::Args),
    Csg(csg::Args),
    Diff(diff::Args),
    FromMesh(from_mesh::Args),
    FromPoints(from_points::Args),
    Info(info::Args),
    Offset(offset::Args),
    Render(Box<render::Args>),
    Resample(resample::Args),
    Smooth(smooth::Args),
    ToMesh(to_mesh::Args),
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(message) => return usage(&message),
    };
    match cli.command {
        Command::Between(args) => between::run(&args),
        Command::Completions(args) => completions::run(&args, Cli::command()),
        Command::Convert(args) => convert::run(&args),
        Command::Cook(args) => cook::run(&args),
        Command::Crop(args) => crop::run(&args),
        Command::Csg(args) => csg::run(&args),
        Command::Diff(args) => diff::run(&args),
        Command::FromMesh(args) => from_mesh::run(&args),
        Command::FromPoints(args) => from_points::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Offset(args) => offset::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Resample(args) => resample::run(&args),
        Command::Smooth(args) => smooth::run(&args),
        Command::ToMesh(args) => to_mesh::run(&args),
    }
}

/// Prints help, or what is wrong with the command line. The latter quotes file names, so it is
/// escaped.
fn usage(message: &clap::Error) -> ExitCode {
    let text = message.render().to_string();
    match message.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            terminal::print(&text, ExitCode::SUCCESS).break_value().unwrap_or(ExitCode::SUCCESS)
        }
        _ => {
            text.lines().for_each(terminal::complain);
            ExitCode::from(2)
        }
    }
}
