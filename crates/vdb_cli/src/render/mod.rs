//! `vdb render`: a picture of a file, without a window and without a GPU.

mod camera;
mod fog;
mod glow;
mod light_map;
mod lights;
mod medium;
mod options;
mod picture;
mod ray;
mod scene;
mod sun_in_fog;
mod surface;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use glam::Vec3;
use serde::Serialize;
use vdb_core::display::quoted;
use vdb_core::save_bytes;

use camera::{Camera, CameraArgs};
use fog::LitFog;
use glow::Glow;
use light_map::LightMap;
use lights::Lights;
use medium::Medium;
use options::{Background, Light, MAX_SAMPLES, Rgb, Size};
use picture::{Picture, Shader};
use scene::Scene;
use sun_in_fog::SunInFog;

use crate::files::{open, shown};
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::terminal;

/// The optical depth that the denser parts of a fog have by default: opaque, with soft borders.
const DEPTH: f32 = 9.0;
/// The same of smoke with a fire in it, which is seen through the smoke.
const SMOKE_DEPTH: f32 = 0.25;
/// The share of a fog's rays that are thinner than its denser parts.
const DENSER: f64 = 0.8;

/// Draw a picture of a file, without a window or a GPU
#[derive(clap::Args)]
pub struct Args {
    /// The file: .vdb or .nvdb
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// The picture, a .png
    #[arg(long, value_name = "PNG")]
    out: PathBuf,

    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    size: Size,

    /// The grid; by default what the viewer shows: surfaces, and fog with its fire
    #[arg(long, value_name = "NAME")]
    grid: Option<String>,

    /// Show the surface at this value, of fog, too; 0 by default for level sets
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    iso: Option<f32>,

    /// Rays for each pixel: by default 4, or 1 if there is only fog, which has no edges
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)))]
    samples: Option<u32>,

    /// What surfaces show
    #[arg(long, value_enum, default_value_t = Shader::Diffuse)]
    shader: Shader,

    /// What is behind: `transparent`, `black`, `white` or a colour such as #20262e
    #[arg(long, value_name = "COLOR", default_value = "#262d38")]
    background: Background,

    #[command(flatten)]
    camera: CameraArgs,

    #[command(flatten)]
    lights: LightArgs,

    /// Print JSON: what is shown, and the camera
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Light and fog")]
struct LightArgs {
    /// The direction towards the sun, and perhaps its colour; by default above the camera's left
    /// shoulder
    #[arg(long, value_name = "X,Y,Z[,R,G,B]", allow_hyphen_values = true)]
    light: Option<Light>,

    /// Light from all directions; by default a sky
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true)]
    ambient: Option<Rgb>,

    /// The sun casts no shadows on surfaces
    #[arg(long)]
    no_shadows: bool,

    /// Fog: the absorption coefficient at a density of 1, per world unit
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, default_value = "0,0,0")]
    absorb: Rgb,

    /// Fog: the scattering coefficient; by default one that makes the denser parts opaque
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true)]
    scatter: Option<Rgb>,
}

/// What was drawn, as `--json` prints it.
#[derive(Serialize)]
struct Report {
    from: String,
    to: String,
    size: [u32; 2],
    surfaces: Vec<String>,
    fog: Option<String>,
    fire: Option<String>,
    /// The position of the camera, and unit vectors: the direction that it looks in, and up.
    eye: [f64; 3],
    forward: [f64; 3],
    up: [f64; 3],
    /// Of the fog, per world unit at a density of 1.
    extinction: Option<[f32; 3]>,
    seconds: f64,
}

/// Draws the picture. The exit code is a failure if it could not be drawn, and 2 if the options do not
/// fit.
pub fn run(args: &Args) -> ExitCode {
    if let Err(error) = check(args) {
        terminal::complain(&error);
        return ExitCode::from(2);
    }
    terminal::finish(make(args).map(|report| said(&report, args.json)))
}

fn check(args: &Args) -> Result<(), String> {
    if !args.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        return Err(format!("{}: the name of the picture must end in .png", shown(&args.out)));
    }
    if args.iso.is_some_and(|iso| !iso.is_finite()) {
        return Err("--iso must be a finite number".to_owned());
    }
    args.camera.check()
}

