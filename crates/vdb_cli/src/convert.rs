//! `vdb convert`: `.vdb` to `.nvdb` and back, or to other compression.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde::Serialize;
use vdb_core::{AnyTree, Codec, Compression, NanoVdbOptions, NanoVdbValues, VdbFile, WriteOptions};

use crate::files::{HAS_POINTS, open, shown};
use crate::left_out::LeftOut;
use crate::limits::LimitArgs;
use crate::terminal::{self, bytes};

/// Convert a file: the ending of OUT, .vdb or .nvdb, says to what
#[derive(clap::Args)]
pub struct Args {
    /// The file to convert: .vdb or .nvdb, whatever its name
    #[arg(value_name = "IN")]
    from: PathBuf,

    /// The new file; one that is there is replaced once the new one is complete
    #[arg(value_name = "OUT")]
    to: PathBuf,

    /// The codec; by default that of the grids for .vdb, and none for .nvdb
    #[arg(long, value_enum)]
    codec: Option<CodecArg>,

    /// For .vdb: save floats with 16 bits
    #[arg(long)]
    half: bool,

    /// For .nvdb: how values are stored
    #[arg(long = "type", value_enum, value_name = "TYPE")]
    values: Option<Values>,

    /// Print JSON: what was written and what was left out
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum CodecArg {
    None,
    Zip,
    Blosc,
}

impl From<CodecArg> for Codec {
    fn from(codec: CodecArg) -> Self {
        match codec {
            CodecArg::None => Self::None,
            CodecArg::Zip => Self::Zip,
            CodecArg::Blosc => Self::Blosc,
        }
    }
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Values {
    /// 32-bit floats
    Float,
    /// 8 bits: 255 steps over the range of each leaf of 8³ voxels
    Fp8,
    /// 16 bits: 65,535 steps over the range of each leaf
    Fp16,
}

impl From<Values> for NanoVdbValues {
    fn from(values: Values) -> Self {
        match values {
            Values::Float => Self::Float,
            Values::Fp8 => Self::Fp8,
            Values::Fp16 => Self::Fp16,
        }
    }
}

/// The format of a new file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Vdb,
    NanoVdb,
}

/// What has been converted, as `--json` prints it.
#[derive(Serialize)]
struct Report {
    from: String,
    to: String,
    grids: Vec<String>,
    left_out: Vec<LeftOut>,
    bytes_read: u64,
    bytes_written: u64,
}

/// Converts the file. The exit code is a failure if it could not, and 2 if the options do not fit.
pub fn run(args: &Args) -> ExitCode {
    let format = match format(args) {
        Ok(format) => format,
        Err(error) => {
            terminal::complain(&error);
            return ExitCode::from(2);
        }
    };
    match convert(args, format) {
        Ok(report) => {
            report.left_out.iter().for_each(|left_out| left_out.complain(&args.from));
            let said = said(&report, args.json);
            terminal::print(&said, ExitCode::SUCCESS).break_value().unwrap_or(ExitCode::SUCCESS)
        }
        Err(error) => {
            terminal::complain(&error);
            ExitCode::FAILURE
        }
    }
}

/// The format that the options ask for.
fn format(args: &Args) -> Result<Format, String> {
    let to = shown(&args.to);
    let extension = args.to.extension().map(|extension| extension.to_ascii_lowercase());
    match extension.as_deref().and_then(|extension| extension.to_str()) {
        Some("vdb") if args.values.is_some() => {
            Err(format!("{to}: `--type` is for .nvdb files; use `--half` to save 16-bit floats"))
        }
        Some("vdb") => Ok(Format::Vdb),
        Some("nvdb") if args.half => {
            Err(format!("{to}: `--half` is for .vdb files; use `--type fp16`"))
        }
        Some("nvdb") => Ok(Format::NanoVdb),
        _ => Err(format!("{to}: the name of the new file must end in .vdb or .nvdb")),
    }
}

fn convert(args: &Args, format: Format) -> Result<Report, String> {
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let mut file = open(&args.from, &args.limits)?;
    let bytes_read = length(&args.from);
    let mut left_out: Vec<LeftOut> = file.skipped.iter().map(LeftOut::skipped).collect();
    match format {
        Format::Vdb => {
            if args.half {
                file.grids.iter_mut().for_each(|grid| grid.saved_as_half = has_floats(&grid.tree));
            }
            let codec =
                args.codec.map(|codec| Compression { codec: codec.into(), active_mask: true });
            left_out.extend(file.points.iter().flat_map(LeftOut::attributes));
            let options = WriteOptions { compression: codec, stream: false };
            file.save(&args.to, &options)
        }
        Format::NanoVdb => {
            left_out.extend(leave_out(&mut file));
            if file.grids.is_empty() && !left_out.is_empty() {
                let from = shown(&args.from);
                return Err(format!("{from}: no grid that a .nvdb file is written of: floats"));
            }
            let codec = args.codec.map_or(Codec::None, Codec::from);
            let values = args.values.map(NanoVdbValues::from).unwrap_or_default();
            file.save_nanovdb(&args.to, &NanoVdbOptions { values, codec })
        }
    }
    .map_err(|error| error.to_string())?;
    let points = file.points.into_iter().map(|grid| grid.unique_name);
    Ok(Report {
        from: args.from.to_string_lossy().into_owned(),
        to: args.to.to_string_lossy().into_owned(),
        grids: file.grids.into_iter().map(|grid| grid.unique_name).chain(points).collect(),
        left_out,
        bytes_read,
        bytes_written: length(&args.to),
    })
}

/// Whether a tree can be saved with 16-bit floats.
fn has_floats(tree: &AnyTree) -> bool {
    use AnyTree::{Double, Float, Vec3d, Vec3s};
    matches!(tree, Float(_) | Double(_) | Vec3s(_) | Vec3d(_))
}

/// Takes the grids out of which no `.nvdb` file is written.
fn leave_out(file: &mut VdbFile) -> Vec<LeftOut> {
    let (kept, others): (Vec<_>, Vec<_>) = std::mem::take(&mut file.grids)
        .into_iter()
        .partition(|grid| matches!(grid.tree, AnyTree::Float(_)) && grid.transform.is_linear());
    file.grids = kept;
    let reason = |grid: &vdb_core::Grid| match &grid.tree {
        AnyTree::Float(_) => "its transform is a frustum".to_owned(),
        tree => format!("{}, not floats", tree.value_type()),
    };
    let left = others.iter().map(|grid| LeftOut::grid(&grid.unique_name, reason(grid)));
    let points = file.points.drain(..).map(|grid| {
        let reason = format!("it has points, not floats; {HAS_POINTS}");
        LeftOut::grid(&grid.unique_name, reason)
    });
    left.chain(points).collect()
}

fn said(report: &Report, json: bool) -> String {
    if json {
        let text = serde_json::to_string_pretty(report);
        return text.map_or_else(|error| error.to_string(), |text| text + "\n");
    }
    format!(
        "{} grids written: {} became {}\n",
        report.grids.len(),
        bytes(report.bytes_read),
        bytes(report.bytes_written)
    )
}
