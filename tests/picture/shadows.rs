//! Shadows of volumes on volumes and of meshes on volumes, where closed forms say that they are.

use bevy::light::{NotShadowCaster, NotShadowReceiver, PointLightShadowMap};
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbQuality, VdbSun, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking, parallel, pixel_ray};

/// Voxels of a level set that fill boxes.
fn voxels(boxes: &[CoordBox]) -> Vdb543<f32> {
    let mut tree = Vdb543::new(1.0);
    for bbox in boxes {
        for x in bbox.min.x..=bbox.max.x {
            for y in bbox.min.y..=bbox.max.y {
                (bbox.min.z..=bbox.max.z).for_each(|z| tree.set(IVec3::new(x, y, z), -1.0));
            }
        }
    }
    tree
}

/// A box in the world.
#[derive(Clone, Copy)]
struct Block {
    min: DVec3,
    max: DVec3,
}

impl Block {
    /// Where a ray comes in, if it meets the box.
    fn enter(self, origin: DVec3, dir: DVec3) -> Option<f64> {
        let (a, b) = ((self.min - origin) / dir, (self.max - origin) / dir);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        (near <= far && far > 0.0).then_some(near.max(0.0))
    }

    fn grown(self, by: f64) -> Self {
        Self { min: self.min - by, max: self.max + by }
    }
}

const VOXEL: f64 = 0.1;
/// A plane, and a box above it; their faces.
const FLOOR: CoordBox = CoordBox { min: IVec3::new(-60, -10, -60), max: IVec3::new(59, -1, 59) };
const ABOVE: CoordBox = CoordBox { min: IVec3::new(-8, 10, -8), max: IVec3::new(7, 17, 7) };

/// Voxels are centred on their samples.
fn in_world(bbox: CoordBox, voxel: f64) -> Block {
    Block { min: (bbox.min.as_dvec3() - 0.5) * voxel, max: (bbox.max.as_dvec3() + 0.5) * voxel }
}

/// A camera on which the top of the floor is black where light does not come to.
fn stage(from: Vec3) -> (Stage, Handle<Image>, Entity, Transform) {
    let mut stage = Stage::new();
    stage.world().insert_resource(PointLightShadowMap { size: 256 });
    let target = stage.target(SIZE);
    let view = looking(from);
    let camera = stage.camera(&target, view);
    (stage, target, camera, view)
}

fn plain() -> VdbMaterial {
    VdbMaterial { reflectance: 0.0, perceptual_roughness: 1.0, ..default() }
}

/// Compares a picture of the floor with what is to be lit: by the box before the plane y = `top`.
/// `to_light` gives the way from a place to the light.
fn compare(picture: &Picture, view: Transform, above: Block, to_light: impl Fn(DVec3) -> DVec3) {
    let top = in_world(FLOOR, VOXEL).max.y;
    let (mut lit, mut dark, mut wrong) = (0, 0, 0);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let at = origin + dir * ((top - origin.y) / dir.y);
            let on_floor = dir.y < 0.0 && at.x.abs().max(at.z.abs()) < 5.9;
            if !on_floor || above.grown(0.01).enter(origin, dir).is_some() {
                continue;
            }
            let way = to_light(at);
            let blocked = |block: Block| block.enter(at, way).is_some_and(|t| t < 1.0);
            // Rays that graze an edge may go either way.
            let (inner, outer) = (blocked(above.grown(-1e-3)), blocked(above.grown(1e-3)));
            if inner != outer {
                continue;
            }
            let is_lit = picture.at(x, y).x > 0.0;
            if outer {
                dark += 1
            } else {
                lit += 1
            }
            wrong += usize::from(is_lit == outer);
        }
    }
    println!("{lit} pixels lit, {dark} in the shadow, {wrong} wrong");
    assert!(lit > 500 && dark > 100, "{lit} lit, {dark} dark");
    assert_eq!(wrong, 0, "pixels are lit that should not be, or the other way round");
}

