//! The command line.

use std::path::PathBuf;

use bevy::math::UVec2;
use vdb_probe::options::{Options, Stop, number, size};

use crate::texture::Format;

const HELP: &str = "\
bevy_fog [OPTION…] FILE.vdb…
Times Bevy's FogVolume on the GPU and writes CSV to standard output.

  --sizes WxH,…       pictures; 3840x2160
  --dists D,…         of the camera, in half diagonals of the grid's box; 3.0,1.8,1.1
  --formats NAME,…    of the texture: r8, r16; r8
  --steps N,…         of Bevy's march; 64, which is Bevy's default
  --runs N            counted runs, at least 30; 40
  --dump DIR          writes the transmittance of each picture as f32, row by row from the top
  --beside DIR        what vdb_bench --dump wrote there, to tell the errors
";

pub struct Args {
    pub files: Vec<PathBuf>,
    pub sizes: Vec<UVec2>,
    pub dists: Vec<f64>,
    pub formats: Vec<Format>,
    pub steps: Vec<u32>,
    pub runs: u32,
    pub dump: Option<PathBuf>,
    pub beside: Option<PathBuf>,
}

impl Args {
    pub fn parse() -> Result<Self, Stop> {
        let mut args = Self {
            files: Vec::new(),
            sizes: vec![UVec2::new(3840, 2160)],
            dists: vec![3.0, 1.8, 1.1],
            formats: vec![Format::R8],
            steps: vec![64],
            runs: 40,
            dump: None,
            beside: None,
        };
        let mut options = Options::of_program(HELP);
        let path = |text: &str| Some(PathBuf::from(text));
        while let Some(option) = options.next_word()? {
            match option.as_str() {
                "--sizes" => args.sizes = options.list(size(1..=8192))?,
                "--dists" => args.dists = options.list(number(0.01..1e4))?,
                "--formats" => args.formats = options.list(Format::named)?,
                "--steps" => args.steps = options.list(number(1..=65_536))?,
                "--runs" => args.runs = options.value(number(30..10_000))?,
                "--dump" => args.dump = Some(options.value(path)?),
                "--beside" => args.beside = Some(options.value(path)?),
                file if !file.starts_with("--") => args.files.push(file.into()),
                _ => return Err(options.unknown()),
            }
        }
        if args.files.is_empty() {
            // As `cargo bench` calls it.
            let nothing =
                "nothing measured: no file; start this with scripts/bench-fog, or see --help";
            return Err(Stop::Told(nothing.into()));
        }
        Ok(args)
    }
}
