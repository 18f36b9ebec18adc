//! What a scene has on the GPU, and what it has not; and the dial, turned by the time that frames take there.

use bevy::core_pipeline::prepass::{DepthPrepass, MotionVectorPrepass};
use bevy::diagnostic::{
    Diagnostic, DiagnosticMeasurement, DiagnosticPath, DiagnosticsStore, RegisterDiagnostic,
};
use bevy::input::ButtonState;
use bevy::input::keyboard::{Key, KeyboardInput};
use bevy::light::DirectionalLightShadowMap;
use bevy::math::{DAffine3, DVec3};
use bevy::platform::time::Instant;
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbCameraReport, VdbClipPlane, VdbClippedBy, VdbColorGrid, VdbDiagnostics, VdbDial,
    VdbGrid, VdbQuality, VdbRamp, VdbRenderMode, VdbVectorGrid, VdbVelocity, VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::level_set;
use vdb_core::tree::{IVec3, Tree, Vdb543};

use super::common::Stage;
use super::materials::{Thinned, Unchanged, add_materials};
use super::{GREEN, SIZE, glow, looking};

#[path = "../../examples/quality_dial.rs"]
#[expect(dead_code, reason = "its window is not opened")]
mod quality_dial;

impl Stage {
    pub fn report(&mut self, camera: Entity) -> Option<VdbCameraReport> {
        self.world().resource::<VdbDiagnostics>().camera(camera)
    }
}

/// The names of what there is, in a line.
fn names(report: &VdbCameraReport) -> [String; 3] {
    let list = |names: Vec<&str>| names.join(", ");
    [
        list(report.features.iter().map(|feature| feature.name).collect()),
        list(report.passes.iter().map(|pass| pass.name).collect()),
        list(report.buffers.iter().map(|buffer| buffer.name).collect()),
    ]
}

