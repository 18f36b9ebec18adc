//! The command line.

use std::path::PathBuf;

use glam::DVec3;
use vdb_core::pack::ValueFormat;
use vdb_probe::options::{Options, Stop, number, size};

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
  --draw FILE.svg     measures nothing: the models are tables that this program, NanoVDB's or Bevy's wrote,
                      and what they have of these --sizes is drawn
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
    /// What is to be drawn, and of which tables.
    pub draw: Option<(PathBuf, Vec<PathBuf>)>,
}

fn finite(text: &str) -> Option<f64> {
    number(f64::MIN..=f64::MAX)(text)
}

fn point(text: &str) -> Option<DVec3> {
    let numbers: Vec<f64> = text.split(',').map(finite).collect::<Option<_>>()?;
    <[f64; 3]>::try_from(numbers).ok().map(DVec3::from)
}

fn camera(text: &str) -> Option<Camera> {
    let [eye, at, fov] = text.split(':').collect::<Vec<_>>().try_into().ok()?;
    let (eye, at, fov) = (point(eye)?, point(at)?, finite(fov)?);
    // From straight above, up is nowhere.
    let sound = (1.0..=170.0).contains(&fov) && (at - eye).cross(DVec3::Y).length() > 0.0;
    sound.then_some(Camera::At { eye, at, fov })
}

fn defs(text: &str) -> Vec<String> {
    text.split('+').filter(|def| !def.is_empty()).map(str::to_owned).collect()
}

impl Set {
    /// Takes the values of an option; `false` where there is none of this name.
    fn take(&mut self, option: &str, options: &mut Options) -> Result<bool, Stop> {
        match option {
            "--sizes" => {
                let size = size(1..=16_384);
                self.sizes = options.list(|part| size(part).map(|size| size.to_array()))?;
            }
            "--dists" => {
                let around = |part: &str| finite(part).filter(|dist| *dist > 0.0);
                self.cameras = options.list(|part| around(part).map(Camera::Around))?;
            }
            "--camera" => self.cameras = vec![options.value(camera)?],
            "--rays" => {
                self.shuffled = options.list(|part| match part {
                    "primary" => Some(false),
                    "shuffled" => Some(true),
                    _ => None,
                })?;
            }
            "--surface" => {
                self.smooth = options.list(|part| match part {
                    "voxels" => Some(false),
                    "smooth" => Some(true),
                    _ => None,
                })?;
            }
            "--formats" => {
                self.formats = options.list(|part| match part {
                    "exact" => Some(ValueFormat::Exact),
                    "half" => Some(ValueFormat::Half),
                    "byte" => Some(ValueFormat::Byte),
                    _ => None,
                })?;
            }
            "--variants" => {
                self.variants = options.value(|all| Some(all.split(';').map(defs).collect()))?;
            }
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
    pub fn parse() -> Result<Self, Stop> {
        let mut args = Self {
            models: Vec::new(),
            sets: Vec::new(),
            runs: 40,
            out: None,
            dump: None,
            draw: None,
        };
        let mut words = Vec::new();
        let mut set = Set::default();
        let mut options = Options::of_program(HELP);
        let path = |text: &str| Some(PathBuf::from(text));
        while let Some(option) = options.next_word()? {
            match option.as_str() {
                "--then" => args.sets.push(std::mem::take(&mut set)),
                "--runs" => args.runs = options.value(number(1..))?,
                "--out" => args.out = Some(options.value(path)?),
                "--dump" => args.dump = Some(options.value(path)?),
                "--draw" => args.draw = Some((options.value(path)?, Vec::new())),
                word if !word.starts_with("--") => words.push(option),
                option if set.take(option, &mut options)? => {}
                _ => return Err(options.unknown()),
            }
        }
        if words.is_empty() {
            return Err("no model; see --help".to_owned().into());
        }
        match &mut args.draw {
            Some((_, tables)) => tables.extend(words.into_iter().map(PathBuf::from)),
            None => {
                let models: Result<_, String> = words.iter().map(|word| word.parse()).collect();
                args.models = models?;
            }
        }
        if args.runs < LEAST_RUNS && args.dump.is_none() {
            let wants = format!("--runs wants a number from {LEAST_RUNS} on, or --dump beside it");
            return Err(wants.into());
        }
        args.sets.push(set);
        args.sets.iter().try_for_each(Set::check)?;
        Ok(args)
    }
}
