//! The command line.

use std::path::PathBuf;
use std::str::FromStr;

use bevy::math::UVec2;
use lexopt::{Arg, Parser, ValueExt};

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

fn list<T>(parser: &mut Parser, item: impl Fn(&str) -> Option<T>) -> Result<Vec<T>, String> {
    let text = parser.value().and_then(|value| value.string()).map_err(|e| e.to_string())?;
    let items = text.split(',').map(|part| item(part).ok_or(format!("'{part}' is not understood")));
    items.collect()
}

fn size(text: &str) -> Option<UVec2> {
    let (x, y) = text.split_once('x')?;
    let size = UVec2::new(x.parse().ok()?, y.parse().ok()?);
    (size.min_element() > 0 && size.max_element() <= 8192).then_some(size)
}

fn from<T: FromStr>(text: &str, is_sound: impl Fn(&T) -> bool) -> Option<T> {
    text.parse().ok().filter(is_sound)
}

impl Args {
    /// `None` where help was asked for and given.
    pub fn parse() -> Result<Option<Self>, String> {
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
        let mut parser = Parser::from_env();
        while let Some(arg) = parser.next().map_err(|error| error.to_string())? {
            match arg {
                Arg::Value(file) => args.files.push(file.into()),
                Arg::Long("sizes") => args.sizes = list(&mut parser, size)?,
                Arg::Long("dists") => {
                    args.dists = list(&mut parser, |part| from(part, |d| (0.01..1e4).contains(d)))?;
                }
                Arg::Long("formats") => args.formats = list(&mut parser, Format::named)?,
                Arg::Long("steps") => {
                    args.steps =
                        list(&mut parser, |part| from(part, |n| (1..=65_536).contains(n)))?;
                }
                Arg::Long("runs") => {
                    let runs = list(&mut parser, |part| from(part, |n| (30..10_000).contains(n)))?;
                    args.runs = runs[0];
                }
                Arg::Long("dump") => args.dump = Some(path(&mut parser)?),
                Arg::Long("beside") => args.beside = Some(path(&mut parser)?),
                Arg::Long("help") => {
                    print!("{HELP}");
                    return Ok(None);
                }
                // `cargo bench` adds an option of its own.
                Arg::Long("bench") => {}
                other => return Err(other.unexpected().to_string()),
            }
        }
        if args.files.is_empty() {
            // As `cargo bench` calls it.
            println!("nothing measured: no file; start this with scripts/bench-fog, or see --help");
            return Ok(None);
        }
        Ok(Some(args))
    }
}

fn path(parser: &mut Parser) -> Result<PathBuf, String> {
    parser.value().map(PathBuf::from).map_err(|error| error.to_string())
}