/// Scene by scene: what is compiled, run and kept is what the scene asks for.
#[gpu_test]
fn there_is_what_a_scene_asks_for_and_nothing_else() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.picture(&target);
    assert_eq!(stage.report(camera), None, "of an empty frame");

    let both = "vdb_trace, vdb_composite";
    let plain = "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_tiles";
    let check = |stage: &mut Stage, what: &str, features: &str, passes: &str, buffers: &str| {
        stage.picture(&target);
        let report = stage.report(camera).expect(what);
        assert!(!report.is_compiling, "{what}");
        assert_eq!(names(&report), [features, passes, buffers], "{what}");
        assert!(report.buffers.iter().all(|buffer| buffer.bytes > 0), "{what}");
        report
    };
    let sphere = stage.green_sphere(Transform::default());
    let report = check(&mut stage, "voxels", "voxels, beam optimisation, light", both, plain);
    let pixels = u64::from(SIZE.x * SIZE.y);
    let bytes = |name: &str, report: &VdbCameraReport| {
        report.buffers.iter().find(|buffer| buffer.name == name).unwrap().bytes
    };
    // Four halves, and a float.
    assert_eq!(bytes("vdb_color", &report), 8 * pixels);
    assert_eq!(bytes("vdb_depth", &report), 4 * pixels);
    assert_eq!((report.volumes, report.rays), (1, SIZE));

    let mode = |mode| VdbCamera { mode, ..default() };
    stage.world().entity_mut(camera).insert(mode(VdbRenderMode::Normals));
    check(&mut stage, "without light", "voxels, beam optimisation", both, plain);
    stage.world().entity_mut(camera).insert(VdbCamera::default());

    let grid = stage.ball_of_fog(15.0, 5.0);
    let cloud = stage.world().spawn((VdbVolume(grid), glow(GREEN))).id();
    let seen = "voxels, fog, multiple scattering, beam optimisation, light";
    check(&mut stage, "fog", seen, both, plain);
    stage.world().entity_mut(camera).insert(VdbQuality { fog_step: 2.0, ..default() });
    let seen = "voxels, fog, sampled fog, multiple scattering, beam optimisation, light";
    check(&mut stage, "sampled fog", seen, both, plain);
    let once = VdbCamera { multiple_scattering: false, ..default() };
    stage.world().entity_mut(camera).insert(once);
    let seen = "voxels, fog, sampled fog, beam optimisation, light";
    check(&mut stage, "light scattered once", seen, both, plain);
    stage.world().entity_mut(camera).insert((VdbCamera::default(), VdbQuality::default()));
    let red = VdbVectorGrid::new("Cd", Tree::new([1.0, 0.0, 0.0]), DAffine3::IDENTITY).unwrap();
    let red = stage.world().resource_mut::<Assets<VdbVectorGrid>>().add(red);
    stage.world().entity_mut(cloud).insert(VdbColorGrid(red));
    let seen = "voxels, fog, multiple scattering, beam optimisation, light, colours in fog";
    check(&mut stage, "a fog of colours", seen, both, plain);
    stage.world().entity_mut(camera).insert(mode(VdbRenderMode::Normals));
    check(&mut stage, "colours without light", "voxels, beam optimisation", both, plain);
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    stage.world().entity_mut(cloud).remove::<VdbColorGrid>().insert(VdbRamp::default());
    let seen = "voxels, fog, multiple scattering, beam optimisation, light, ramps";
    let with_ramps = "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_ramps, vdb_tiles";
    check(&mut stage, "a ramp", seen, both, with_ramps);
    stage.world().entity_mut(camera).insert(mode(VdbRenderMode::Normals));
    check(&mut stage, "a ramp that is not seen", "voxels, beam optimisation", both, plain);
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    stage.world().entity_mut(cloud).remove::<VdbRamp>();
    let plane = stage.world().spawn(VdbClipPlane).id();
    stage.world().entity_mut(cloud).insert(VdbClippedBy(vec![plane]));
    let seen = "voxels, fog, multiple scattering, beam optimisation, light, clip planes";
    check(&mut stage, "a clip plane", seen, both, plain);
    stage.world().despawn(plane);
    let seen = "voxels, fog, multiple scattering, beam optimisation, light";
    check(&mut stage, "a clip plane that is gone", seen, both, plain);
    stage.world().entity_mut(cloud).remove::<VdbClippedBy>();
    let seen = "voxels, fog, multiple scattering, beam optimisation, light";
    check(&mut stage, "no ramp any more", seen, both, plain);
    let with_table = "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_materials, vdb_tiles";
    stage.world().entity_mut(cloud).insert(Thinned::default());
    let in_fog = format!("{seen}, custom materials in fog");
    check(&mut stage, "a fog with a function", &in_fog, both, with_table);
    stage.world().entity_mut(sphere).insert(Unchanged {});
    let all = format!("{seen}, custom materials, custom materials in fog");
    check(&mut stage, "functions of both", &all, both, with_table);
    stage.world().entity_mut(cloud).remove::<Thinned>();
    let on_surfaces = format!("{seen}, custom materials");
    check(&mut stage, "a surface with a function", &on_surfaces, both, with_table);
    stage.world().entity_mut(camera).insert(mode(VdbRenderMode::Normals));
    check(&mut stage, "a function without light", "voxels, beam optimisation", both, plain);
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    // One for surfaces is none for a fog.
    stage.world().entity_mut(sphere).remove::<Unchanged>();
    stage.world().entity_mut(cloud).insert(Unchanged {});
    check(&mut stage, "no function any more", seen, both, plain);
    stage.world().entity_mut(cloud).remove::<Unchanged>();
    stage.world().despawn(cloud);
    check(&mut stage, "no fog any more", "voxels, beam optimisation, light", both, plain);

    stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
    let sun = DirectionalLight { shadow_maps_enabled: true, ..default() };
    let sun = stage.world().spawn(sun).id();
    let seen = "voxels, beam optimisation, light, shadows";
    check(&mut stage, "shadows", seen, both, plain);
    let wall = stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(4.0, 4.0, 0.1));
    let white = StandardMaterial::default();
    let white = stage.world().resource_mut::<Assets<StandardMaterial>>().add(white);
    let wall = (Mesh3d(wall), MeshMaterial3d(white), Transform::from_xyz(0.0, 0.0, -3.0));
    let wall = stage.world().spawn(wall).id();
    check(&mut stage, "shadows on a mesh", seen, "vdb_cast, vdb_trace, vdb_composite", plain);
    // Behind the camera, between the sun and the wall.
    let grid = stage.ball_of_fog(15.0, 5.0);
    let behind = Transform::from_xyz(0.0, 0.0, 12.0);
    let cloud = stage.world().spawn((VdbVolume(grid), glow(GREEN), behind)).id();
    let grainy = "vdb_view, vdb_placement, vdb_opacity, vdb_expected_light, vdb_grain, \
                  vdb_smoothed_meshes, vdb_color, vdb_depth, vdb_scattered_light, vdb_tiles";
    let passes = "vdb_cast, vdb_fog_shadows, vdb_trace, vdb_composite";
    let shaded =
        "voxels, fog, multiple scattering, beam optimisation, light, shadows, scattered light";
    let report = check(&mut stage, "fog's shadow on a mesh", shaded, passes, grainy);
    let grain = ["vdb_expected_light", "vdb_grain", "vdb_smoothed_meshes"];
    assert_eq!(grain.map(|name| bytes(name, &report)), [4, 8, 8].map(|texel| texel * pixels));
    // Nine layers of rays of eight bytes, at least 64×64.
    let opacity = bytes("vdb_opacity", &report);
    assert!(opacity >= 9 * 8 * 64 * 64 && opacity % (9 * 8 * 64) == 0, "{opacity}");
    stage.world().despawn(cloud);
    stage.world().despawn(wall);
    stage.world().despawn(sun);
    let smooth = VdbQuality { edge_samples: 4, ..default() };
    stage.world().entity_mut(camera).insert(smooth);
    let report = check(
        &mut stage,
        "rays on edges",
        "voxels, beam optimisation, light, rays on edges",
        "vdb_trace, vdb_edges, vdb_refine, vdb_composite",
        "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_tiles, vdb_edge_pixels",
    );
    assert_eq!(bytes("vdb_edge_pixels", &report), 16 + 12 * pixels);
    stage.world().entity_mut(camera).insert(mode(VdbRenderMode::Normals));
    check(&mut stage, "edges without light", "voxels, beam optimisation", both, plain);
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    let half = VdbQuality { resolution: 0.5, ..default() };
    stage.world().entity_mut(camera).insert((half, DepthPrepass, MotionVectorPrepass));
    let report = check(
        &mut stage,
        "motion, and fewer rays",
        "voxels, beam optimisation, light, motion vectors, fewer rays than pixels",
        "vdb_trace, vdb_upscale, vdb_composite",
        "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_tiles, vdb_moving, vdb_motion, \
         vdb_color_upscaled, vdb_depth_upscaled, vdb_moving_upscaled",
    );
    assert_eq!(bytes("vdb_color", &report), 2 * pixels, "a ray for four pixels");
    assert_eq!(bytes("vdb_color_upscaled", &report), 8 * pixels);
    let mut whirl: Vdb543<[f32; 3]> = Tree::new([0.0; 3]);
    whirl.set(IVec3::ZERO, [1.0, 0.0, 0.0]);
    let whirl = VdbVectorGrid::new("velocity", whirl, DAffine3::IDENTITY).unwrap();
    let grid = stage.world().resource_mut::<Assets<VdbVectorGrid>>().add(whirl);
    let velocity = VdbVelocity { grid, scale: 1.0, time_step: 0.1 };
    stage.world().entity_mut(camera).insert(VdbQuality::default());
    stage.world().entity_mut(sphere).insert(velocity);
    let seen = "voxels, beam optimisation, light, motion vectors, velocities in motion vectors";
    let moving = format!("{plain}, vdb_moving, vdb_motion, vdb_velocities, vdb_velocity_means");
    check(&mut stage, "velocities", seen, both, &moving);
    stage.world().entity_mut(camera).remove::<(DepthPrepass, MotionVectorPrepass)>();
    check(&mut stage, "no motion vectors", "voxels, beam optimisation, light", both, plain);

    stage.world().despawn(sphere);
    stage.picture(&target);
    assert_eq!(stage.report(camera), None, "everything is gone with what asked for it");
}

