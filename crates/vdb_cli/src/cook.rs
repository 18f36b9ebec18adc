//! `vdb cook`: packs files for the GPU beforehand.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use vdb_core::cooked::{CookOptions, CookedFile, EXTENSION};
use vdb_core::display::quoted;
use vdb_core::pack::ValueFormat;
use vdb_core::{AnyTree, VdbFile};

use crate::files::{make_folder, open, shown};
use crate::limits::LimitArgs;
use crate::pages::{self, Cut};
use crate::progress::Progress;
use crate::terminal::{self, bytes};

/// Pack files for the GPU beforehand: FILE.vdb becomes DIR/FILE.vdbc, which decodes in milliseconds
#[derive(clap::Args)]
pub struct Args {
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// The folder for the cooked files; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// The format of samples; `byte` by default, and `half` for pages
    #[arg(long, value_enum)]
    format: Option<Format>,

    /// Keep all values exactly; the same as `--format exact`
    #[arg(long, conflicts_with = "format")]
    lossless: bool,

    /// Cook level sets as smooth surfaces instead of voxels
    #[arg(long)]
    smooth: bool,

    /// Cut a level set into pages of EDGE³ cells at every level of detail, for surfaces larger than the
    /// memory of a GPU: DIR/FILE.vdbpages lists them. EDGE is a multiple of 128, at most 1024
    #[arg(
        long,
        value_name = "EDGE",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "256"
    )]
    pages: Option<u32>,

    /// The level set to cut into pages; by default the only one
    #[arg(long, value_name = "NAME", requires = "pages")]
    grid: Option<String>,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Format {
    /// 8 bits: steps of at most 2/255 of the range of each leaf of 8³ voxels
    Byte,
    /// 16-bit floats
    Half,
    /// The least that keeps all values exactly: 16 bits or 32
    Exact,
    /// 32-bit floats
    Full,
}

impl From<Format> for ValueFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Byte => Self::Byte,
            Format::Half => Self::Half,
            Format::Exact => Self::Exact,
            Format::Full => Self::Full,
        }
    }
}

/// What has been cooked so far.
#[derive(Default)]
struct Totals {
    files: u64,
    read: u64,
    written: u64,
    /// The grids that have been named as left out: those of a sequence are named once.
    left_out: HashSet<String>,
    /// The same of grids that have become floats.
    converted: HashSet<String>,
}

impl Totals {
    fn name_left_out(&mut self, path: &Path, file: &VdbFile) {
        let others = file.grids.iter().filter(|grid| !matches!(grid.tree, AnyTree::Float(_)));
        let skipped = file.skipped.iter().map(|grid| &grid.unique_name);
        let points = file.points.iter().map(|grid| &grid.unique_name);
        for name in others.map(|grid| &grid.unique_name).chain(points).chain(skipped) {
            if self.left_out.insert(name.clone()) {
                let name = quoted(name);
                terminal::complain(&format!(
                    "{}: grid {name} is left out: not floats",
                    shown(path)
                ));
            }
        }
    }
}

impl Args {
    /// The requested format of samples, or `default` if none is given.
    fn format(&self, default: Format) -> ValueFormat {
        if self.lossless { ValueFormat::Exact } else { self.format.unwrap_or(default).into() }
    }
}

/// Cooks all files that can be cooked. The exit code is a failure if any could not.
pub fn run(args: &Args) -> ExitCode {
    if let Some(edge) = args.pages {
        return terminal::finish(cook_pages(args, edge));
    }
    if let Err(error) = make_folder(&args.out) {
        terminal::complain(&error);
        return ExitCode::FAILURE;
    }
    let mut code = ExitCode::SUCCESS;
    let mut totals = Totals::default();
    let mut targets = HashMap::new();
    for path in &args.files {
        let target = target(path, &args.out);
        let cooked = match targets.insert(target.clone(), path) {
            Some(other) => Err(format!(
                "{}: not cooked, because {} has the same name; give it a folder of its own",
                shown(path),
                shown(other)
            )),
            None => cook(path, &target, args, &mut totals),
        };
        if let Err(error) = cooked {
            terminal::complain(&error);
            code = ExitCode::FAILURE;
        }
    }
    let Totals { files, read, written, .. } = totals;
    let ratio = written as f64 / read.max(1) as f64;
    let summary = format!(
        "{files} of {} files cooked: {} became {} ({ratio:.2})\n",
        args.files.len(),
        bytes(read),
        bytes(written)
    );
    terminal::print(&summary, code).break_value().unwrap_or(code)
}

/// The path of the cooked file.
fn target(path: &Path, out: &Path) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(".");
    name.push(EXTENSION);
    out.join(name)
}

/// Converts grids of other numeric types to floats, and reports it.
fn convert(file: &mut VdbFile, path: &Path, args: &Args, totals: &mut Totals) {
    for converted in file.convert_to_floats(&args.limits.limits()) {
        if totals.converted.insert(converted.grid.clone()) {
            terminal::complain(&format!("{}: {converted}", shown(path)));
        }
    }
}

/// Cuts the level set of the only file into pages.
fn cook_pages(args: &Args, edge: u32) -> Result<String, String> {
    let [path] = &args.files[..] else {
        return Err("pages are cut from one file at a time; EDGE is given as `--pages=EDGE`".into());
    };
    let whole = || {
        let mut file = open(path, &args.limits)?;
        convert(&mut file, path, args, &mut Totals::default());
        Ok(file)
    };
    let cut = Cut {
        edge,
        grid: args.grid.as_deref(),
        smooth: args.smooth,
        format: args.format(Format::Half),
        limits: args.limits.limits(),
    };
    pages::cook(path, whole, &args.out, &cut)
}

fn cook(path: &Path, target: &Path, args: &Args, totals: &mut Totals) -> Result<(), String> {
    let mut file = open(path, &args.limits)?;
    let length = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    convert(&mut file, path, args, totals);
    totals.name_left_out(path, &file);
    let progress = Progress::cooking(path);
    let options = CookOptions {
        format: args.format(Format::Byte),
        smooth: args.smooth,
        limits: args.limits.limits(),
        progress: Some(progress.callback()),
        ..CookOptions::default()
    };
    let cooked =
        CookedFile::cook(&file, &options).map_err(|error| format!("{}: {error}", shown(path)))?;
    drop(file);
    let written = cooked.save(target).map_err(|error| format!("{}: {error}", shown(target)))?;
    totals.files += 1;
    totals.read += length;
    totals.written += written;
    Ok(())
}