#[gpu_test]
fn a_box_throws_its_shadow_on_a_floor() {
    let to_sun = Vec3::new(0.5, 1.0, 0.3);
    let bulb = Vec3::new(1.0, 5.0, 0.7);
    for apart in [false, true] {
        let (mut stage, target, camera, view) = stage(Vec3::new(-2.0, 7.0, 5.0));
        if apart {
            // Two grids, the second with other voxels, turned, and put up by its transform.
            let floor = stage.grid(voxels(&[FLOOR]), SURFACE, VOXEL);
            stage.world().spawn((VdbVolume(floor), plain()));
            let small = CoordBox { min: IVec3::new(-20, -10, -20), max: IVec3::new(19, 9, 19) };
            let grid = stage.grid(voxels(&[small]), SURFACE, 0.04);
            let turned =
                Transform::from_rotation(Quat::from_rotation_y(std::f32::consts::FRAC_PI_2));
            // Its samples reach from -20 to 19: the middle is half a voxel below zero, and stays
            // there on x, but not on z, after the turn.
            let turned = turned.with_translation(Vec3::new(-0.03, 1.37, -0.07));
            stage.world().spawn((VdbVolume(grid), plain(), turned));
        } else {
            let both = voxels(&[FLOOR, ABOVE]);
            let grid = stage.grid(both, SURFACE, VOXEL);
            stage.world().spawn((VdbVolume(grid), plain()));
        }
        let above = if apart {
            // (x, y, z) → (z, y, -x) about y, then moved.
            let half = DVec3::new(0.8, 0.4, 0.8);
            let middle = DVec3::new(-0.03 - 0.02, 1.37 - 0.02, -0.07 + 0.02);
            Block { min: middle - half, max: middle + half }
        } else {
            in_world(ABOVE, VOXEL)
        };
        let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
        let light = stage.world().spawn((sun, looking(to_sun))).id();
        let picture = stage.picture(&target);
        picture.save(&format!("shadow_sun_apart_{apart}"));
        compare(&picture, view, above, |_| to_sun.as_dvec3() * 100.0);

        let settings = VdbQuality { shadows: false, ..default() };
        stage.world().entity_mut(camera).insert(settings);
        let without = stage.picture(&target);
        assert!(without.count(|p| p.x > 0.0) > picture.count(|p| p.x > 0.0) + 100, "switched off");
        stage.world().entity_mut(camera).insert(VdbQuality::default());
        stage.world().despawn(light);

        let lamp =
            PointLight { intensity: 500.0, range: 100.0, shadow_maps_enabled: true, ..default() };
        let light = stage.world().spawn((lamp, Transform::from_translation(bulb))).id();
        let picture = stage.picture(&target);
        picture.save(&format!("shadow_point_apart_{apart}"));
        compare(&picture, view, above, |at| bulb.as_dvec3() - at);
        stage.world().despawn(light);

        let lamp = SpotLight {
            intensity: 500.0,
            range: 100.0,
            outer_angle: 1.5,
            inner_angle: 1.4,
            shadow_maps_enabled: true,
            ..default()
        };
        stage
            .world()
            .spawn((lamp, Transform::from_translation(bulb).looking_at(Vec3::ZERO, Vec3::X)));
        let picture = stage.picture(&target);
        picture.save(&format!("shadow_spot_apart_{apart}"));
        compare(&picture, view, above, |at| bulb.as_dvec3() - at);
    }
}

