//! Meshes in the reflections of volumes.

use bevy::camera::Hdr;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbQuality, VdbVolume};
use gpu_test::gpu_test;

use super::common::{Picture, Stage};
use super::reflections::{floor, mirror};
use super::{GREEN, SIZE, is_green, looking, pixel_ray};

const EYE: Vec3 = Vec3::new(1.0, 3.0, 8.0);
/// The box of the mesh in world space, above the mirror, whose upper side is at y = -0.05.
const LOW: DVec3 = DVec3::new(-1.0, 0.5, -1.5);
const HIGH: DVec3 = DVec3::new(1.0, 1.5, 0.5);
const FLOOR: f64 = -0.05;

/// A mirror, and a box that shines green above it.
fn scene(stage: &mut Stage) {
    let floor = floor(stage);
    stage.world().spawn((VdbVolume(floor), mirror()));
    let size = (HIGH - LOW).as_vec3();
    let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::from_size(size));
    let green = StandardMaterial {
        base_color: Color::BLACK,
        emissive: GREEN,
        reflectance: 0.0,
        ..default()
    };
    let green = stage.world().resource_mut::<Assets<StandardMaterial>>().add(green);
    let middle = Transform::from_translation((0.5 * (LOW + HIGH)).as_vec3());
    stage.world().spawn((Mesh3d(mesh), MeshMaterial3d(green), middle));
}

/// Where a ray enters the box, enlarged on all sides.
fn within_box(from: DVec3, dir: DVec3, larger: f64) -> Option<f64> {
    let (a, b) = ((LOW - larger - from) / dir, (HIGH + larger - from) / dir);
    let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
    (near <= far && far > 0.0).then_some(near)
}

/// The number of pixels in which the mirror has to show the box, and in which it must not; and how
/// many of each are wrong. Where the mirror shows what the camera does not see of the box, nothing
/// is expected.
fn judged(picture: &Picture) -> [usize; 4] {
    let view = looking(EYE);
    let mut counts = [0; 4];
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let at = origin + dir * ((FLOOR - origin.y) / dir.y);
            let is_floor = dir.y < 0.0 && at.x.abs().max(at.z.abs()) < 5.9;
            if !is_floor || within_box(origin, dir, 0.05).is_some() {
                continue;
            }
            let mirrored = dir * DVec3::new(1.0, -1.0, 1.0);
            let shows = is_green(picture.at(x, y));
            if within_box(at, mirrored, 0.1).is_none() {
                counts[1] += 1;
                counts[3] += usize::from(shows);
            } else if within_box(at, mirrored, -0.1).is_some()
                && let Some(t) = within_box(at, mirrored, 0.0)
            {
                let to_met = at + t * mirrored - origin;
                let is_seen = within_box(origin, to_met, 0.0).is_some_and(|t| t > 0.999);
                if is_seen {
                    counts[0] += 1;
                    counts[2] += usize::from(!shows);
                }
            }
        }
    }
    counts
}

/// A mirror shows a mesh where the camera sees the side that it reflects.
#[gpu_test]
fn a_mirror_shows_the_meshes_that_the_camera_sees() {
    let mut stage = Stage::new();
    for msaa in [Msaa::Off, Msaa::Sample4] {
        for edge_samples in [0, 4] {
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(EYE));
            scene(&mut stage);
            let quality = VdbQuality { reflections: 1, edge_samples, ..default() };
            stage.world().entity_mut(camera).insert((quality, msaa));
            let picture = stage.picture(&target);
            picture.save(&format!("mesh_reflections_{msaa:?}_{edge_samples}"));
            let [shown, not_shown, missing, wrong] = judged(&picture);
            println!(
                "{msaa:?}: {missing} of {shown} pixels are missing, {wrong} of {not_shown} wrong"
            );
            assert!(shown > 100 && not_shown > 500, "{shown} and {not_shown} pixels");
            assert!(missing * 100 <= shown && wrong * 1000 <= not_shown);
            let without = VdbQuality { mesh_reflections: false, ..quality };
            stage.world().entity_mut(camera).insert(without);
            let [shown, _, missing, wrong] = judged(&stage.picture(&target));
            assert_eq!((missing, wrong), (shown, 0), "without reflections of meshes");
        }
    }
}

/// Cameras that share a target each reflect what they see themselves.
#[gpu_test]
fn cameras_that_share_a_target_reflect_their_own_meshes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let quality = VdbQuality { reflections: 1, ..default() };
    let camera = stage.camera(&target, looking(EYE));
    scene(&mut stage);
    // It clears the target and draws before the other; its tonemapping swaps the textures.
    let before = stage.camera(&target, looking(-EYE));
    stage.world().entity_mut(before).insert((
        Camera { order: -1, ..default() },
        Tonemapping::Reinhard,
        quality,
    ));
    stage.world().entity_mut(camera).insert(quality);
    let [shown, not_shown, missing, wrong] = judged(&stage.picture(&target));
    assert!(shown > 100 && missing * 100 <= shown && wrong * 1000 <= not_shown);
}

/// The feature is compiled only for cameras that can use it.
#[gpu_test]
fn only_what_can_be_reflected_is_compiled() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(EYE));
    let quality = VdbQuality { reflections: 1, ..default() };
    stage.world().entity_mut(camera).insert(quality);
    let has = |stage: &mut Stage, what: &str, expected: bool| {
        stage.picture(&target);
        let report = stage.report(camera).expect(what);
        let is_there = report.features.iter().any(|row| row.name == "reflections of meshes");
        assert_eq!(is_there, expected, "{what}");
    };
    let floor = floor(&mut stage);
    let volume = stage.world().spawn(VdbVolume(floor)).id();
    has(&mut stage, "a volume alone", false);
    stage.world().despawn(volume);
    scene(&mut stage);
    has(&mut stage, "a volume and a mesh", true);
    stage.world().entity_mut(camera).insert(VdbQuality { reflections: 0, ..quality });
    has(&mut stage, "no reflections", false);
    stage.world().entity_mut(camera).insert(quality).remove::<Hdr>();
    has(&mut stage, "a target without tonemapping", true);
    stage.world().entity_mut(camera).insert(Tonemapping::Reinhard);
    has(&mut stage, "a target that holds no radiance", false);
}
