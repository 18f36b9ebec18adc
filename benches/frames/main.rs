//! Frame times of whole apps: the cost of recording and of edits, and how a frame's time is spent.
//! `scripts/bench-frames` builds and runs it; results are in `docs/reference/benchmarks.md`.

#[path = "../../examples/viewer/png_file.rs"]
mod png_file;
#[path = "../common/warm.rs"]
mod warm;

mod detail;
mod edits;
mod fog;
mod grids;
mod model;
mod pages;
mod parts;
mod recording;
mod sequence;
mod studio;
mod surfaces;

use std::path::PathBuf;
use std::process::ExitCode;

use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use studio::Studio;
use vdb_probe::options::{self, Options, Stop, number, size};

const HELP: &str = "\
frames WHAT… [OPTION…]
Times frames of apps without a window. Needs nothing but itself; with the program ffmpeg, videos are
recorded as well.

  recording       a cloud in the sun, with a recorder and without one, in turns
  edits           a ball of 100,000 voxels that runs around in a larger one, or stands still, in turns
  fog             a cloud in the sun all over the picture: still, under a moving sun, under 16 lamps with a still
                  and with a moving camera, under a lamp that moves, four clouds, fire in one; and the ball of edits.
                  The error of a picture, too, where the scene does not change
  grids           a small grid that comes and goes beside ten large ones; a grid that is replaced in each frame
  sequence        the frames in a folder, played in a loop forwards and backwards, and sought at random
  parts           surfaces, fog and fire: each pass, and what VdbMeasureFeatures makes of them
  surfaces        a level set in the sun: smooth normals, and further rays on edges, with the error of each
  detail          surfaces of 256 to 4096 voxels along an edge, from afar and from within, with levels of detail
  pages           a flight over terrains of 170 million and of 1.2·10⁹ voxels in pages, from the horizon to the ground

  --out DIR       where the recordings go, to be deleted at once; a folder for temporary files; also for pages
  --size WxH      of the picture; 1920x1080
  --ms N          of recording: milliseconds that a frame should take by itself, by longer or shorter steps; 7
  --model FILE    of fog and surfaces: a .vdb file whose first grid is shown; of sequence: the folder
  --scene NAME    of fog: only this one; of pages: only terrains of this edge, 3840 or 10240
  --keep          of pages: leaves the pages in --out, and uses those that are there; only then is the memory of the
                  process given, because cooking takes more than displaying
  --pictures      of pages: writes a picture of each stop to --out
  --density N     of fog and sequence: extinction per world unit, with the cloud 4 units across; 4
  --single        of fog: with single scattering
  --frames N      frames a turn, at least 10; 300
  --rounds N      turns of each kind, or loops of the sequence each way, at least 1; 5
  --rate N        frames a second of the recordings, and of the sequence; 60
";

/// What is timed.
type What = fn(&Args) -> Result<(), String>;

struct Args {
    what: Vec<What>,
    out: PathBuf,
    size: UVec2,
    ms: f64,
    frames: usize,
    rounds: usize,
    rate: u32,
    model: Option<PathBuf>,
    scene: Option<String>,
    keeps_pages: bool,
    writes_pictures: bool,
    density: f32,
    single_scattering: bool,
}

impl Args {
    fn parse() -> Result<Self, Stop> {
        let out = std::env::temp_dir().join(format!("bevy_vdb_record_{}", std::process::id()));
        let mut args = Self {
            what: Vec::new(),
            out,
            size: UVec2::new(1920, 1080),
            ms: 7.0,
            frames: 300,
            rounds: 5,
            rate: 60,
            model: None,
            scene: None,
            keeps_pages: false,
            writes_pictures: false,
            density: 4.0,
            single_scattering: false,
        };
        let mut options = Options::of_program(HELP);
        while let Some(option) = options.next_word()? {
            match option.as_str() {
                "recording" => args.what.push(recording::run),
                "edits" => args.what.push(edits::run),
                "fog" => args.what.push(fog::run),
                "grids" => args.what.push(grids::run),
                "sequence" => args.what.push(sequence::run),
                "--model" => args.model = Some(options.value(|path| Some(PathBuf::from(path)))?),
                "--scene" => args.scene = Some(options.value(|name| Some(name.to_owned()))?),
                "--density" => args.density = options.value(number(1e-3..1e6))?,
                "--single" => args.single_scattering = true,
                "--keep" => args.keeps_pages = true,
                "--pictures" => args.writes_pictures = true,
                "surfaces" => args.what.push(surfaces::run),
                "detail" => args.what.push(detail::run),
                "pages" => args.what.push(pages::run),
                "parts" => args.what.push(parts::run),
                "--out" => args.out = options.value(|path| Some(PathBuf::from(path)))?,
                "--size" => args.size = options.value(size(16..=8192))?,
                "--ms" => args.ms = options.value(number(1e-3..1e6))?,
                "--frames" => args.frames = options.value(number(10..))?,
                "--rounds" => args.rounds = options.value(number(1..))?,
                "--rate" => args.rate = options.value(number(1..))?,
                _ => return Err(options.unknown()),
            }
        }
        if args.what.is_empty() {
            // As `cargo bench` calls it.
            let nothing = "nothing measured: start this with scripts/bench-frames, or see --help";
            return Err(Stop::Told(nothing.into()));
        }
        Ok(args)
    }
}

fn main() -> ExitCode {
    options::run("frames", Args::parse(), |args| {
        // Once for all apps.
        App::new().add_plugins(LogPlugin { filter: "error".into(), ..default() });
        args.what.iter().try_for_each(|what| what(args))
    })
}

/// Says what is timed, and on which adapter.
fn print_heading(studio: &Studio, what: &str, size: UVec2) {
    let info = studio.app.world().resource::<RenderAdapterInfo>();
    let adapter = format!("{} ({} {})", info.name, info.driver, info.driver_info);
    println!("\n## {what}\n\n{adapter}, {:?}, {}x{}\n", info.backend, size.x, size.y);
}

/// Median, mean and 99th percentile, ms.
fn summary(times: &mut [f64]) -> [f64; 3] {
    times.sort_by(f64::total_cmp);
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    [times[times.len() / 2], mean, times[times.len() * 99 / 100]]
}

/// Cells of a table: of each of these, with and without, and the ratio of medians and means.
fn cells(with: &mut [f64], without: &mut [f64]) -> String {
    let (own, other) = (summary(with), summary(without));
    let ratio = |i: usize| own[i] / other[i];
    format!(
        " {:.2} | {:.2} | {:.3} | {:.2} | {:.2} | {:.3} | {:.2} | {:.2} |",
        own[0],
        other[0],
        ratio(0),
        own[1],
        other[1],
        ratio(1),
        own[2],
        other[2]
    )
}

/// The head of those cells.
const CELLS: &str =
    " median, ms | without | ratio | mean, ms | without | ratio | 99 %, ms | without |";