/// Of a plate whose edge is `h` above a floor, a sun of angle α straight above makes a shadow whose edge is
/// α·h wide; within, as much of the light comes through as the edge leaves of the sun's disk.
#[gpu_test]
#[ignore = "slow: means of many frames"]
fn a_sun_with_a_size_throws_soft_shadows() {
    let (mut stage, target, camera, view) = stage(Vec3::new(2.5, 1.6, 0.0));
    let floor = stage.grid(voxels(&[FLOOR]), SURFACE, VOXEL);
    stage.world().spawn((VdbVolume(floor), plain()));
    // Its edge is at x = -0.55, and its lower face at 2.15; the floor's upper face at -0.05.
    let plate = CoordBox { min: IVec3::new(-60, 22, -60), max: IVec3::new(-6, 22, 59) };
    let plate = stage.grid(voxels(&[plate]), SURFACE, VOXEL);
    stage.world().spawn((VdbVolume(plate), plain()));
    let light = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    let light = stage.world().spawn((light, looking(Vec3::new(0.0, 1.0, 1e-4)))).id();
    let off = VdbQuality { shadows: false, ..default() };
    stage.world().entity_mut(camera).insert(off);
    let bright = stage.picture(&target);
    stage.world().entity_mut(camera).insert(VdbQuality::default());
    for angle in [0.0_f64, 0.2, 0.5] {
        let soft = VdbSun { angular_diameter: angle as f32, samples: 64, ..default() };
        stage.world().entity_mut(light).insert(soft);
        let picture = stage.picture(&target);
        picture.save(&format!("soft_{angle}"));
        assert_eq!(picture, stage.picture(&target), "it stands still");
        let (mut within, mut off, mut worst) = (0, 0.0, 0.0_f64);
        for y in 0..SIZE.y {
            for x in 0..SIZE.x {
                let (origin, dir) = pixel_ray(view, x, y);
                let at = origin + dir * ((-0.05 - origin.y) / dir.y);
                let full = bright.at(x, y).x;
                if dir.y >= 0.0 || at.x.abs().max(at.z.abs()) > 2.0 || full == 0.0 {
                    continue;
                }
                let part = f64::from(picture.at(x, y).x / full);
                // Rays that lean towards the plate leave it by its upper edge, the others come in by the lower.
                let height = if at.x > -0.55 { 2.3 } else { 2.2 };
                let s = (at.x + 0.55) / (height * (0.5 * angle).tan()).max(1e-3);
                if s.abs() > 1.02 {
                    let expected = f64::from(u8::from(s > 0.0));
                    assert!((part - expected).abs() < 2e-3, "{part} at {at}, {s} radii");
                    continue;
                }
                let s = s.clamp(-1.0, 1.0);
                let expected = 0.5 + (s * (1.0 - s * s).sqrt() + s.asin()) / std::f64::consts::PI;
                within += 1;
                off += part - expected;
                worst = worst.max((part - expected).abs());
            }
        }
        println!("angle {angle}: {within} pixels within the edge, {worst} off at worst");
        if angle > 0.0 {
            let mean = off / f64::from(within);
            assert!(within > 100, "{within} pixels");
            // Each of 64 rays is a 64th of the light; an edge parts them to within three.
            assert!(worst < 3.0 / 64.0 && mean.abs() < 5e-3, "{worst} off, in the mean {mean}");
        }
    }
}

/// Volumes heed what meshes do.
#[gpu_test]
fn volumes_that_want_no_shadows_have_none() {
    let (mut stage, target, ..) = stage(Vec3::new(0.1, 2.0, 0.1));
    let floor = stage.grid(voxels(&[FLOOR]), SURFACE, VOXEL);
    let floor = stage.world().spawn((VdbVolume(floor), plain())).id();
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(0.0, 1.0, 0.001))));
    let lit = stage.picture(&target).center().x;
    let roof = stage.grid(voxels(&[ABOVE]), SURFACE, VOXEL);
    let high = Transform::from_xyz(0.0, 5.0, 0.0);
    let roof = stage.world().spawn((VdbVolume(roof), plain(), high)).id();
    assert_eq!(stage.picture(&target).center().x, 0.0);
    stage.world().entity_mut(roof).insert(NotShadowCaster);
    assert_eq!(stage.picture(&target).center().x, lit, "no caster");
    stage.world().entity_mut(roof).remove::<NotShadowCaster>();
    stage.world().entity_mut(floor).insert(NotShadowReceiver);
    assert_eq!(stage.picture(&target).center().x, lit, "no receiver");
}

