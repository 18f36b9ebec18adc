//! Volumes in volumes.

use bevy::light::EnvironmentMapLight;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbClipPlane, VdbClippedBy, VdbGrid, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::Stage;
use super::{GREEN, SIZE, SURFACE, glow, is_green, is_red, looking, pixel_ray};

pub fn mirror() -> VdbMaterial {
    VdbMaterial { metallic: 1.0, perceptual_roughness: 0.0, ..default() }
}

/// A plate of 12 by 12 world units, whose upper side is at y = -0.05.
pub fn floor(stage: &mut Stage) -> Handle<VdbGrid> {
    let floor = CoordBox { min: IVec3::new(-60, -10, -60), max: IVec3::new(59, -1, 59) };
    stage.grid(fog::block(floor, -1.0), SURFACE, 0.1)
}

/// A metal plane shows a box above it where the mirrored ray meets the box, and black elsewhere; also what clip planes
/// leave of the box.
#[gpu_test]
fn a_mirror_shows_what_is_before_it() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 4.0, 8.0));
    let camera = stage.camera(&target, view);
    let floor = floor(&mut stage);
    stage.world().spawn((VdbVolume(floor), mirror()));
    // Out of sight of the camera for the most part: its mirror image is what is looked for.
    let above = CoordBox { min: IVec3::new(-10, 10, -10), max: IVec3::new(9, 29, 9) };
    let block = stage.grid(fog::block(above, -1.0), SURFACE, 0.1);
    let block = stage.world().spawn((VdbVolume(block), glow(GREEN))).id();
    let (low, high) = (DVec3::new(-1.05, 0.95, -1.05), DVec3::new(0.95, 2.95, 0.95));
    check_mirror(&mut stage, &target, (camera, view), low, high);

    let planes = [(DVec3::NEG_X, -0.43), (DVec3::NEG_Y, 1.62)].map(|(normal, at)| {
        let turn = Quat::from_rotation_arc(Vec3::Y, normal.as_vec3());
        let plane = Transform::from_translation((at * normal.abs()).as_vec3()).with_rotation(turn);
        stage.world().spawn((VdbClipPlane, plane)).id()
    });
    stage.world().entity_mut(block).insert(VdbClippedBy(planes.to_vec()));
    let cut = DVec3::new(-0.43, 1.62, low.z);
    check_mirror(&mut stage, &target, (camera, view), cut, high);
}

/// Checks the mirror image of a box that reaches from `low` to `high`.
fn check_mirror(
    stage: &mut Stage,
    target: &Handle<Image>,
    (camera, view): (Entity, Transform),
    low: DVec3,
    high: DVec3,
) {
    let mut show = |reflections: u32| {
        let settings = VdbQuality { reflections, ..default() };
        stage.world().entity_mut(camera).insert(settings);
        let picture = stage.picture(target);
        picture.save(&format!("mirror_{reflections}_{}", low.y));
        picture
    };
    let none = show(0);
    let once = show(1);
    let top = -0.05;
    let enters = |from: DVec3, dir: DVec3, by: f64| {
        let (a, b) = ((low - by - from) / dir, (high + by - from) / dir);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        near <= far && far > 0.0
    };
    let (mut met, mut missed, mut wrong) = (0, 0, 0);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let at = origin + dir * ((top - origin.y) / dir.y);
            if dir.y >= 0.0 || at.x.abs().max(at.z.abs()) > 5.9 || enters(origin, dir, 0.01) {
                continue;
            }
            assert!(!is_green(none.at(x, y)), "without reflections, {x} {y} is green");
            let mirrored = dir * DVec3::new(1.0, -1.0, 1.0);
            let (inner, outer) = (enters(at, mirrored, -1e-3), enters(at, mirrored, 1e-3));
            if inner == outer {
                if outer {
                    met += 1
                } else {
                    missed += 1
                }
                wrong += usize::from(is_green(once.at(x, y)) != outer);
            }
        }
    }
    println!("{met} pixels show the box, {missed} do not, {wrong} are wrong");
    assert!(met > 100 && missed > 500, "{met} and {missed} pixels");
    assert_eq!(wrong, 0);
}

