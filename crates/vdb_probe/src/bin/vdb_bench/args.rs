//! The command line.

use std::path::PathBuf;

use glam::DVec3;
use vdb_core::pack::ValueFormat;

use crate::camera::Camera;
use crate::model::Source;
use crate::timing::LEAST_RUNS;

const HELP: &str = "\
vdb_bench [OPTION…] MODEL…
Times rays through grids on the GPU and writes CSV to standard output. A model is a FILE.vdb, or made on
the spot at a size from 256 to 4096 voxels: gyroid:1024, truss:4096. MODEL@2 is a model at a quarter of its
resolution, by its levels of detail.

  --out DIR           writes bench.csv, bench.json and bench.svg there as well
  --dump DIR          writes t (-1: none) or transmittance of each picture as f32, row by row from the top
  --runs N            counted runs, at least 30; 40. With --dump fewer will do, for pictures, not figures

What is measured, for each model; --then begins another set of these:
  --sizes WxH,…       pictures; 3840x2160
  --dists D,…         of the camera, in half diagonals of the grid's box; 3.0,1.8,1.1
  --camera EYE:AT:FOV in place of --dists a camera in the file's world: X,Y,Z:X,Y,Z:DEGREES, from left
                      to right
  --rays KIND,…       primary, shuffled; primary
  --surface KIND,…    voxels, smooth: how level sets are shown; voxels
  --variants DEFS;…   shader defs of each variant, separated by +; one variant without any. BEAMS:
                      starts shared by 8x8 rays; HDDA, DDA, MARCH: other walks; STEP=16: fog by
                      samples every so many quarters of a voxel, in place of cell by cell
  --formats FORMAT,…  of samples: exact, half, byte; exact
";

/// What is measured of every model.
#[derive(Clone)]
pub struct Set {
    pub sizes: Vec<[u32; 2]>,
    pub cameras: Vec<Camera>,
    pub shuffled: Vec<bool>,
    pub smooth: Vec<bool>,
    pub variants: Vec<Vec<String>>,
    pub formats: Vec<ValueFormat>,
}

impl Default for Set {
    fn default() -> Self {
        Self {
            sizes: vec![[3840, 2160]],
            cameras: [3.0, 1.8, 1.1].map(Camera::Around).to_vec(),
            shuffled: vec![false],
            smooth: vec![false],
            variants: vec![Vec::new()],
            formats: vec![ValueFormat::Exact],
        }
    }
}

pub struct Args {
    pub models: Vec<Source>,
    pub sets: Vec<Set>,
    pub runs: u32,
    pub out: Option<PathBuf>,
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

fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

fn point(text: &str) -> Option<DVec3> {
    let numbers: Vec<f64> = text.split(',').map(number).collect::<Option<_>>()?;
    <[f64; 3]>::try_from(numbers).ok().map(DVec3::from)
}

fn camera(text: &str) -> Option<Camera> {
    let [eye, at, fov] = text.split(':').collect::<Vec<_>>().try_into().ok()?;
    let (eye, at, fov) = (point(eye)?, point(at)?, number(fov)?);
    // From straight above, up is nowhere.
    let sound = (1.0..=170.0).contains(&fov) && (at - eye).cross(DVec3::Y).length() > 0.0;
    sound.then_some(Camera::At { eye, at, fov })
}

fn defs(text: &str) -> Vec<String> {
    text.split('+').filter(|def| !def.is_empty()).map(str::to_owned).collect()
}

impl Set {
    /// Takes an option; `false` where there is none of this name.
    fn take(&mut self, option: &str, value: &str) -> Result<bool, String> {
        match option {
            "--sizes" => self.sizes = list(value, size)?,
            "--dists" => {
                let around = |part: &str| number(part).filter(|dist| *dist > 0.0);
                self.cameras = list(value, |part| around(part).map(Camera::Around))?;
            }
            "--camera" => {
                let camera = camera(value).ok_or(format!("--camera {value} is no EYE:AT:FOV"))?;
                self.cameras = vec![camera];
            }
            "--rays" => {
                self.shuffled = list(value, |part| match part {
                    "primary" => Some(false),
                    "shuffled" => Some(true),
                    _ => None,
                })?;
            }
            "--surface" => {
                self.smooth = list(value, |part| match part {
                    "voxels" => Some(false),
                    "smooth" => Some(true),
                    _ => None,
                })?;
            }
            "--formats" => {
                self.formats = list(value, |part| match part {
                    "exact" => Some(ValueFormat::Exact),
                    "half" => Some(ValueFormat::Half),
                    "byte" => Some(ValueFormat::Byte),
                    _ => None,
                })?;
            }
            "--variants" => self.variants = value.split(';').map(defs).collect(),
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn check(&self) -> Result<(), String> {
        let beams = self.variants.iter().flatten().any(|def| def == "BEAMS");
        if beams && self.shuffled.contains(&true) {
            return Err(
                "shuffled rays have no neighbours to share a start with: measure BEAMS and \
                 --rays shuffled in two sets, with --then between them"
                    .into(),
            );
        }
        Ok(())
    }
}

impl Args {
    /// `None` where help was asked for and given.
    pub fn parse() -> Result<Option<Self>, String> {
        let mut args =
            Self { models: Vec::new(), sets: Vec::new(), runs: 40, out: None, dump: None };
        let mut set = Set::default();
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            match word.as_str() {
                "--help" => {
                    print!("{HELP}");
                    return Ok(None);
                }
                "--then" => args.sets.push(std::mem::take(&mut set)),
                option if option.starts_with("--") => {
                    let value = words.next().ok_or(format!("{option} wants a value"))?;
                    args.take(&mut set, option, &value)?;
                }
                model => args.models.push(model.parse()?),
            }
        }
        if args.models.is_empty() {
            return Err("no model; see --help".into());
        }
        if args.runs < LEAST_RUNS && args.dump.is_none() {
            return Err(format!("--runs wants a number from {LEAST_RUNS} on, or --dump beside it"));
        }
        args.sets.push(set);
        args.sets.iter().try_for_each(Set::check)?;
        Ok(Some(args))
    }

    fn take(&mut self, set: &mut Set, option: &str, value: &str) -> Result<(), String> {
        match option {
            "--runs" => {
                let runs = value.parse().ok().filter(|runs| *runs > 0);
                self.runs = runs.ok_or("--runs wants a number")?;
            }
            "--out" => self.out = Some(value.into()),
            "--dump" => self.dump = Some(value.into()),
            _ if set.take(option, value)? => {}
            _ => return Err(format!("there is no option {option}; see --help")),
        }
        Ok(())
    }
}
