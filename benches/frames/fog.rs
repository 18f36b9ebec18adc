//! Fog in the sun that fills the image: the light cache, and the trace that reads it.

use bevy::camera::Hdr;
use bevy::diagnostic::DiagnosticsStore;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::VdbDiagnostics;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::fog;
use bevy_vdb::vdb_core::tree::CoordBox;
use bevy_vdb::vdb_core::{AnyTree, VdbFile};

use crate::studio::Studio;
use crate::{Args, print_heading, summary};

/// The radius in voxels of the cloud that is made if no file is given.
const RADIUS: f64 = 128.0;
/// World units across the longest edge of the cloud: more than the camera's orbit.
const EDGE: f64 = 4.0;
/// The edge in voxels of the fire.
const FIRE_EDGE: u32 = 128;
/// The highest temperature in kelvin, and the emission strength: about as bright as the sunlit smoke.
const HOTTEST: f32 = 1800.0;
const STRENGTH: f32 = 1e-3;

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::with_gpu_times(args.size)?;
    print_heading(&studio, "Fog", args.size);
    let (name, tree) = match &args.model {
        Some(path) => {
            let file = VdbFile::open(path).map_err(|error| error.to_string())?;
            let grid = file.grids.into_iter().next().ok_or("the file has no grid")?;
            let AnyTree::Float(tree) = grid.tree else {
                return Err("the first grid of the file is not a float grid".into());
            };
            (path.display().to_string(), (*tree).clone())
        }
        None => (format!("a cloud of radius {RADIUS}"), fog::cloud(RADIUS, 7)),
    };
    let bbox = tree.active_bbox().ok_or("the grid is empty")?;
    let edge = f64::from((bbox.max - bbox.min).max_element() + 1);
    let middle = (bbox.min + bbox.max).as_dvec3() * 0.5;
    let world_from_index =
        DAffine3::from_scale(DVec3::splat(EDGE / edge)) * DAffine3::from_translation(-middle);
    let grid = VdbGrid::new("cloud", tree, world_from_index, PackKind::Fog);
    let grid = grid.map_err(|error| error.to_string())?;
    let grid = studio.app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid);
    println!("{name}, {edge} voxels along its longest edge; medians of {} frames\n", args.frames);
    println!(
        "| scene | settings | light cache, ms | trace, ms | cache, MiB |\n|---|---|---|---|---|"
    );
    let material = VdbMaterial { density_scale: args.density, anisotropy: 0.6, ..default() };
    let cloud = studio.app.world_mut().spawn((VdbVolume(grid.clone()), material.clone())).id();
    studio.camera_mut().insert((Hdr, Msaa::Off));
    let rays = VdbQuality { fog_light_error: 0.0, ..VdbQuality::HIGH };
    let presets = [
        ("HIGH, by rays", rays),
        ("HIGH", VdbQuality::HIGH),
        ("BALANCED", VdbQuality::BALANCED),
        ("FAST", VdbQuality { detail: 0.0, ..VdbQuality::FAST }),
    ];
    for (name, quality) in presets {
        studio.camera_mut().insert(quality);
        studio.settle(1)?;
        row(&mut studio, args, ("still", name), |_| {});
    }
    for (name, quality) in &presets[1..] {
        studio.camera_mut().insert(*quality);
        studio.settle(1)?;
        row(&mut studio, args, ("the sun moves", *name), |studio| {
            let world = studio.app.world_mut();
            let mut suns = world.query_filtered::<&mut Transform, With<DirectionalLight>>();
            suns.iter_mut(world).for_each(|mut sun| sun.rotate_y(0.01));
        });
    }
    let others = [1, 2, 3].map(|i| {
        let angle = std::f32::consts::FRAC_PI_2 * i as f32;
        let at = Transform::from_xyz(0.7 * angle.cos(), 0.0, 0.7 * angle.sin())
            .with_rotation(Quat::from_rotation_y(angle));
        studio.app.world_mut().spawn((VdbVolume(grid.clone()), material.clone(), at)).id()
    });
    for (name, quality) in presets {
        studio.camera_mut().insert(quality);
        studio.settle(1)?;
        row(&mut studio, args, ("four clouds", name), |_| {});
    }
    for other in others {
        studio.app.world_mut().despawn(other);
    }
    let fire = fire(&mut studio)?;
    studio.app.world_mut().entity_mut(cloud).insert(fire);
    for (name, quality) in presets {
        studio.camera_mut().insert(quality);
        studio.settle(2)?;
        row(&mut studio, args, ("fire in smoke", name), |_| {});
    }
    Ok(())
}

/// A flame half as tall as the cloud.
fn fire(studio: &mut Studio) -> Result<VdbEmission, String> {
    let half = FIRE_EDGE as i32 / 2;
    let cube = CoordBox { min: IVec3::splat(-half), max: IVec3::splat(half - 1) };
    let flames = fog::from_values(cube, |at| {
        let p = at.as_vec3() / FIRE_EDGE as f32;
        let axis = Vec2::new(p.x + 0.08 * (9.0 * p.y).sin(), p.z + 0.08 * (7.0 * p.y).cos());
        (0.5 - p.y - (5.0 * axis.length()).powi(2)).clamp(0.0, 1.0)
    });
    let voxel = DAffine3::from_scale(DVec3::splat(0.5 * EDGE / f64::from(FIRE_EDGE)));
    let grid = VdbGrid::new("temperature", flames, voxel, PackKind::Fog);
    let grid = grid.map_err(|error| error.to_string())?;
    let grid = studio.app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid);
    Ok(VdbEmission::Temperature { grid, scale: HOTTEST, offset: 0.0, strength: STRENGTH })
}

/// A row of the table.
fn row(
    studio: &mut Studio,
    args: &Args,
    (scene, settings): (&str, &str),
    mut act: impl FnMut(&mut Studio),
) {
    let (mut fill, mut trace) = (Vec::new(), Vec::new());
    studio.frames_after(args.frames + 10, |studio| {
        act(studio);
        let store = studio.app.world().resource::<DiagnosticsStore>();
        let of = |pass| VdbDiagnostics::pass_ms(store, pass);
        trace.extend(of("vdb_trace"));
        fill.extend(of("vdb_light_cache"));
    });
    let bytes = studio.app.world().resource::<VdbDiagnostics>().cameras().first().map_or(
        0,
        |(_, report)| {
            let own = report.buffers.iter().filter(|own| own.name.starts_with("vdb_light_"));
            own.map(|own| own.bytes).sum()
        },
    );
    let median = |mut times: Vec<f64>| {
        // The first ones are of the scene before.
        times.drain(..times.len().min(10));
        if times.is_empty() { 0.0 } else { summary(&mut times)[0] }
    };
    println!(
        "| {scene} | {settings} | {:.3} | {:.3} | {:.1} |",
        median(fill),
        median(trace),
        bytes as f64 / f64::from(1 << 20)
    );
}
