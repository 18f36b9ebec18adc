//! The command line.

use std::path::PathBuf;

use glam::DVec3;
use vdb_core::pack::ValueFormat;
use vdb_probe::options::{Options, Stop, number, size};

use crate::camera::Camera;
use crate::model::Source;
use crate::timing::MIN_RUNS;

const HELP: &str = "\
vdb_bench [OPTION…] MODEL…
Times rays through grids on the GPU, and writes CSV to standard output. A model is a FILE.vdb, or
is generated with an edge of 256 to 4096 voxels: gyroid:1024, truss:4096. MODEL@2 is a model at a
quarter of its resolution, from its levels of detail.

  --out DIR           also writes bench.csv, bench.json and bench.svg there
  --dump DIR          writes t (-1 for a miss) or transmittance of each image as f32, row by row
                      from the top
  --report DIR        measures a choice of views of the models, checks rays against the reference
                      tracer, and writes report.md there, to be pasted into an issue, beside the
                      files of --out; the only other option is --runs
  --draw FILE.svg     draws a chart instead of measuring: the models are tables written by this
                      program or by the NanoVDB and Bevy benchmarks, and rows with one of the
                      --sizes are drawn
  --runs N            timed runs, at least 30; default 40. With --dump fewer are allowed, for
                      images only

Measurements for each model; --then begins another set of these options:
  --sizes WxH,…       image sizes; default 3840x2160
  --dists D,…         camera distances, in half diagonals of the grid's box; default 3.0,1.8,1.1
  --camera EYE:AT:FOV instead of --dists, a camera in the file's world: X,Y,Z:X,Y,Z:DEGREES, with
                      the horizontal field of view
  --rays KIND,…       primary, shuffled; default primary
  --surface KIND,…    voxels, smooth: how level sets are rendered; default voxels
  --variants DEFS;…   shader defs of each variant, separated by +; default one variant without
                      any. BEAMS: ray starts shared by 8x8 rays; HDDA, DDA, MARCH: other
                      traversals; STEP=16: fog sampled every 16 quarters of a voxel, instead of
                      cell by cell; SMOOTH_NORMALS: normals interpolated between cells
  --formats FORMAT,…  sample formats: exact, half, byte; default exact
";

/// A set of measurements for every model.
#[derive(Clone)]
pub struct Set {
    pub sizes: Vec<[u32; 2]>,
    pub cameras: Vec<Camera>,
    pub shuffled: Vec<bool>,
    pub smooth: Vec<bool>,
    pub variants: Vec<Vec<String>>,
    pub formats: Vec<ValueFormat>,
}

impl Set {
    /// What a report measures: the plugin's own way to trace primary rays, and the same rays without
    /// neighbours. Images are small on a software adapter, which is a thousand times slower.
    pub fn of_report(is_software: bool) -> Vec<Self> {
        let primary = Self {
            sizes: vec![if is_software { [160, 90] } else { [1920, 1080] }],
            cameras: vec![Camera::Around(1.8)],
            smooth: vec![false, true],
            variants: vec![vec!["BEAMS".into()]],
            ..Self::default()
        };
        let shuffled = Self { shuffled: vec![true], variants: vec![Vec::new()], ..primary.clone() };
        vec![primary, shuffled]
    }
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
    /// The output folder of a report, which is also that of `out`.
    pub report: Option<PathBuf>,
    /// The drawing to write, and the tables to read.
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
    // There is no up direction when looking straight down.
    let sound = (1.0..=170.0).contains(&fov) && (at - eye).cross(DVec3::Y).length() > 0.0;
    sound.then_some(Camera::At { eye, at, fov })
}

fn defs(text: &str) -> Vec<String> {
    text.split('+').filter(|def| !def.is_empty()).map(str::to_owned).collect()
}

impl Set {
    /// Parses the values of an option. Returns `false` if the option is unknown.
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
                "shuffled rays have no neighbours to share ray starts with: measure BEAMS and \
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
            report: None,
            draw: None,
        };
        let mut words = Vec::new();
        let mut set = Set::default();
        // The last option that a report does not have.
        let mut foreign = None;
        let mut options = Options::of_program(HELP);
        let path = |text: &str| Some(PathBuf::from(text));
        while let Some(option) = options.next_word()? {
            if option.starts_with("--") && !["--report", "--runs"].contains(&option.as_str()) {
                foreign = Some(option.clone());
            }
            match option.as_str() {
                "--then" => args.sets.push(std::mem::take(&mut set)),
                "--runs" => args.runs = options.value(number(1..))?,
                "--out" => args.out = Some(options.value(path)?),
                "--dump" => args.dump = Some(options.value(path)?),
                "--report" => args.report = Some(options.value(path)?),
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
        if args.runs < MIN_RUNS && args.dump.is_none() {
            let wants = format!("--runs must be {MIN_RUNS} or more, unless --dump is given");
            return Err(wants.into());
        }
        if args.report.is_some() {
            if let Some(option) = foreign {
                return Err(format!("{option}: --report itself chooses what to measure").into());
            }
            args.out.clone_from(&args.report);
        }
        args.sets.push(set);
        args.sets.iter().try_for_each(Set::check)?;
        Ok(args)
    }
}