fn make(args: &Args) -> Result<Report, String> {
    let limits = args.limits.limits();
    let mut file = open(&args.file, &args.limits)?;
    let converted = file.convert_to_floats(&limits);
    let scene = Scene::new(&file, &args.file, args.grid.as_deref(), args.iso, &limits)?;
    for converted in converted {
        if scene.volumes().any(|volume| volume.name == converted.grid) {
            terminal::complain(&format!("{}: {converted}", shown(&args.file)));
        }
    }
    drop(file);
    if args.shader != Shader::Diffuse && scene.surfaces.is_empty() {
        let path = shown(&args.file);
        return Err(format!("{path}: fog has no normals and positions; give a value with --iso"));
    }
    let begun = Instant::now();
    let size = args.size.0;
    let aspect = f64::from(size.x) / f64::from(size.y);
    let camera = Camera::new(&args.camera, &scene, aspect);
    let lights = Lights::new(args.lights.light, args.lights.ambient, &camera, args.camera.up());
    let map = scene.fog.as_ref().map(|fog| LightMap::new(&scene, fog, lights.to_sun));
    let medium = map.as_ref().map(|map| medium(&args.lights, map, scene.fire.is_some()));
    let glow = scene.fire.as_ref().map(Glow::new);
    let sun = match (&scene.fog, &medium, &map) {
        (Some(fog), Some(medium), Some(map)) if lights.has_sun() => {
            Some(SunInFog::new(fog, medium, map, lights.to_sun))
        }
        _ => None,
    };
    let fog = scene.fog.as_ref().zip(medium).map(|(volume, medium)| LitFog {
        volume,
        medium,
        sun: sun.as_ref(),
        lights: &lights,
        glow: glow.as_ref(),
    });
    let picture = Picture {
        scene: &scene,
        camera: &camera,
        lights: &lights,
        fog,
        shader: args.shader,
        shadows: !args.lights.no_shadows,
        background: args.background,
        size,
        samples: args.samples.unwrap_or(if scene.surfaces.is_empty() { 1 } else { 4 }),
    };
    let progress = Progress::making(&args.file);
    let pixels = picture.draw(&*progress.callback())?;
    drop(progress);
    let seconds = begun.elapsed().as_secs_f64();
    save(&args.out, &picture, &pixels)?;
    let text = |path: &Path| path.to_string_lossy().into_owned();
    Ok(Report {
        from: text(&args.file),
        to: text(&args.out),
        size: size.to_array(),
        surfaces: scene.surfaces.iter().map(|volume| volume.name.clone()).collect(),
        fog: scene.fog.as_ref().map(|fog| fog.name.clone()),
        fire: scene.fire.as_ref().map(|fire| fire.volume.name.clone()),
        eye: camera.eye.to_array(),
        forward: (-camera.back).to_array(),
        up: camera.up.to_array(),
        extinction: medium.map(|medium| medium.extinction.to_array()),
        seconds,
    })
}

/// The optical properties that the options ask for.
fn medium(args: &LightArgs, map: &LightMap, has_fire: bool) -> Medium {
    let depth = if has_fire { SMOKE_DEPTH } else { DEPTH };
    let fitting =
        || Vec3::splat(depth / map.quantile(DENSER).max(f32::MIN_POSITIVE)).min(Vec3::splat(1e30));
    let scatter = args.scatter.map_or_else(fitting, |Rgb(scatter)| scatter);
    let extinction = args.absorb.0 + scatter;
    Medium { extinction, albedo: (scatter / extinction.max(Vec3::splat(f32::MIN_POSITIVE))) }
}

/// Writes the picture, completely or not at all.
fn save(path: &Path, picture: &Picture, pixels: &[u8]) -> Result<(), String> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, picture.size.x, picture.size.y);
    encoder.set_color(match picture.channels() {
        4 => png::ColorType::Rgba,
        _ => png::ColorType::Rgb,
    });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
    writer.write_image_data(pixels).map_err(|error| error.to_string())?;
    writer.finish().map_err(|error| error.to_string())?;
    save_bytes(path, &bytes).map_err(|error| error.in_file(path).to_string())
}

fn said(report: &Report, json: bool) -> String {
    if json {
        let text = serde_json::to_string_pretty(report);
        return text.map_or_else(|error| error.to_string(), |text| text + "\n");
    }
    let surfaces = report.surfaces.iter().map(|name| format!("surface {}", quoted(name)));
    let fog = report.fog.iter().map(|name| format!("fog {}", quoted(name)));
    let fire = report.fire.iter().map(|name| format!("fire {}", quoted(name)));
    let parts: Vec<String> = surfaces.chain(fog).chain(fire).collect();
    let [width, height] = report.size;
    format!("{width}x{height} pixels of {} in {:.2} s\n", parts.join(", "), report.seconds)
}
