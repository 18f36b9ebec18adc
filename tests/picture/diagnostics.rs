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

const PIXELS: u64 = (SIZE.x * SIZE.y) as u64;
/// The passes and the buffers of a view that needs no others.
const LEAST_PASSES: &str = "vdb_trace, vdb_composite";
const LEAST_BUFFERS: &str = "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_tiles";

/// A camera before a sphere of voxels, and whatever is put beside it.
struct Needs {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
    sphere: Entity,
}

impl Needs {
    fn camera(&mut self) -> EntityWorldMut<'_> {
        self.stage.world().entity_mut(self.camera)
    }

    /// Compares what there is with names of features, passes and buffers.
    fn check(
        &mut self,
        what: &str,
        features: &str,
        passes: &str,
        buffers: &str,
    ) -> VdbCameraReport {
        self.stage.picture(&self.target);
        let report = self.stage.report(self.camera).expect(what);
        assert!(!report.is_compiling, "{what}");
        assert_eq!(names(&report), [features, passes, buffers], "{what}");
        assert!(report.buffers.iter().all(|buffer| buffer.bytes > 0), "{what}");
        report
    }
}

fn bytes(name: &str, report: &VdbCameraReport) -> u64 {
    report.buffers.iter().find(|buffer| buffer.name == name).expect(name).bytes
}

fn mode(mode: VdbRenderMode) -> VdbCamera {
    VdbCamera { mode, ..default() }
}

/// Scene by scene: what is compiled, run and kept is what the scene asks for.
#[gpu_test]
fn there_is_what_a_scene_asks_for_and_nothing_else() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.picture(&target);
    assert_eq!(stage.report(camera), None, "of an empty frame");

    let sphere = stage.green_sphere(Transform::default());
    let mut needs = Needs { stage, target, camera, sphere };
    check_voxels(&mut needs);
    check_fog(&mut needs);
    check_materials(&mut needs);
    check_shadows(&mut needs);
    check_edges(&mut needs);
    check_motion(&mut needs);

    needs.stage.world().despawn(needs.sphere);
    needs.stage.picture(&needs.target);
    assert_eq!(needs.stage.report(camera), None, "everything is gone with what asked for it");
}

fn check_voxels(needs: &mut Needs) {
    let report =
        needs.check("voxels", "voxels, beam optimisation, light", LEAST_PASSES, LEAST_BUFFERS);
    // Four halves, and a float.
    assert_eq!(bytes("vdb_color", &report), 8 * PIXELS);
    assert_eq!(bytes("vdb_depth", &report), 4 * PIXELS);
    assert_eq!((report.volumes, report.rays), (1, SIZE));

    needs.camera().insert(mode(VdbRenderMode::Normals));
    needs.check("without light", "voxels, beam optimisation", LEAST_PASSES, LEAST_BUFFERS);
    needs.camera().insert(VdbCamera::default());
}