/// Frames after which the time of a frame arrives.
const LATE: usize = 5;

/// The GPU time of a frame in milliseconds, as a known function of its settings. Times of a real GPU depend on what
/// else runs on it.
fn takes(quality: &VdbQuality) -> f64 {
    f64::from(8.0 * quality.resolution * quality.resolution / quality.fog_light_step)
}

/// Without need the dial holds the most exact settings, for a third of their time it gives some up, and given that
/// time again, it takes them back.
#[gpu_test]
fn the_dial_is_turned_by_what_the_gpu_takes() {
    let path = DiagnosticPath::new("render/vdb_trace/elapsed_gpu");
    let mut stage = Stage::with(|app| {
        app.register_diagnostic(Diagnostic::new(path.clone()));
    });
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    let grid = stage.ball_of_fog(20.0, 10.0);
    stage.world().spawn((VdbVolume(grid), glow(GREEN)));
    let own = VdbQuality { shadow_range: 7.0, ..VdbQuality::HIGH };
    stage.world().entity_mut(camera).insert(own);
    stage.picture(&target);
    // The settings that it holds for 60 frames.
    let mut settled = |frame_ms: f32| {
        stage.world().entity_mut(camera).insert(VdbDial::Budget { frame_ms });
        let mut frames = vec![*stage.world().get::<VdbQuality>(camera).unwrap()];
        let mut since = 0;
        while frames.len() - since <= 60 {
            if let Some(drawn) = frames.len().checked_sub(LATE) {
                let measurement =
                    DiagnosticMeasurement { time: Instant::now(), value: takes(&frames[drawn]) };
                let mut store = stage.world().resource_mut::<DiagnosticsStore>();
                store.get_mut(&path).unwrap().add_measurement(measurement);
            }
            stage.update(1);
            let now = *stage.world().get::<VdbQuality>(camera).unwrap();
            if frames.last() != Some(&now) {
                since = frames.len();
            }
            frames.push(now);
            assert!(frames.len() < 1000, "at {frame_ms} ms the dial does not settle: {now:?}");
        }
        frames[since]
    };
    let exact = settled(1e6);
    assert_eq!((exact.resolution, exact.fog_light_step), (1.0, VdbQuality::EXACT.fog_light_step));
    let third = takes(&exact) as f32 / 3.0;
    let coarse = settled(third);
    assert!(coarse.fog_light_step > exact.fog_light_step, "{coarse:?}");
    assert!(takes(&coarse) as f32 <= third, "{coarse:?}");
    let again = settled(1e6);
    assert_eq!(again, exact);
    assert_eq!(again.shadow_range, 7.0, "it is not the dial's");
}

