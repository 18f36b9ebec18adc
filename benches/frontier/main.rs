//! What speed costs: pictures of a set of scenes over the knobs of `VdbQuality`, each with its time on
//! the GPU and what it gets wrong beside the one of `VdbQuality::EXACT`, which is held against the
//! reference tracer itself. `scripts/frontier` builds and runs it; results are in `docs/reference/quality.md`.

#[path = "../../tests/common/mod.rs"]
mod common;
mod compare;
mod dial;
#[allow(dead_code, reason = "its tests run where the pictures are tested")]
#[path = "../../tests/picture/flip.rs"]
mod flip;
mod oracle;
mod plot;
mod scenes;
#[path = "../common/warm.rs"]
mod warm;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use bevy::diagnostic::{DiagnosticPath, DiagnosticsStore};
use bevy::math::UVec2;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy::render::renderer::RenderAdapterInfo;
use bevy_vdb::{VdbCamera, VdbGpuUsage, VdbQuality, VdbRenderMode};
use common::{Picture, Stage};
use compare::Errors;
use rayon::prelude::*;
use vdb_probe::options::{self, Options, Stop, number, size};

const HELP: &str = "\
frontier [OPTION…]
Times pictures over the knobs of VdbQuality, tells what each gets wrong, and draws both.

  --out DIR       where CSV and SVG files go; target/frontier
  --size WxH      of the pictures, the width a multiple of 16; 1920x1080
  --edge N        voxels along an edge of the models, from 64 to 1024; 256
  --runs N        frames of which the median counts, at least 3; 31
  --scenes NAME,… those with such a name only
  --presets yes   the presets only; no
  --budgets MS,…  instead: what VdbDial makes of flights through the scenes, at each of these budgets
";

struct Args {
    out: PathBuf,
    size: UVec2,
    edge: u32,
    runs: usize,
    scenes: Option<String>,
    presets: bool,
    budgets: Vec<f32>,
}

impl Args {
    fn parse() -> Result<Self, Stop> {
        let mut args = Self {
            out: PathBuf::from("target/frontier"),
            size: UVec2::new(1920, 1080),
            edge: 256,
            runs: 31,
            scenes: None,
            presets: false,
            budgets: Vec::new(),
        };
        let mut options = Options::of_program(HELP);
        while let Some(option) = options.next_word()? {
            match option.as_str() {
                "--out" => args.out = options.value(|path| Some(PathBuf::from(path)))?,
                "--size" => {
                    // Rows come back unpadded.
                    let size = |text: &str| size(16..=8192)(text).filter(|size| size.x % 16 == 0);
                    args.size = options.value(size)?;
                }
                "--edge" => args.edge = options.value(number(64..=1024))?,
                "--runs" => args.runs = options.value(number(3..))?,
                "--scenes" => args.scenes = Some(options.value(|all| Some(all.to_owned()))?),
                "--presets" => args.presets = options.value(|text| Some(text == "yes"))?,
                "--budgets" => args.budgets = options.list(number(1e-6..1e6))?,
                _ => return Err(options.unknown()),
            }
        }
        Ok(args)
    }
}

fn main() -> ExitCode {
    options::run("frontier", Args::parse(), run)
}

/// A row of a scene's table.
pub struct Row {
    /// What was set.
    pub quality: VdbQuality,
    /// Of a preset.
    pub name: Option<&'static str>,
    /// Milliseconds of each pass.
    pub passes: [f64; PASSES.len()],
    /// Beside `EXACT`.
    pub errors: Errors,
    /// Whether no other is better in time and error both.
    pub on_front: bool,
    /// How different the picture looks, in the mean: FLIP, of what the front has.
    pub flip: Option<f64>,
}

impl Row {
    /// Milliseconds of all passes.
    pub fn ms(&self) -> f64 {
        self.passes.iter().sum()
    }
}

/// What is timed.
pub const PASSES: [&str; 3] = ["vdb_trace", "vdb_upscale", "vdb_composite"];

/// Seconds after which a setting that takes long has been timed often enough, and how often that is at least.
const ENOUGH: (f64, usize) = (3.0, 5);

