//! The command line.

use std::path::PathBuf;

const HELP: &str = "\
vdb_bench [OPTION…] FILE.vdb…
Times rays through the grids of files on the GPU and writes CSV to standard output.

  --sizes WxH,…       pictures; 3840x2160
  --dists D,…         of the camera, in half diagonals of the grid's box; 3.0,1.8,1.1
  --rays KIND,…       primary, shuffled; primary
  --surface KIND,…    voxels, smooth: how level sets are shown; voxels
  --variants DEFS;…   shader defs of each variant, separated by +; one variant without any
  --runs N            counted runs; 40
  --dump DIR          writes t (-1: none) or transmittance of each picture as f32
";

pub struct Args {
    pub files: Vec<PathBuf>,
    pub sizes: Vec<[u32; 2]>,
    pub dists: Vec<f64>,
    pub shuffled: Vec<bool>,
    pub smooth: Vec<bool>,
    pub variants: Vec<Vec<String>>,
    pub runs: u32,
    pub dump: Option<PathBuf>,
}

fn list<T>(text: &str, item: impl Fn(&str) -> Option<T>) -> Result<Vec<T>, String> {
    let items = text.split(',').map(|part| item(part).ok_or(format!("'{part}' is not understood")));
    items.collect()
}

fn size(text: &str) -> Option<[u32; 2]> {
    let (x, y) = text.split_once('x')?;
    let size = [x.parse().ok()?, y.parse().ok()?];
    size.iter().all(|edge| (1..=16_384).contains(edge)).then_some(size)
}

impl Args {
    /// `None` where help was asked for and given.
    pub fn parse() -> Result<Option<Self>, String> {
        let mut args = Self {
            files: Vec::new(),
            sizes: vec![[3840, 2160]],
            dists: vec![3.0, 1.8, 1.1],
            shuffled: vec![false],
            smooth: vec![false],
            variants: vec![Vec::new()],
            runs: 40,
            dump: None,
        };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            if !word.starts_with("--") {
                args.files.push(word.into());
                continue;
            }
            if word == "--help" {
                print!("{HELP}");
                return Ok(None);
            }
            let value = words.next().ok_or(format!("{word} wants a value"))?;
            match word.as_str() {
                "--sizes" => args.sizes = list(&value, size)?,
                "--dists" => args.dists = list(&value, |part| part.parse().ok())?,
                "--rays" => {
                    args.shuffled = list(&value, |part| match part {
                        "primary" => Some(false),
                        "shuffled" => Some(true),
                        _ => None,
                    })?;
                }
                "--surface" => {
                    args.smooth = list(&value, |part| match part {
                        "voxels" => Some(false),
                        "smooth" => Some(true),
                        _ => None,
                    })?;
                }
                "--variants" => {
                    let defs = |part: &str| {
                        part.split('+').filter(|def| !def.is_empty()).map(str::to_owned).collect()
                    };
                    args.variants = value.split(';').map(defs).collect();
                }
                "--runs" => args.runs = value.parse().map_err(|_| "--runs wants a number")?,
                "--dump" => args.dump = Some(value.into()),
                _ => return Err(format!("there is no option {word}; see --help")),
            }
        }
        if args.files.is_empty() {
            return Err("no file; see --help".into());
        }
        Ok(Some(args))
    }
}