fn check_fog(needs: &mut Needs) {
    let grid = needs.stage.ball_of_fog(15.0, 5.0);
    let cloud = needs.stage.world().spawn((VdbVolume(grid), glow(GREEN))).id();
    let seen = "voxels, fog, multiple scattering, beam optimisation, light";
    needs.check("fog", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.camera().insert(VdbQuality { fog_step: 2.0, ..default() });
    let seen = "voxels, fog, sampled fog, multiple scattering, beam optimisation, light";
    needs.check("sampled fog", seen, LEAST_PASSES, LEAST_BUFFERS);
    let once = VdbCamera { multiple_scattering: false, ..default() };
    needs.camera().insert(once);
    let seen = "voxels, fog, sampled fog, beam optimisation, light";
    needs.check("light scattered once", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.camera().insert((VdbCamera::default(), VdbQuality::default()));
    let red = VdbVectorGrid::new("Cd", Tree::new([1.0, 0.0, 0.0]), DAffine3::IDENTITY).unwrap();
    let red = needs.stage.world().resource_mut::<Assets<VdbVectorGrid>>().add(red);
    needs.stage.world().entity_mut(cloud).insert(VdbColorGrid(red));
    let seen = "voxels, fog, multiple scattering, beam optimisation, light, colours in fog";
    needs.check("a fog of colours", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.camera().insert(mode(VdbRenderMode::Normals));
    needs.check("colours without light", "voxels, beam optimisation", LEAST_PASSES, LEAST_BUFFERS);
    needs.camera().insert(VdbCamera::default());
    needs.stage.world().entity_mut(cloud).remove::<VdbColorGrid>().insert(VdbRamp::default());
    let seen = "voxels, fog, multiple scattering, beam optimisation, light, ramps";
    let with_ramps = "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_ramps, vdb_tiles";
    needs.check("a ramp", seen, LEAST_PASSES, with_ramps);
    needs.camera().insert(mode(VdbRenderMode::Normals));
    needs.check(
        "a ramp that is not seen",
        "voxels, beam optimisation",
        LEAST_PASSES,
        LEAST_BUFFERS,
    );
    needs.camera().insert(VdbCamera::default());
    needs.stage.world().entity_mut(cloud).remove::<VdbRamp>();
    let plane = needs.stage.world().spawn(VdbClipPlane).id();
    needs.stage.world().entity_mut(cloud).insert(VdbClippedBy(vec![plane]));
    let seen = "voxels, fog, multiple scattering, beam optimisation, light, clip planes";
    needs.check("a clip plane", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.stage.world().despawn(plane);
    let seen = "voxels, fog, multiple scattering, beam optimisation, light";
    needs.check("a clip plane that is gone", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.stage.world().entity_mut(cloud).remove::<VdbClippedBy>();
    needs.check("no clip plane any more", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.stage.world().despawn(cloud);
}

/// Functions of materials, in fog and on surfaces.
fn check_materials(needs: &mut Needs) {
    let grid = needs.stage.ball_of_fog(15.0, 5.0);
    let cloud = needs.stage.world().spawn((VdbVolume(grid), glow(GREEN))).id();
    let seen = "voxels, fog, multiple scattering, beam optimisation, light";
    let with_table = "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_materials, vdb_tiles";
    needs.stage.world().entity_mut(cloud).insert(Thinned::default());
    let in_fog = format!("{seen}, custom materials in fog");
    needs.check("a fog with a function", &in_fog, LEAST_PASSES, with_table);
    needs.stage.world().entity_mut(needs.sphere).insert(Unchanged {});
    let all = format!("{seen}, custom materials, custom materials in fog");
    needs.check("functions of both", &all, LEAST_PASSES, with_table);
    needs.stage.world().entity_mut(cloud).remove::<Thinned>();
    let on_surfaces = format!("{seen}, custom materials");
    needs.check("a surface with a function", &on_surfaces, LEAST_PASSES, with_table);
    needs.camera().insert(mode(VdbRenderMode::Normals));
    needs.check(
        "a function without light",
        "voxels, beam optimisation",
        LEAST_PASSES,
        LEAST_BUFFERS,
    );
    needs.camera().insert(VdbCamera::default());
    // One for surfaces is none for a fog.
    needs.stage.world().entity_mut(needs.sphere).remove::<Unchanged>();
    needs.stage.world().entity_mut(cloud).insert(Unchanged {});
    needs.check("no function any more", seen, LEAST_PASSES, LEAST_BUFFERS);
    needs.stage.world().entity_mut(cloud).remove::<Unchanged>();
    needs.stage.world().despawn(cloud);
    needs.check("no fog any more", "voxels, beam optimisation, light", LEAST_PASSES, LEAST_BUFFERS);
}

fn check_shadows(needs: &mut Needs) {
    needs.stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
    let sun = DirectionalLight { shadow_maps_enabled: true, ..default() };
    let sun = needs.stage.world().spawn(sun).id();
    let seen = "voxels, beam optimisation, light, shadows";
    needs.check("shadows", seen, LEAST_PASSES, LEAST_BUFFERS);
    let wall = needs.stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(4.0, 4.0, 0.1));
    let white = StandardMaterial::default();
    let white = needs.stage.world().resource_mut::<Assets<StandardMaterial>>().add(white);
    let wall = (Mesh3d(wall), MeshMaterial3d(white), Transform::from_xyz(0.0, 0.0, -3.0));
    let wall = needs.stage.world().spawn(wall).id();
    needs.check("shadows on a mesh", seen, "vdb_cast, vdb_trace, vdb_composite", LEAST_BUFFERS);
    // Behind the camera, between the sun and the wall.
    let grid = needs.stage.ball_of_fog(15.0, 5.0);
    let behind = Transform::from_xyz(0.0, 0.0, 12.0);
    let cloud = needs.stage.world().spawn((VdbVolume(grid), glow(GREEN), behind)).id();
    let grainy = "vdb_view, vdb_placement, vdb_opacity, vdb_expected_light, vdb_grain, \
                  vdb_smoothed_meshes, vdb_color, vdb_depth, vdb_scattered_light, vdb_tiles";
    let passes = "vdb_cast, vdb_fog_shadows, vdb_trace, vdb_composite";
    let shaded =
        "voxels, fog, multiple scattering, beam optimisation, light, shadows, scattered light";
    let report = needs.check("fog's shadow on a mesh", shaded, passes, grainy);
    let grain = ["vdb_expected_light", "vdb_grain", "vdb_smoothed_meshes"];
    assert_eq!(grain.map(|name| bytes(name, &report)), [4, 8, 8].map(|texel| texel * PIXELS));
    // Nine layers of rays of eight bytes, at least 64×64.
    let opacity = bytes("vdb_opacity", &report);
    assert!(opacity >= 9 * 8 * 64 * 64 && opacity.is_multiple_of(9 * 8 * 64), "{opacity}");
    needs.stage.world().despawn(cloud);
    needs.stage.world().despawn(wall);
    needs.stage.world().despawn(sun);
}

fn check_edges(needs: &mut Needs) {
    let smooth = VdbQuality { edge_samples: 4, ..default() };
    needs.camera().insert(smooth);
    let report = needs.check(
        "rays on edges",
        "voxels, beam optimisation, light, rays on edges",
        "vdb_trace, vdb_edges, vdb_refine, vdb_composite",
        "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_tiles, vdb_edge_pixels",
    );
    assert_eq!(bytes("vdb_edge_pixels", &report), 16 + 12 * PIXELS);
    needs.camera().insert(mode(VdbRenderMode::Normals));
    needs.check("edges without light", "voxels, beam optimisation", LEAST_PASSES, LEAST_BUFFERS);
    needs.camera().insert(VdbCamera::default());
}

fn check_motion(needs: &mut Needs) {
    let half = VdbQuality { resolution: 0.5, ..default() };
    needs.camera().insert((half, DepthPrepass, MotionVectorPrepass));
    let report = needs.check(
        "motion, and fewer rays",
        "voxels, beam optimisation, light, motion vectors, fewer rays than pixels",
        "vdb_trace, vdb_upscale, vdb_composite",
        "vdb_view, vdb_placement, vdb_color, vdb_depth, vdb_tiles, vdb_moving, vdb_motion, \
         vdb_color_upscaled, vdb_depth_upscaled, vdb_moving_upscaled",
    );
    assert_eq!(bytes("vdb_color", &report), 2 * PIXELS, "a ray for four pixels");
    assert_eq!(bytes("vdb_color_upscaled", &report), 8 * PIXELS);
    let mut whirl: Vdb543<[f32; 3]> = Tree::new([0.0; 3]);
    whirl.set(IVec3::ZERO, [1.0, 0.0, 0.0]);
    let whirl = VdbVectorGrid::new("velocity", whirl, DAffine3::IDENTITY).unwrap();
    let grid = needs.stage.world().resource_mut::<Assets<VdbVectorGrid>>().add(whirl);
    let velocity = VdbVelocity { grid, scale: 1.0, time_step: 0.1 };
    needs.camera().insert(VdbQuality::default());
    needs.stage.world().entity_mut(needs.sphere).insert(velocity);
    let seen = "voxels, beam optimisation, light, motion vectors, velocities in motion vectors";
    let moving =
        format!("{LEAST_BUFFERS}, vdb_moving, vdb_motion, vdb_velocities, vdb_velocity_means");
    needs.check("velocities", seen, LEAST_PASSES, &moving);
    needs.camera().remove::<(DepthPrepass, MotionVectorPrepass)>();
    needs.check(
        "no motion vectors",
        "voxels, beam optimisation, light",
        LEAST_PASSES,
        LEAST_BUFFERS,
    );
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
