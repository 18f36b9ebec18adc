//! Shows `.vdb` files and sequences of them in a window or renders them to PNG; `viewer --help` lists the options.

mod adapter;
mod app;
mod args;
mod cpu;
mod fly;
mod framing;
mod keys;
mod offscreen;
mod overlay;
mod paged;
mod png_file;
mod select;
mod sequences;
mod state;
mod volumes;
mod window;

use std::path::Path;
use std::process::ExitCode;

use args::Args;

/// The path of the image if none is given and there is no window.
const DEFAULT_PICTURE: &str = "viewer.png";

fn main() -> ExitCode {
    let done = match Args::from_command_line() {
        Ok(Some(args)) => show(args),
        Ok(None) => {
            print!("{}", args::HELP);
            Ok(())
        }
        Err(error) => Err(format!("{error}\nTry: viewer --help")),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("viewer: {error}");
            ExitCode::FAILURE
        }
    }
}

fn show(args: Args) -> Result<(), String> {
    if args.out.is_none() && !args.cpu && window::display() {
        // Bevy panics without a GPU, so check first.
        adapter::find(None).map_err(|error| format!("{error}.\n{}", adapter::ADVICE))?;
        match window::build(&args) {
            Ok(app) => return window::run(app),
            Err(error) => eprintln!("viewer: no window: {error}; writing an image instead"),
        }
    }
    let path = args.out.clone().unwrap_or_else(|| DEFAULT_PICTURE.into());
    let tracer = if args.cpu {
        offscreen::Tracer::Cpu
    } else {
        match adapter::find(Some(args.size)) {
            Ok(()) => offscreen::Tracer::Gpu,
            Err(error @ adapter::Error::TooLarge { .. }) => return Err(error.to_string()),
            Err(error) => {
                eprintln!("viewer: {error}: tracing on the CPU instead. {}", adapter::ADVICE);
                offscreen::Tracer::Cpu
            }
        }
    };
    let size = args.size;
    let pixels = offscreen::picture(args, tracer)?;
    png_file::write(&path, size, &pixels)?;
    println!("{}", std::path::absolute(&path).as_deref().unwrap_or(Path::new(&path)).display());
    Ok(())
}
