//! What a frame is made of: its passes, Bevy's beside ours, and the features of its camera.

use std::collections::BTreeMap;
use std::time::Instant;

use bevy::camera::Hdr;
use bevy::diagnostic::DiagnosticsStore;
use bevy::light::NotShadowCaster;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{fog, level_set};
use bevy_vdb::{VdbEmission, VdbFeatureCosts, VdbMeasureFeatures};

use crate::studio::Studio;
use crate::{Args, print_heading};

/// Frames in which a measurement of features ends, and more.
const MAX_FRAMES: usize = 20_000;

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::with_gpu_times(args.size)?;
    print_heading(&studio, "Parts", args.size);
    let cloud = studio.grid(fog::sphere(DVec3::ZERO, 90.0, 40.0), PackKind::Fog, 1.0 / 90.0)?;
    let thin = VdbMaterial { density_scale: 4.0, ..default() };
    let all_over = Transform::from_scale(Vec3::splat(4.0));
    let volume = studio.app.world_mut().spawn((VdbVolume(cloud.clone()), thin, all_over)).id();
    // Without HDR, Bevy has no pass over the picture of its own but the last; with MSAA, ours writes each
    // pixel as often as that has samples.
    // Without levels of detail, which are made beside the frames.
    let fast = VdbQuality { detail: 0.0, ..VdbQuality::FAST };
    studio.camera_mut().insert((Hdr, Msaa::Off, fast));
    studio.settle(1)?;
    print_passes(&mut studio, args.frames, "fog all over the picture", |_| {});
    shade_a_room(&mut studio, args.frames, volume)?;

    studio.camera_mut().insert(VdbQuality { reflections: 1, ..VdbQuality::BALANCED });
    studio.app.world_mut().entity_mut(volume).insert((
        Transform::from_xyz(0.0, 0.9, 0.0).with_scale(Vec3::splat(0.5)),
        VdbMaterial { density_scale: 8.0, ..default() },
        VdbEmission::Temperature { grid: cloud, scale: 1800.0, offset: 0.0, strength: 1e-3 },
    ));
    let gyroid = || level_set::gyroid(DVec3::ZERO, 120.0, 60.0);
    let smooth = studio.grid(gyroid(), PackKind::Smooth { iso: 0.0 }, 1.0 / 200.0)?;
    let voxels = studio.grid(gyroid(), PackKind::Surface { iso: 0.0 }, 1.0 / 200.0)?;
    let gold = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.2, ..default() };
    let world = studio.app.world_mut();
    world.spawn((VdbVolume(smooth), gold, Transform::from_xyz(-0.6, 0.0, 0.0)));
    world.spawn((VdbVolume(voxels), Transform::from_xyz(0.6, 0.0, 0.0)));
    let floor = world.resource_mut::<Assets<Mesh>>().add(Plane3d::default().mesh().size(4.0, 4.0));
    let gray = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial::default());
    world.spawn((Mesh3d(floor), MeshMaterial3d(gray), Transform::from_xyz(0.0, -0.7, 0.0)));
    // The temperatures are the densities.
    studio.settle(3)?;
    print_passes(
        &mut studio,
        args.frames,
        "a gyroid of gold, one of voxels, a fire, a floor of a mesh",
        |_| {},
    );

    studio.camera_mut().insert(VdbMeasureFeatures);
    let mut frames = 0;
    while studio.camera_mut().contains::<VdbMeasureFeatures>() {
        // Features are compared with a picture that stays.
        studio.app.update();
        frames += 1;
        if frames > MAX_FRAMES {
            return Err("features are measured for ever".into());
        }
    }
    let costs = studio.camera_mut().get::<VdbFeatureCosts>().cloned().unwrap_or_default();
    let clock = if costs.is_gpu_time { "the GPU's clock" } else { "the app's clock" };
    println!("\nThe same after {frames} frames of VdbMeasureFeatures, by {clock}:\n");
    println!("| feature | ms |\n|---|---|\n| all | {:.3} |", costs.total_ms);
    for feature in &costs.features {
        println!("| {} | {:.3} |", feature.name, feature.ms);
    }
    Ok(())
}

/// The same fog in a room: a mesh behind every pixel, much of it in the shadow of the fog.
fn shade_a_room(studio: &mut Studio, frames: usize, fog: Entity) -> Result<(), String> {
    let world = studio.app.world_mut();
    let room = world.resource_mut::<Assets<Mesh>>().add(Sphere::new(8.0).mesh().uv(128, 64));
    let inside = StandardMaterial { cull_mode: None, double_sided: true, ..default() };
    let inside = world.resource_mut::<Assets<StandardMaterial>>().add(inside);
    let room = world.spawn((Mesh3d(room), MeshMaterial3d(inside), NotShadowCaster)).id();
    for (denoise, what) in [(false, "the same in a room"), (true, "the same with `denoise`")] {
        let fast = VdbQuality { detail: 0.0, denoise, ..VdbQuality::FAST };
        studio.camera_mut().insert(fast);
        studio.settle(1)?;
        print_passes(studio, frames, what, |_| {});
    }
    print_passes(studio, frames, "the same while the fog turns", |world| {
        let mut fog = world.entity_mut(fog);
        fog.get_mut::<Transform>().into_iter().for_each(|mut at| at.rotate_y(0.01));
    });
    studio.app.world_mut().despawn(room);
    Ok(())
}

/// Medians of the passes, the dearest first. `change` is called before each frame.
fn print_passes(studio: &mut Studio, frames: usize, what: &str, change: impl Fn(&mut World)) {
    let start = Instant::now();
    // Of each pass when it was last timed, and all times.
    let mut times = BTreeMap::<String, (Instant, Vec<f64>)>::new();
    for _ in 0..frames {
        studio.frames_after(1, |studio| change(studio.app.world_mut()));
        for diagnostic in studio.app.world().resource::<DiagnosticsStore>().iter() {
            let path = diagnostic.path().as_str();
            let pass =
                path.strip_prefix("render/").and_then(|rest| rest.strip_suffix("/elapsed_gpu"));
            let (Some(pass), Some(newest)) = (pass, diagnostic.measurement()) else { continue };
            let (last, all) = times.entry(pass.into()).or_insert((start, Vec::new()));
            // The GPU's times come frames late; of what no longer runs, none comes.
            if newest.time > *last {
                *last = newest.time;
                all.push(newest.value);
            }
        }
    }
    let mut medians: Vec<_> = times
        .into_iter()
        .filter_map(|(pass, (_, mut times))| {
            times.sort_by(f64::total_cmp);
            Some((pass, *times.get(times.len() / 2)?))
        })
        .collect();
    medians.sort_by(|a, b| b.1.total_cmp(&a.1));
    println!("\n{what}:\n\n| pass | ms |\n|---|---|");
    medians.iter().for_each(|(pass, ms)| println!("| {pass} | {ms:.3} |"));
}
