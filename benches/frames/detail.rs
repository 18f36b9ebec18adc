//! Surfaces at growing resolution: with levels of detail, the cost should follow the pixels and not the voxels, from
//! afar and from within.

use std::time::{Duration, Instant};

use bevy::camera::Hdr;
use bevy::diagnostic::{Diagnostic, DiagnosticsStore};
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::models;
use bevy_vdb::vdb_core::tree::Vdb543;
use bevy_vdb::{VdbGpuUsage, VdbRenderMode};

use crate::studio::Studio;
use crate::{Args, print_heading, summary};

/// Edges of the models in voxels.
const EDGES: [u32; 3] = [256, 1024, 4096];
/// A gyroid of 4096 voxels would take 6 GB.
const LARGEST_GYROID: u32 = 2048;
/// World units across the longest edge of a model, seen from afar, filling the picture, or from within.
const SIZES: [(&str, f32); 3] = [("from afar", 1.2), ("near", 2.4), ("from within", 9.0)];
const LIGHTS: [(&str, VdbRenderMode); 2] =
    [("none", VdbRenderMode::Gray), ("a sun", VdbRenderMode::Lit)];
/// Pixels per voxel.
const DETAILS: [f32; 3] = [0.0, 0.5, 1.0];
/// The coarsest level has at most this many voxels along an edge.
const COARSEST: u32 = 32;
/// The longest wait for levels, which are made in the background.
const PATIENCE: Duration = Duration::from_secs(60);
/// The distance of the camera from the middle of the model, rounded down.
const DISTANCE: f32 = 2.29;

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::with_gpu_times(args.size)?;
    print_heading(&studio, "Detail", args.size);
    println!(
        "Medians of {} frames, all passes, ms; in brackets, the ratio to the time at the lowest resolution.\n",
        args.frames
    );
    let columns = DETAILS.map(|detail| format!("detail {detail}")).join(" | ");
    println!("| model | shown as | seen | light | voxels | {columns} | levels |");
    println!("|---|---|---|---|---|---|---|---|---|");
    let models: [(&str, fn(u32) -> Vdb543<f32>); 2] =
        [("truss", models::truss_station), ("gyroid", models::gyroid)];
    let kinds =
        [("voxels", PackKind::Surface { iso: 0.0 }), ("smooth", PackKind::Smooth { iso: 0.0 })];
    studio.camera_mut().insert((Hdr, Msaa::Off));
    for (name, make) in models {
        for (kind_name, kind) in kinds {
            let mut first = [[None; DETAILS.len()]; SIZES.len() * LIGHTS.len()];
            for edge in EDGES {
                let edge = if name == "gyroid" { edge.min(LARGEST_GYROID) } else { edge };
                let rows = rows(&mut studio, args, (make(edge), edge), kind)?;
                for (row, first) in rows.into_iter().zip(&mut first) {
                    let cells = row.ms.iter().zip(first).map(|(ms, first)| {
                        let first = *first.get_or_insert(*ms);
                        format!("{ms:.3} ({:.2})", ms / first)
                    });
                    println!(
                        "| {name} | {kind_name} | {} | {} | {edge} | {} | {} |",
                        row.seen,
                        row.light,
                        cells.collect::<Vec<_>>().join(" | "),
                        row.levels,
                    );
                }
            }
        }
    }
    Ok(())
}

struct Row {
    seen: &'static str,
    light: &'static str,
    ms: [f64; DETAILS.len()],
    /// Coarser levels on the GPU at the last of the details.
    levels: u64,
}

/// The times of a model of each size under each light.
fn rows(
    studio: &mut Studio,
    args: &Args,
    (tree, edge): (Vdb543<f32>, u32),
    kind: PackKind,
) -> Result<Vec<Row>, String> {
    let bbox = tree.active_bbox().ok_or("the model is empty")?;
    let middle = (bbox.min + bbox.max).as_dvec3() * 0.5;
    let world_from_index = DAffine3::from_scale(DVec3::splat(1.0 / f64::from(edge)))
        * DAffine3::from_translation(-middle);
    let grid = VdbGrid::new("model", tree, world_from_index, kind);
    let grid = grid.map_err(|error| error.to_string())?;
    let grid = studio.app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid);
    let volume = studio.app.world_mut().spawn(VdbVolume(grid)).id();
    let views = SIZES.into_iter().flat_map(|size| LIGHTS.map(|light| (size, light)));
    let row = |((seen, _), (light, _))| Row { seen, light, ms: [0.0; DETAILS.len()], levels: 0 };
    let mut rows: Vec<Row> = views.clone().map(row).collect();
    for (i, detail) in DETAILS.into_iter().enumerate() {
        for (row, ((_, size), (_, mode))) in rows.iter_mut().zip(views.clone()) {
            let at = Transform::from_scale(Vec3::splat(size));
            studio.app.world_mut().entity_mut(volume).insert(at);
            let quality = VdbQuality { detail, ..default() };
            studio.camera_mut().insert((quality, VdbCamera { mode, ..default() }));
            // Of corners around the middle of the world, one is at least as far away as the middle. If a pixel
            // there covers a voxel, levels are made for certain; otherwise they may be.
            let pixel = 2.0 * std::f32::consts::FRAC_PI_8.tan() * DISTANCE / args.size.y as f32;
            row.levels = wait_for_levels(studio, edge, detail * pixel * edge as f32 > size)?;
            row.ms[i] = time(studio, args);
        }
    }
    studio.app.world_mut().despawn(volume);
    studio.frames(10);
    Ok(rows)
}

/// Renders until the levels are on the GPU, if they are certain to be made; they stay until no camera has a `detail`
/// above 0. Returns how many there are.
fn wait_for_levels(studio: &mut Studio, edge: u32, are_certain: bool) -> Result<u64, String> {
    let there = |studio: &Studio| studio.app.world().resource::<VdbGpuUsage>().levels();
    let all = u64::from((edge / COARSEST).ilog2());
    let start = Instant::now();
    while are_certain && there(studio) != all && start.elapsed() < PATIENCE {
        studio.frames(1);
    }
    if are_certain && there(studio) != all {
        return Err(format!("the levels of {edge} voxels do not come"));
    }
    studio.settle(1)?;
    Ok(there(studio))
}

/// The median of all passes in ms, once around the model.
fn time(studio: &mut Studio, args: &Args) -> f64 {
    let mut store = studio.app.world_mut().resource_mut::<DiagnosticsStore>();
    store.iter_mut().for_each(Diagnostic::clear_history);
    let mut all = Vec::new();
    studio.begin_round(args.frames);
    studio.frames_after(args.frames, |studio| all.extend(studio.passes_ms()));
    if all.is_empty() { 0.0 } else { summary(&mut all)[0] }
}
