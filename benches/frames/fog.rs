//! Lit fog that fills the image: the light cache, the light of lamps, and the trace that reads both.

use bevy::camera::Hdr;
use bevy::diagnostic::{Diagnostic, DiagnosticsStore};
use bevy::math::{DAffine3, DVec3, UVec2};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::fog;
use bevy_vdb::vdb_core::tree::CoordBox;
use bevy_vdb::{VdbCameraReport, VdbDiagnostics};

use crate::edits::{Running, large_fog};
use crate::studio::Studio;
use crate::{Args, model, print_heading, summary};

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
    let made = || (format!("a cloud of radius {RADIUS}"), fog::cloud(RADIUS, 7));
    let grid = model::grid(&mut studio, args, PackKind::Fog, EDGE, made)?;
    println!(
        "| scene | settings | light cache, ms | scattered light | light of lamps | trace | all passes | \
         memory, MiB | off by, % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let material = VdbMaterial { density_scale: args.density, anisotropy: 0.6, ..default() };
    let cloud = studio.app.world_mut().spawn((VdbVolume(grid.clone()), material.clone())).id();
    let scattering = VdbCamera { multiple_scattering: !args.single_scattering, ..default() };
    studio.camera_mut().insert((Hdr, Msaa::Off, scattering));
    let rays = VdbQuality { fog_light_error: 0.0, ..VdbQuality::HIGH };
    let presets = [
        ("HIGH, by rays", rays),
        ("HIGH", VdbQuality::HIGH),
        ("BALANCED", VdbQuality::BALANCED),
        ("FAST", VdbQuality { detail: 0.0, ..VdbQuality::FAST }),
    ];
    let by_cache = &presets[1..];
    rows(&mut studio, args, ("still", 1), &presets, None)?;
    let mut turn_sun = |studio: &mut Studio| {
        let world = studio.app.world_mut();
        let mut suns = world.query_filtered::<&mut Transform, With<DirectionalLight>>();
        suns.iter_mut(world).for_each(|mut sun| sun.rotate_y(0.01));
        Ok(())
    };
    rows(&mut studio, args, ("the sun moves", 1), by_cache, Some(&mut turn_sun))?;

    let lamps = lamps(&mut studio);
    // By rays, a frame would take seconds. While the camera moves, the light that fog scatters
    // towards it is gathered in every frame.
    studio.is_camera_moving = false;
    rows(&mut studio, args, ("16 lamps, a still camera", 1), by_cache, None)?;
    studio.is_camera_moving = true;
    rows(&mut studio, args, ("16 lamps, a moving camera", 1), by_cache, None)?;
    let mut turn_lamp = |studio: &mut Studio| {
        let mut lamp = studio.app.world_mut().get_mut::<Transform>(lamps[0]).ok_or("no lamp")?;
        lamp.rotate_around(Vec3::ZERO, Quat::from_rotation_y(0.01));
        Ok(())
    };
    rows(&mut studio, args, ("a lamp moves", 1), by_cache, Some(&mut turn_lamp))?;
    lamps.into_iter().for_each(|lamp| _ = studio.app.world_mut().despawn(lamp));

    let others = [1, 2, 3].map(|i| {
        let angle = std::f32::consts::FRAC_PI_2 * i as f32;
        let at = Transform::from_xyz(0.7 * angle.cos(), 0.0, 0.7 * angle.sin())
            .with_rotation(Quat::from_rotation_y(angle));
        studio.app.world_mut().spawn((VdbVolume(grid.clone()), material.clone(), at)).id()
    });
    rows(&mut studio, args, ("four clouds", 1), &presets, None)?;
    others.into_iter().for_each(|other| _ = studio.app.world_mut().despawn(other));

    let fire = fire(&mut studio)?;
    studio.app.world_mut().entity_mut(cloud).insert(fire);
    rows(&mut studio, args, ("fire in smoke", 2), &presets, None)?;

    studio.app.world_mut().entity_mut(cloud).insert(VdbEmissionLight::default());
    rows(&mut studio, args, ("fire that lights its smoke", 2), by_cache, None)?;
    studio.app.world_mut().entity_mut(cloud).remove::<(VdbEmissionLight, VdbEmission)>();

    // The default ramp is the fog itself: its extinction equals the value.
    studio.app.world_mut().entity_mut(cloud).insert(VdbRamp::default());
    rows(&mut studio, args, ("a ramp", 1), by_cache, None)?;
    studio.app.world_mut().entity_mut(cloud).insert(shells());
    rows(&mut studio, args, ("a ramp with shells", 1), by_cache, None)?;
    studio.app.world_mut().entity_mut(cloud).remove::<VdbRamp>();

    drop(grid);
    let mut ball = Running::new(&mut studio, cloud, PackKind::Fog, large_fog())?;
    rows(&mut studio, args, ("an edited ball", 1), &presets, Some(&mut |studio| ball.run(studio)))
}

/// The fog itself with two thin shells.
fn shells() -> VdbRamp {
    let at = |value, extinction| VdbRampStop { value, extinction, ..default() };
    VdbRamp::new([
        at(0.0, 0.0),
        at(0.295, 0.295),
        at(0.3, 3.0),
        at(0.305, 0.305),
        at(0.495, 0.495),
        at(0.5, 3.0),
        at(0.505, 0.505),
        at(1.0, 1.0),
    ])
}

/// The passes with a column of their own.
const COLUMNS: [&str; 4] =
    ["vdb_light_cache", "vdb_scattered_light", "vdb_lamp_light", "vdb_trace"];

/// Of the lamps, those that shine in all directions. Bevy measures passes for each face of their shadow maps,
/// and with more of them, there are no measurements left for those of volumes.
const BULBS: usize = 6;