/// What the camera does not see throws its shadow all the same.
#[gpu_test]
fn a_volume_out_of_the_picture_throws_its_shadow_into_it() {
    let (mut stage, target, ..) = stage(Vec3::new(0.1, 2.0, 0.1));
    let floor = stage.grid(voxels(&[FLOOR]), SURFACE, VOXEL);
    stage.world().spawn((VdbVolume(floor), plain()));
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(0.0, 1.0, 0.001))));
    let lit = stage.picture(&target).center().x;
    assert!(lit > 0.5, "{lit}");
    let roof = stage.grid(voxels(&[ABOVE]), SURFACE, VOXEL);
    let high = Transform::from_xyz(0.0, 5.0, 0.0);
    let roof = stage.world().spawn((VdbVolume(roof), plain(), high)).id();
    assert_eq!(stage.picture(&target).center().x, 0.0, "above the camera");
    stage.world().entity_mut(roof).insert(Visibility::Hidden);
    assert_eq!(stage.picture(&target).center().x, lit, "hidden");
    let layer = bevy::camera::visibility::RenderLayers::layer(2);
    stage.world().entity_mut(roof).insert((Visibility::Visible, layer));
    assert_eq!(stage.picture(&target).center().x, lit, "in a layer that the camera does not see");
}

/// A ball is convex: no point of it that faces the light is in its shadow, however the light grazes.
#[gpu_test]
#[ignore = "slow: starts an app for each ball"]
fn a_ball_has_no_acne() {
    for (radius, far) in [(10.0, 1.0), (40.0, 1.0), (40.0, 300.0)] {
        let (mut stage, target, camera, _) = stage(Vec3::new(0.3, 0.5, 6.0) * far);
        let fov = 2.0 * (2.2 / 6.0 / far).atan();
        let projection = PerspectiveProjection { fov, near: 0.1, ..default() };
        stage.world().entity_mut(camera).insert(Projection::Perspective(projection));
        let tree = level_set::sphere(DVec3::new(0.2, -0.3, 0.1), radius);
        let grid = stage.grid(tree, PackKind::Smooth { iso: 0.0 }, 2.0 / radius);
        let turned = Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, 0.3, 0.7, -0.4));
        stage.world().spawn((VdbVolume(grid), plain(), turned));
        // Across the view: half of what is seen is lit, and its border is where light grazes.
        let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
        stage.world().spawn((sun, looking(Vec3::new(5.0, 1.0, 0.0))));
        let with = stage.picture(&target);
        with.save(&format!("acne_{radius}_{far}"));
        let settings = VdbQuality { shadows: false, ..default() };
        stage.world().entity_mut(camera).insert(settings);
        let without = stage.picture(&target);
        let lit = without.count(|p| p.x > 0.0);
        // The shaders differ, so one may round to the 16-bit float next to the other's.
        let differ = with.pixels.iter().zip(&without.pixels);
        let differ = differ.filter(|(a, b)| (a.x - b.x).abs() > b.x / 1024.0).count();
        println!("radius {radius}, {far} times as far: {lit} pixels lit, {differ} differ");
        assert!(lit > 500, "{lit} pixels are lit");
        assert_eq!(differ, 0, "of {lit} pixels that face the light");
    }
}

/// Fog before the light: e^-τ of it comes through.
#[gpu_test]
fn fog_dims_the_light_behind_it() {
    let (mut stage, target, _, _) = stage(Vec3::new(0.0, 1.5, 6.0));
    let floor = stage.grid(voxels(&[FLOOR]), SURFACE, VOXEL);
    stage.world().spawn((VdbVolume(floor), plain()));
    let to_sun = Vec3::new(0.0, 4.0, -3.0).normalize();
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(to_sun)));
    let bright = stage.picture(&target).center().x;
    // Between y = 2.95 and 4.05 whole; above and below, its density falls to nothing over a voxel.
    let layer = CoordBox { min: IVec3::new(-60, 30, -90), max: IVec3::new(59, 40, 59) };
    let grid = stage.grid(fog::block(layer, 1.0), PackKind::Fog, VOXEL);
    let black = VdbMaterial { base_color: Color::BLACK, density_scale: 0.8, ..default() };
    stage.world().spawn((VdbVolume(grid), black));
    let picture = stage.picture(&target);
    picture.save("shadow_of_fog");
    let expected = (-0.8 * 1.1 / to_sun.y).exp();
    let found = picture.center().x / bright;
    println!("{found} of the light comes through, {expected} expected");
    assert!((found / expected - 1.0).abs() < 5e-3, "{found}, not {expected}");
}