/// An error in pixels: near by, fog is asked for more often than far away.
#[gpu_test]
fn the_dial_keeps_an_error_in_pixels() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, Transform::default());
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 10.0), PackKind::Smooth { iso: 0.0 }, 0.1);
    stage.world().spawn((VdbVolume(grid), glow(GREEN)));
    stage.world().entity_mut(camera).insert(VdbDial::MaxError { pixels: 1.0 });
    let [near, far] = [2.0, 40.0].map(|distance| {
        stage.world().entity_mut(camera).insert(looking(Vec3::Z * distance));
        stage.update(4);
        *stage.world().get::<VdbQuality>(camera).unwrap()
    });
    assert_eq!((near.resolution, far.resolution), (0.5, 0.5));
    assert_eq!(near.fog_step, 0.0, "a voxel is larger than a pixel");
    // The nearest voxel is 39 away, and a pixel there shows 2·tan(22.5°)·39 / 64.
    let voxels = 2.0 * 22.5_f32.to_radians().tan() * 39.0 / 64.0 / 0.1;
    assert!((far.fog_step / voxels - 1.0).abs() < 0.05, "{} of {voxels}", far.fog_step);
}

#[gpu_test]
#[ignore = "slow: pipelines of every preset"]
fn the_example_shows_its_cloud_at_every_preset() {
    let mut stage = Stage::new();
    quality_dial::scene(&mut stage.app);
    let size = UVec2::new(128, 96);
    let target = stage.target(size);
    stage.update(1);
    let mut cameras = stage.world().query_filtered::<Entity, With<Camera3d>>();
    let camera = cameras.single(stage.world()).unwrap();
    let to = bevy::camera::RenderTarget::Image(target.clone().into());
    stage.world().entity_mut(camera).insert((to, Msaa::Off));
    let start = std::time::Instant::now();
    while stage.world().resource::<Assets<VdbGrid>>().len() < 2 {
        assert!(start.elapsed() < std::time::Duration::from_secs(60), "the models do not come");
        stage.update(1);
    }
    let digits = [KeyCode::Digit1, KeyCode::Digit2, KeyCode::Digit3, KeyCode::Digit4];
    for (key, (name, preset)) in digits.into_iter().zip(VdbQuality::PRESETS) {
        stage.world().write_message(KeyboardInput {
            key_code: key,
            logical_key: Key::Character(name.into()),
            state: ButtonState::Pressed,
            text: None,
            repeat: false,
            window: Entity::PLACEHOLDER,
        });
        stage.update(1);
        assert_eq!(*stage.world().get::<VdbQuality>(camera).unwrap(), preset);
        let picture = stage.picture(&target);
        picture.save(&format!("quality_dial_{name}"));
        // The teapot is in the lower half.
        let upper = &picture.pixels[..picture.pixels.len() / 2];
        let cloud = upper.iter().filter(|p| p.x > 0.1 && p.z > 0.1).count();
        assert!(cloud > 400, "{name}: {cloud} pixels of the cloud");
        let report = stage.report(camera).unwrap();
        assert!(report.has("fog") && report.has("shadows"), "{name}: {report:?}");
    }
}
