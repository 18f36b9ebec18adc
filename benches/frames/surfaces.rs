//! A level set in the sun: what smooth normals and further rays on edges cost, and how much they improve
//! the image.

use bevy::camera::Hdr;
use bevy::diagnostic::{Diagnostic, DiagnosticsStore};
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::level_set;
use bevy_vdb::{VdbDiagnostics, VdbRenderMode};

use crate::studio::Studio;
use crate::{Args, model, print_heading, summary};

/// World units across the longest edge of the model, most of the width of the image.
const EDGE: f64 = 2.4;
/// Rays per pixel of the image that errors are measured against.
const REFERENCE_RAYS: u32 = 64;
const COLUMNS: [&str; 3] = ["vdb_trace", "vdb_edges", "vdb_refine"];

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::with_gpu_times(args.size)?;
    print_heading(&studio, "Surfaces", args.size);
    for (name, kind) in
        [("smooth", PackKind::Smooth { iso: 0.0 }), ("voxels", PackKind::Surface { iso: 0.0 })]
    {
        let made = || ("a gyroid".to_owned(), level_set::gyroid(DVec3::ZERO, 115.0, 51.0));
        let grid = model::grid(&mut studio, args, kind, EDGE, made)?;
        let volume = studio.app.world_mut().spawn(VdbVolume(grid)).id();
        let ambient = AmbientLight { brightness: 300.0, ..default() };
        studio.camera_mut().insert((Hdr, Msaa::Off, ambient));
        println!(
            "| {name} | {} | all passes, ms | ratio | off by, RMS of 255 | ratio |",
            COLUMNS.map(|pass| format!("{pass}, ms")).join(" | ")
        );
        println!("|---|---|---|---|---|---|---|---|");
        table(&mut studio, args)?;
        println!();
        studio.app.world_mut().despawn(volume);
    }
    Ok(())
}

fn table(studio: &mut Studio, args: &Args) -> Result<(), String> {
    let one = VdbQuality { edge_samples: 0, ..VdbQuality::HIGH };
    let edges = |edge_samples| VdbQuality { edge_samples, ..VdbQuality::HIGH };
    let mean = VdbQuality { accumulate: REFERENCE_RAYS, ..one };
    studio.camera_mut().insert((mean, VdbCamera::default()));
    studio.settle(1)?;
    studio.is_camera_moving = false;
    studio.begin_round(args.frames);
    studio.frames(2 * REFERENCE_RAYS as usize);
    let reference = studio.picture()?;
    let unlit = VdbCamera { mode: VdbRenderMode::Gray, ..default() };
    let rows = [
        ("one ray", one, VdbCamera::default()),
        ("unlit", one, unlit),
        ("trilinear normals", VdbQuality { smooth_normals: false, ..one }, VdbCamera::default()),
        ("2 on edges", edges(2), VdbCamera::default()),
        ("4 on edges", edges(4), VdbCamera::default()),
        ("8 on edges", edges(8), VdbCamera::default()),
        ("16 on edges", edges(16), VdbCamera::default()),
    ];
    let mut first = None;
    for (name, quality, camera) in rows {
        studio.camera_mut().insert((quality, camera));
        studio.settle(1)?;
        studio.is_camera_moving = false;
        studio.begin_round(args.frames);
        studio.frames(1);
        let error = rms(&studio.picture()?, &reference);
        studio.is_camera_moving = true;
        let (times, all) = times(studio, args);
        let (first_ms, first_error) = *first.get_or_insert((all, error));
        println!(
            "| {name} | {} | {all:.3} | {:.2} | {error:.2} | {:.2} |",
            times.map(|ms| if ms > 0.0 { format!("{ms:.3}") } else { "–".into() }).join(" | "),
            all / first_ms,
            error / first_error,
        );
    }
    Ok(())
}

/// Medians of the passes of [`COLUMNS`] and of all passes, in ms, once around the model.
fn times(studio: &mut Studio, args: &Args) -> ([f64; COLUMNS.len()], f64) {
    let mut times: [Vec<f64>; COLUMNS.len()] = default();
    let mut all = Vec::new();
    let mut store = studio.app.world_mut().resource_mut::<DiagnosticsStore>();
    store.iter_mut().for_each(Diagnostic::clear_history);
    studio.begin_round(args.frames);
    studio.frames_after(args.frames, |studio| {
        let world = studio.app.world();
        let store = world.resource::<DiagnosticsStore>();
        let of = |pass| VdbDiagnostics::pass_ms(store, pass);
        for (times, pass) in times.iter_mut().zip(COLUMNS) {
            times.extend(of(pass));
        }
        all.extend(studio.passes_ms());
    });
    let median = |mut times: Vec<f64>| if times.is_empty() { 0.0 } else { summary(&mut times)[0] };
    (times.map(median), median(all))
}

/// The root mean square of the differences of all components.
fn rms(a: &[u8], b: &[u8]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
    // Alpha is the same everywhere.
    (sum / (0.75 * a.len() as f64)).sqrt()
}