/// Fog shades itself: of a dense slab under a sun straight above, what is `d` below its top has e^-d of
/// the light, so that a level look through it shows that.
#[gpu_test]
fn fog_shades_itself() {
    let (mut stage, target, camera, _) = stage(Vec3::new(0.0, 0.0, 12.0));
    let slab = CoordBox { min: IVec3::new(-40, -20, -5), max: IVec3::new(39, 19, 4) };
    let grid = stage.grid(fog::block(slab, 1.0), PackKind::Fog, VOXEL);
    let material = VdbMaterial { density_scale: 1.0, ..default() };
    stage.world().spawn((VdbVolume(grid), material));
    let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(0.0, 1.0, 1e-4))));
    stage.world().entity_mut(camera).insert(parallel(6.0));
    let picture = stage.picture(&target);
    picture.save("fog_shades_itself");
    // The density is 1 from y = -2 to 1.9 and from z = -0.5 to 0.4, and falls to nothing in a voxel: at
    // z, so much of it is above y.
    let above = |y: f64| 1.95 - y;
    let density = |z: f64| ((0.45 - (z + 0.05).abs()).min(0.0) / VOXEL + 1.0).clamp(0.0, 1.0);
    let mut worst = 0.0_f64;
    for row in 0..SIZE.y {
        let y = 3.0 - 6.0 * (f64::from(row) + 0.5) / f64::from(SIZE.y);
        if !(-1.8..1.8).contains(&y) {
            continue;
        }
        let (mut expected, mut depth) = (0.0, 0.0);
        let step = 1e-3;
        for i in 0..1200 {
            let density = density(0.6 - step * (f64::from(i) + 0.5));
            let light = 10.0 / (4.0 * std::f64::consts::PI) * (-density * above(y)).exp();
            expected += light * density * step * (-depth - 0.5 * density * step).exp();
            depth += density * step;
        }
        assert!((depth - 1.0).abs() < 1e-3, "{depth}");
        // Beside the brightest: in its ramps, light changes within a slab of the ray.
        let brightest = 10.0 / (4.0 * std::f64::consts::PI);
        let off = f64::from(picture.at(SIZE.x / 2, row).x) - expected;
        worst = worst.max((off / brightest).abs());
    }
    println!("off by {worst} at most");
    assert!(worst < 0.01, "off by {worst}");
}

/// Bevy's shadow maps darken volumes.
#[gpu_test]
fn a_mesh_throws_its_shadow_on_a_volume() {
    let (mut stage, target, _, _) = stage(Vec3::new(0.0, 6.0, 5.0));
    let floor = stage.grid(voxels(&[FLOOR]), SURFACE, VOXEL);
    stage.world().spawn((VdbVolume(floor), plain()));
    // It stands out of the picture, above.
    stage.red_cube(2.0, Transform::from_xyz(0.0, 9.0, 0.0));
    let lights: [&dyn Fn(&mut World) -> Entity; 3] = [
        &|world| {
            let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
            world.spawn((sun, looking(Vec3::new(0.0, 1.0, 1e-3)))).id()
        },
        &|world| {
            let bulb =
                PointLight { intensity: 9e3, range: 90.0, shadow_maps_enabled: true, ..default() };
            world.spawn((bulb, Transform::from_xyz(0.0, 15.0, 0.0))).id()
        },
        &|world| {
            let lamp =
                SpotLight { intensity: 9e3, range: 90.0, shadow_maps_enabled: true, ..default() };
            world.spawn((lamp, looking(Vec3::new(0.0, 15.0, 1e-3)))).id()
        },
    ];
    for (i, light) in lights.into_iter().enumerate() {
        let light = light(stage.world());
        let picture = stage.picture(&target);
        picture.save(&format!("shadow_of_mesh_{i}"));
        let (middle, beside) = (picture.center().x, picture.at(2, SIZE.y / 2).x);
        assert!(middle < 0.01 * beside && beside > 0.1, "light {i}: {middle} beside {beside}");
        stage.world().despawn(light);
    }
}