/// Point and spot lights in two rings around the cloud, all of it in their reach.
fn lamps(studio: &mut Studio) -> [Entity; 16] {
    std::array::from_fn(|i| {
        let angle = std::f32::consts::FRAC_PI_4 * i as f32;
        let height = if i < 8 { -0.3 } else { 0.3 };
        let at = 0.6 * EDGE as f32 * Vec3::new(angle.cos(), height, angle.sin());
        let at = Transform::from_translation(at).looking_at(Vec3::ZERO, Vec3::Y);
        let (intensity, range) = (50_000.0, 3.0 * EDGE as f32);
        let mut lamp = studio.app.world_mut().spawn(at);
        if i < BULBS {
            lamp.insert(PointLight { intensity, range, shadow_maps_enabled: true, ..default() });
        } else {
            let outer_angle = std::f32::consts::FRAC_PI_3;
            let lit = SpotLight { intensity, range, outer_angle, ..default() };
            lamp.insert(SpotLight { shadow_maps_enabled: true, ..lit });
        }
        lamp.id()
    })
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

/// The change to a scene before each frame; `None` if only the camera moves.
type Act<'a> = Option<&'a mut dyn FnMut(&mut Studio) -> Result<(), String>>;

/// Scenes in which media overlap. `EXACT` approximates these by slabs, so their reference is the cache with finer
/// samples.
const OVERLAPPING: [&str; 3] = ["four clouds", "fire in smoke", "fire that lights its smoke"];
/// The reference for them: about the smallest error at which four overlapping copies of
/// `cloud_512` fit into the cache.
const FINER: VdbQuality = VdbQuality { fog_light_error: 0.004, ..VdbQuality::EXACT };

/// A scene's rows of the table, one for each of the settings. Only scenes that do not change have an error.
fn rows(
    studio: &mut Studio,
    args: &Args,
    (scene, grids): (&str, u64),
    settings: &[(&str, VdbQuality)],
    mut act: Act,
) -> Result<(), String> {
    if args.scene.as_ref().is_some_and(|only| only != scene) {
        return Ok(());
    }
    // A quarter of the resolution: under many lights, a picture of `EXACT` takes seconds.
    let size = (args.size / 4).max(UVec2::splat(32)) / 32 * 32;
    let mut exact = None;
    if act.is_none() {
        let is_overlapping = OVERLAPPING.contains(&scene);
        studio.camera_mut().insert(if is_overlapping { FINER } else { VdbQuality::EXACT });
        exact = Some(studio.radiance(size, grids)?);
    }
    for (name, quality) in settings {
        studio.camera_mut().insert(*quality);
        let error = match &exact {
            Some(exact) => Some(error(&studio.radiance(size, grids)?, exact)),
            None => None,
        };
        studio.settle(grids)?;
        row(studio, args, (scene, name, error), &mut act)?;
    }
    Ok(())
}

/// The root mean square difference relative to the mean radiance, over all pixels but those that are black in both
/// images.
fn error(found: &[Vec3], exact: &[Vec3]) -> f64 {
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for (a, b) in found.iter().zip(exact).filter(|(a, b)| **a != Vec3::ZERO || **b != Vec3::ZERO) {
        sum += f64::from(b.element_sum());
        squares += f64::from(a.distance_squared(*b));
        count += 3.0;
    }
    f64::sqrt(squares * count) / f64::max(sum, f64::MIN_POSITIVE)
}

fn row(
    studio: &mut Studio,
    args: &Args,
    (scene, settings, error): (&str, &str, Option<f64>),
    act: &mut Act,
) -> Result<(), String> {
    let mut times: [Vec<f64>; COLUMNS.len()] = default();
    let mut all = Vec::new();
    // A pass that no longer runs has no time.
    let mut store = studio.app.world_mut().resource_mut::<DiagnosticsStore>();
    store.iter_mut().for_each(Diagnostic::clear_history);
    let mut done = Ok(());
    studio.begin_round(args.frames);
    studio.frames_after(args.frames, |studio| {
        if let Some(act) = act
            && done.is_ok()
        {
            done = act(studio);
        }
        let world = studio.app.world();
        let store = world.resource::<DiagnosticsStore>();
        let of = |pass| VdbDiagnostics::pass_ms(store, pass);
        for (times, pass) in times.iter_mut().zip(COLUMNS) {
            times.extend(of(pass));
        }
        let report = camera_report(world);
        let ms: f64 = report.passes.iter().filter_map(|pass| of(pass.name)).sum();
        all.extend((ms > 0.0).then_some(ms));
    });
    done?;
    let report = camera_report(studio.app.world());
    let buffers = report.buffers.iter().filter(|buffer| {
        let all = ["vdb_light_", "vdb_lamp_", "vdb_scattered_"];
        all.iter().any(|prefix| buffer.name.starts_with(prefix))
    });
    let bytes: u64 = buffers.map(|buffer| buffer.bytes).sum();
    let median = |mut times: Vec<f64>| {
        if times.is_empty() { "–".to_owned() } else { format!("{:.3}", summary(&mut times)[0]) }
    };
    println!(
        "| {scene} | {settings} | {} | {} | {:.1} | {} |",
        times.map(median).join(" | "),
        median(all),
        bytes as f64 / f64::from(1 << 20),
        error.map_or_else(|| "–".to_owned(), |error| format!("{:.2}", 100.0 * error))
    );
    Ok(())
}

/// The report of the camera; empty if it sees no volume.
fn camera_report(world: &World) -> VdbCameraReport {
    let cameras = world.resource::<VdbDiagnostics>().cameras();
    cameras.into_iter().next().map(|(_, report)| report).unwrap_or_default()
}