/// Between two mirrors that face each other, a light is seen as often as rays go on.
#[gpu_test]
fn rays_go_on_as_often_as_they_are_told() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    // Looks along the gap between two walls, x = ±1, at one of them; the ray goes to and fro and leaves
    // the gap after some mirrors, to a wall that glows.
    let from = Transform::from_xyz(0.0, 0.0, 4.0).looking_to(Vec3::new(1.0, 0.0, -1.0), Vec3::Y);
    let camera = stage.camera(&target, from);
    let wall = CoordBox { min: IVec3::new(0, -30, -20), max: IVec3::new(3, 29, 39) };
    let grid = stage.grid(fog::block(wall, -1.0), SURFACE, 0.1);
    let right = Transform::from_xyz(1.05, 0.0, 0.0);
    stage.world().spawn((VdbVolume(grid.clone()), mirror(), right));
    stage.world().spawn((VdbVolume(grid), mirror(), Transform::from_xyz(-1.35, 0.0, 0.0)));
    let end = CoordBox { min: IVec3::new(-60, -30, -60), max: IVec3::new(59, 29, -50) };
    let end = stage.grid(fog::block(end, -1.0), SURFACE, 0.1);
    stage.world().spawn((VdbVolume(end), glow(GREEN)));
    // From (0, 4) towards (1, -1): it meets walls at z = 3, 1 and -1, and then leaves: 3 mirrors.
    for reflections in 0..=4 {
        let settings = VdbQuality { reflections, ..default() };
        stage.world().entity_mut(camera).insert(settings);
        let picture = stage.picture(&target);
        picture.save(&format!("mirrors_{reflections}"));
        assert_eq!(
            is_green(picture.center()),
            reflections >= 3,
            "{reflections}: {}",
            picture.center()
        );
    }
}

/// A mirror ball between two others, under a sky: looked at, and told apart left and right.
#[gpu_test]
fn a_mirror_ball_between_two_others_shows_both() {
    let mut stage = Stage::new();
    let size = SIZE * 2;
    let target = stage.target(size);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 0.5, 8.0)));
    let kind = PackKind::Smooth { iso: 0.0 };
    let ball = stage.grid(level_set::sphere(DVec3::ZERO, 30.0), kind, 0.04);
    for (x, material) in [(-2.7, glow(LinearRgba::RED)), (0.0, mirror()), (2.7, glow(GREEN))] {
        let at = Transform::from_xyz(x, 0.0, 0.0);
        stage.world().spawn((VdbVolume(ball.clone()), material, at));
    }
    let mut images = stage.world().resource_mut::<Assets<Image>>();
    let blue = Color::linear_rgb(0.1, 0.1, 0.4);
    let map =
        EnvironmentMapLight::hemispherical_gradient(&mut images, Color::WHITE, blue, Color::BLACK);
    stage.world().entity_mut(camera).insert((map, VdbQuality { reflections: 2, ..default() }));
    let picture = stage.picture(&target);
    picture.save("mirror_ball");
    let (middle, half) = (size / 2, size.x / 2);
    // The ball is 1.2 in radius: 23 pixels. Near its left edge it shows what is left of it.
    let row: Vec<Vec4> = (half - 23..half + 23).map(|x| picture.at(x, middle.y + 4)).collect();
    let red = row[..23].iter().filter(|p| is_red(**p)).count();
    let green = row[23..].iter().filter(|p| is_green(**p)).count();
    println!("{red} red pixels left, {green} green ones right");
    assert!(red > 3 && green > 3, "{red} red, {green} green");
    assert!(row[..23].iter().all(|p| !is_green(*p)) && row[23..].iter().all(|p| !is_red(*p)));
    let front = row[23];
    assert!(
        front.z > front.x.max(front.y),
        "in front, it shows the sky behind the camera: {front}"
    );
}