fn run(args: &Args) -> Result<(), String> {
    let at = |error: std::io::Error| format!("{}: {error}", args.out.display());
    std::fs::create_dir_all(&args.out).map_err(at)?;
    let mut summary = String::new();
    let wanted = |name: &str| {
        args.scenes.as_ref().is_none_or(|all| all.split(',').any(|part| name.contains(part)))
    };
    let mut shown = 0;
    for scene in scenes::all(args.edge).iter().filter(|scene| wanted(scene.name)) {
        shown += 1;
        let mut stage = Stage::with(|app| {
            app.add_plugins(RenderDiagnosticsPlugin);
        });
        warm::keep_warm(&mut stage.app);
        let size = scene.size(args.size);
        let (target, camera) = scene.build(&mut stage, size);
        if shown == 1 {
            let world = stage.app.sub_app(RenderApp).world();
            let info = world.resource::<RenderAdapterInfo>();
            let _ = writeln!(
                summary,
                "{} ({} {}), {}x{}, models of {} voxels along an edge, lit fog half of both, median of {} frames \
                 or as many as {} s have\n",
                info.name,
                info.driver,
                info.driver_info,
                args.size.x,
                args.size.y,
                args.edge,
                args.runs,
                ENOUGH.0
            );
        }
        if !args.budgets.is_empty() {
            summary += &dial::flights(&mut stage, scene, (&target, camera), &args.budgets)?;
            continue;
        }
        let mut camera = Shooting { stage: &mut stage, camera, target, runs: args.runs };
        let exact = camera.shots(scene.base(VdbQuality::EXACT), scene.has_surface);
        let oracle = oracle::hold(scene, &exact, size)?;
        let (mut rows, mut pictures) = (Vec::new(), Vec::new());
        for (name, quality) in scene.candidates() {
            if args.presets && name.is_none() {
                continue;
            }
            // The one shot last is timed.
            let shots = camera.shots(quality, scene.has_surface);
            let passes = camera.time()?;
            eprintln!("{}: {passes:.3?} ms, {quality:?}", scene.name);
            let errors = compare::errors(&exact, &shots, scene);
            rows.push(Row { quality, name, passes, errors, on_front: false, flip: None });
            pictures.push(shots.lit);
        }
        mark_front(&mut rows);
        rows.par_iter_mut().zip(&pictures).for_each(|(row, picture)| {
            if row.on_front || row.name.is_some() {
                row.flip = Some(compare::looks_different(&exact.lit, picture));
            }
        });
        let _ = writeln!(summary, "## {}\n\n{oracle}\n\n{}", scene.name, plot::summary(&rows));
        let file = scene.name.replace([' ', ','], "-").replace("--", "-");
        let write = |end: &str, text: String| {
            std::fs::write(args.out.join(format!("{file}.{end}")), text).map_err(at)
        };
        std::fs::write(args.out.join("summary.md"), &summary).map_err(at)?;
        write("csv", plot::csv(scene.name, &rows))?;
        write("svg", plot::svg(scene.name, &rows))?;
        println!("{}: {} settings measured", scene.name, rows.len());
    }
    if shown == 0 {
        return Err("no scene has such a name".into());
    }
    std::fs::write(args.out.join("summary.md"), &summary).map_err(at)?;
    print!("{summary}");
    Ok(())
}

/// Marks the rows that no other is better than in time and error both.
fn mark_front(rows: &mut [Row]) {
    let all: Vec<_> = rows.iter().map(|row| (row.ms(), row.errors.radiance)).collect();
    for (row, own) in rows.iter_mut().zip(&all) {
        let beats = |other: &(f64, f64)| {
            other.0 <= own.0 && other.1 <= own.1 && (other.0 < own.0 || other.1 < own.1)
        };
        row.on_front = !all.iter().any(beats);
    }
}

/// Pictures of a setting.
pub struct Shots {
    /// The picture.
    pub lit: Picture,
    /// Where there is a surface: depth, and normals.
    pub surface: Option<(Picture, Picture)>,
}

struct Shooting<'a> {
    stage: &'a mut Stage,
    camera: Entity,
    target: Handle<Image>,
    runs: usize,
}

impl Shooting<'_> {
    fn shots(&mut self, quality: VdbQuality, has_surface: bool) -> Shots {
        let mut shot = |mode| {
            // As the reference tracer has it.
            let camera = VdbCamera { mode, multiple_scattering: false, ..default() };
            self.stage.world().entity_mut(self.camera).insert((quality, camera));
            wait_for_levels(self.stage, quality.detail > 0.0);
            self.stage.picture(&self.target)
        };
        let surface =
            has_surface.then(|| (shot(VdbRenderMode::Depth), shot(VdbRenderMode::Normals)));
        Shots { lit: shot(VdbRenderMode::Lit), surface }
    }

    /// Milliseconds of each pass of the setting shot last: the medians.
    fn time(&mut self) -> Result<[f64; PASSES.len()], String> {
        let mut times = Vec::new();
        let start = Instant::now();
        // What comes first is of frames before, and of a GPU that was idle.
        for _ in 0..4 * self.runs + 40 {
            self.stage.update(1);
            let newest = newest_times(self.stage.world());
            times.extend(newest.filter(|(at, _)| times.last().is_none_or(|(last, _)| last != at)));
            let is_slow = start.elapsed().as_secs_f64() > ENOUGH.0 && times.len() >= ENOUGH.1 + 3;
            if times.len() >= self.runs + 3 || is_slow {
                break;
            }
        }
        if times.len() < self.runs.min(ENOUGH.1) + 3 {
            return Err("the adapter has no timestamp queries within encoders and passes".into());
        }
        Ok(std::array::from_fn(|pass| {
            let mut times: Vec<f64> = times.iter().skip(3).map(|(_, all)| all[pass]).collect();
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        }))
    }
}

/// The GPU's newest times, and when they came.
pub fn newest_times(world: &World) -> Option<(Instant, [f64; PASSES.len()])> {
    let store = world.resource::<DiagnosticsStore>();
    let newest = |pass: &str| {
        let path = DiagnosticPath::new(format!("render/{pass}/elapsed_gpu"));
        store.get(&path).and_then(|diagnostic| diagnostic.measurement())
    };
    let trace = newest(PASSES[0])?;
    let ms = PASSES.map(|pass| {
        newest(pass).filter(|found| found.time == trace.time).map_or(0.0, |found| found.value)
    });
    Some((trace.time, ms))
}

/// Goes on until levels of detail are there, which are made in the background where they can be seen, or gone
/// again.
fn wait_for_levels(stage: &mut Stage, wanted: bool) {
    for _ in 0..2_000 {
        stage.update(1);
        let levels = stage.world().resource::<VdbGpuUsage>().levels();
        if (levels > 0) == wanted {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
}
