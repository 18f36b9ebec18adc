//! The grain of fog's shadows on meshes is removed, and nothing else.

use bevy::camera::Hdr;
use bevy::image::ImageSampler;
use bevy::light::{DirectionalLightShadowMap, NotShadowReceiver, PointLightShadowMap};
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, Ray};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

use super::SIZE;
use super::common::{Picture, Stage};
use super::mesh_shadows::{BULB, Scene, VOXEL, bulb, pipelines, spot, sun};

/// The fog lies between y = 2.95 and 4.05; the camera is below.
const THICKNESS: f64 = 1.1;

fn fog_layer(density: impl Fn(f64, f64) -> f64 + Sync) -> Vdb543<f32> {
    let layer = CoordBox { min: IVec3::new(-60, 30, -90), max: IVec3::new(59, 40, 59) };
    fog::from_densities(layer, |at| {
        density(f64::from(at.x) * VOXEL, f64::from(at.z) * VOXEL) as f32
    })
}

fn black(scale: f32) -> VdbMaterial {
    VdbMaterial { base_color: Color::BLACK, density_scale: scale, ..default() }
}

fn denoise(on: bool) -> VdbQuality {
    VdbQuality { denoise: on, ..default() }
}

/// A fog whose shadow falls beside the picture.
fn small_fog(scene: &mut Scene, x: i32) {
    let min = IVec3::new(x, 30, -60);
    let block = CoordBox { min, max: min + IVec3::splat(3) };
    scene.volume(fog::block(block, 1.0), PackKind::Fog, black(1.0));
}

/// The root mean square and the largest error of the light that comes through.
fn errors(
    scene: &Scene,
    (with, without): (&Picture, &Picture),
    expected: &dyn Fn(DVec3) -> f64,
) -> (f64, f64) {
    let (mut sum, mut count, mut worst) = (0.0, 0.0, 0.0_f64);
    for y in SIZE.y / 2..SIZE.y {
        for x in 20..SIZE.x - 20 {
            let at = scene.place(x, y).expect("the plane is there");
            let error = f64::from(with.at(x, y).x / without.at(x, y).x) - expected(at);
            sum += error * error;
            count += 1.0;
            worst = worst.max(error.abs());
        }
    }
    (f64::sqrt(sum / count), worst)
}

/// A texture of random greys.
fn random_texture(scene: &mut Scene) -> Handle<Image> {
    let edge = 256_u32;
    let mut state = 1_u32;
    let texels = (0..edge * edge).flat_map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let grey = 128 + (state >> 25) as u8;
        [grey, grey, grey, 255]
    });
    let extent = Extent3d { width: edge, height: edge, depth_or_array_layers: 1 };
    let mut image = Image::new(
        extent,
        TextureDimension::D2,
        texels.collect(),
        TextureFormat::Rgba8UnormSrgb,
        default(),
    );
    image.sampler = ImageSampler::linear();
    scene.stage.world().resource_mut::<Assets<Image>>().add(image)
}

/// By each kind of light and however a camera draws: without grain, the light on a plane is that of the closed
/// form.
#[gpu_test]
fn fog_casts_shadows_without_grain() {
    let wavy = |x: f64, z: f64| 0.5 + 0.45 * (0.6 * x).sin() * (0.4 * z).cos();
    let from_above = |at: DVec3| (-THICKNESS * wavy(at.x, at.z)).exp();
    let slanted = Vec3::new(1.0, 1.0, 0.001);
    let from_aside = |_: DVec3| (-0.5 * THICKNESS * 2.0_f64.sqrt()).exp();
    let from_lamp = |at: DVec3| {
        let to_lamp = (BULB.as_dvec3() - at).normalize();
        (-0.5 * THICKNESS / to_lamp.y).exp()
    };
    // With the most that the root mean square and the largest error may be, and the least factor to that with
    // grain. On a texture as fine as the grain itself, less is removed.
    let mut stage = Stage::new();
    for (way, most, worst_allowed, gain) in [
        ("sun", 0.009, 0.03, 3.0),
        ("fourth", 0.009, 0.03, 3.0),
        ("slanted", 0.009, 0.03, 2.0),
        ("msaa", 0.009, 0.03, 3.0),
        ("texture", 0.018, 0.1, 1.5),
        ("spot", 0.008, 0.03, 3.0),
        ("bulb", 0.006, 0.02, 10.0),
    ] {
        let mut scene = Scene::on(stage, Vec3::new(0.0, 2.0, 4.0));
        let size = if way == "sun" { 512 } else { 256 };
        scene.stage.world().insert_resource(DirectionalLightShadowMap { size });
        scene.stage.world().insert_resource(PointLightShadowMap { size });
        let is_lamp = ["spot", "bulb"].contains(&way);
        let expected: &dyn Fn(DVec3) -> f64 = match way {
            "spot" | "bulb" => &from_lamp,
            "slanted" => &from_aside,
            _ => &from_above,
        };
        match way {
            "spot" => _ = scene.stage.world().spawn(spot()),
            "bulb" => _ = scene.stage.world().spawn(bulb()),
            "slanted" => _ = scene.stage.world().spawn(sun(slanted)),
            _ => _ = scene.stage.world().spawn(sun(Vec3::new(0.0, 1.0, 0.001))),
        }
        match way {
            // Also without HDR.
            "msaa" => {
                let mut camera = scene.stage.world().entity_mut(scene.camera);
                camera.insert(Msaa::Sample4).remove::<Hdr>();
            }
            "texture" => {
                let texture = random_texture(&mut scene);
                let mut all = scene.stage.world().resource_mut::<Assets<StandardMaterial>>();
                for (_, material) in all.iter_mut() {
                    material.base_color_texture = Some(texture.clone());
                }
            }
            _ => {}
        }
        let bright = scene.picture(&format!("grain_{way}_none"));
        let is_even = is_lamp || way == "slanted";
        let tree = if is_even { fog_layer(|_, _| 0.5) } else { fog_layer(wavy) };
        // The fourth fog in the map, whichever way these are sorted.
        let before = if way == "fourth" { &[-58, -54, -50][..] } else { &[] };
        let after = if way == "fourth" { &[-46, -42, -38][..] } else { &[] };
        before.iter().for_each(|&x| small_fog(&mut scene, x));
        scene.volume(tree, PackKind::Fog, black(1.0));
        after.iter().for_each(|&x| small_fog(&mut scene, x));
        let [(grainy, _), (smooth, worst)] = [false, true].map(|on| {
            scene.stage.world().entity_mut(scene.camera).insert(denoise(on));
            let picture = scene.picture(&format!("grain_{way}_{on}"));
            errors(&scene, (&picture, &bright), expected)
        });
        println!("{way}: {grainy:.4} with grain, {smooth:.4} without, {worst:.4} at worst");
        assert!(smooth < most, "{way}: {smooth} with grain removed");
        assert!(worst < worst_allowed, "{way}: {worst} at worst");
        assert!(grainy > gain * smooth, "{way}: {grainy} with grain");
        stage = scene.stage;
    }
}

/// Within a cloud, at each height, the light on a plane is that of the reference.
#[gpu_test]
fn fog_shades_what_is_inside_it() {
    let cloud = fog::cloud(20.0, 3);
    let reference = Fog::new(&cloud);
    let slanted = Vec3::new(1.0, 1.5, 0.3);
    let mut stage = Stage::new();
    for (way, scale) in [("sun", 0.5_f32), ("sun", 4.0), ("spot", 0.5), ("short", 0.5)] {
        let mut scene = Scene::on(stage, Vec3::new(-2.0, 7.0, 5.0));
        match way {
            "spot" => _ = scene.stage.world().spawn(spot()),
            // Its range ends within the fog.
            "short" => {
                let light = scene.stage.world().spawn(spot()).id();
                let mut light = scene.stage.world().entity_mut(light);
                light.get_mut::<SpotLight>().expect("a light").range = 8.0;
            }
            _ => _ = scene.stage.world().spawn(sun(slanted)),
        }
        let volume = scene.volume(cloud.clone(), PackKind::Fog, black(scale));
        let turned = Quat::from_euler(EulerRot::XYZ, 0.3, 0.4, 0.5);
        let placed = Transform::from_rotation(turned).with_scale(Vec3::new(0.9, 0.7, 1.1));
        scene.stage.world().entity_mut(volume).insert(placed);
        let index_from_world = placed.compute_affine().inverse();
        let index = |at: DVec3| index_from_world.transform_vector3(at.as_vec3()).as_dvec3() / VOXEL;
        let heights = [-2.2, -1.0, 0.0, 1.0];
        for height in heights.into_iter().filter(|height| way != "short" || *height > -2.0) {
            let up = Transform::from_xyz(0.0, height, 0.0);
            scene.stage.world().entity_mut(scene.plane).insert(up);
            let [without, with] = [false, true].map(|mesh_shadows| {
                let settings = VdbCamera { mesh_shadows, ..default() };
                scene.stage.world().entity_mut(scene.camera).insert(settings);
                scene.picture(&format!("inside_{way}_{scale}_{height}_{mesh_shadows}"))
            });
            let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
            for y in 0..SIZE.y {
                for x in 0..SIZE.x {
                    let full = f64::from(without.at(x, y).x);
                    let Some(at) = scene.place_at(f64::from(height), x, y) else { continue };
                    // The camera sees the plane through the fog.
                    if full < 0.02 {
                        continue;
                    }
                    let to_light = match way {
                        "spot" | "short" => BULB.as_dvec3() - at,
                        _ => 1e3 * slanted.normalize().as_dvec3(),
                    };
                    let ray = Ray::from_f64(index(at), index(to_light)).with_span(0.0, 1.0);
                    let scale = f64::from(scale) * to_light.length();
                    let error = f64::from(with.at(x, y).x) / full
                        - reference.transmittance(&ray, scale).value;
                    sum += error;
                    squares += error * error;
                    count += 1.0;
                }
            }
            let (mean, rms) = (sum / count, f64::sqrt(squares / count));
            println!("{way}, scale {scale}, height {height}: {mean:.4} off, {rms:.4} ({count})");
            // The mean has neither grain nor the blur of its removal.
            assert!(mean.abs() < 0.003, "{mean} off");
            assert!(rms < if scale < 1.0 { 0.015 } else { 0.03 }, "{rms}");
            assert!(count > if way == "short" { 100.0 } else { 500.0 }, "{count}");
        }
        stage = scene.stage;
    }
}

/// What fog does not shade, what ignores shadows, and the edges of other shadows stay as they are.
#[gpu_test]
fn removing_grain_changes_nothing_else() {
    let mut scene = Scene::new(Vec3::new(0.0, 2.0, 4.0));
    let ambient = AmbientLight { brightness: 0.5, ..default() };
    scene.stage.world().entity_mut(scene.camera).insert(ambient);
    let around = scene.picture("grain_ambient");
    scene.stage.world().spawn(sun(Vec3::new(0.0, 1.0, 0.001)));
    // Over the left half.
    let half = CoordBox { min: IVec3::new(-60, 30, -90), max: IVec3::new(-1, 40, 59) };
    scene.volume(fog::block(half, 0.5), PackKind::Fog, black(1.0));
    // A ball above the camera, whose shadow lies in both halves.
    let ball = level_set::sphere(DVec3::new(0.0, 25.0, 10.0), 4.0);
    scene.volume(ball, PackKind::Smooth { iso: 0.0 }, VdbMaterial::default());
    let [grainy, smooth] = [false, true].map(|on| {
        scene.stage.world().entity_mut(scene.camera).insert(denoise(on));
        scene.picture(&format!("grain_half_{on}"))
    });
    let (mut right, mut dark, mut changed) = (0, 0, 0);
    for y in SIZE.y / 2..SIZE.y {
        for x in 0..SIZE.x {
            let at = scene.place(x, y).expect("the plane is there");
            let (before, after) = (grainy.at(x, y), smooth.at(x, y));
            if at.x > 0.3 {
                right += 1;
                assert_eq!(before, after, "at {x}, {y}, beside the fog");
            } else if before == around.at(x, y) {
                // No light of the sun arrives, so there is little by which to know what it contributes.
                dark += 1;
                let added = after.x - before.x;
                assert!(added.abs() < 0.01, "at {x}, {y}, {added} in the ball's shadow");
            } else {
                changed += u32::from(before != after);
            }
        }
    }
    assert!(right > 500 && dark > 10 && changed > 500, "{right}, {dark}, {changed}");

    scene.stage.world().entity_mut(scene.plane).insert(NotShadowReceiver);
    let [before, after] = [false, true].map(|on| {
        scene.stage.world().entity_mut(scene.camera).insert(denoise(on));
        scene.picture(&format!("grain_ignored_{on}"))
    });
    let mut worst = 0.0_f32;
    for (before, after) in before.pixels.iter().zip(&after.pixels) {
        let difference = (before - after).abs().max_element();
        worst = worst.max(difference / before.max_element());
        assert!(difference < 3e-3, "{before} became {after} on what receives no shadows");
    }
    println!("{:.2} % off at worst on what receives no shadows", 100.0 * worst);
}

/// Bright pixels, even if brighter than the target can hold, do not spread to their neighbours.
#[gpu_test]
fn bright_pixels_do_not_spread() {
    let mut scene = Scene::new(Vec3::new(0.0, 2.0, 4.0));
    scene.stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
    scene.stage.world().spawn(sun(Vec3::new(0.0, 1.0, 0.001)));
    scene.volume(fog_layer(|_, _| 0.5), PackKind::Fog, black(1.0));
    let disk = scene.stage.world().resource_mut::<Assets<Mesh>>().add(Circle::new(0.2));
    let materials = scene.stage.world().resource_mut::<Assets<StandardMaterial>>().into_inner();
    let lamp = materials.add(StandardMaterial::default());
    let flat = Transform::from_xyz(0.0, 0.001, 1.0).looking_to(Vec3::NEG_Y, Vec3::X);
    scene.stage.world().spawn((Mesh3d(disk), MeshMaterial3d(lamp.clone()), flat));
    for radiance in [1e4, 1e8] {
        let emissive = LinearRgba::rgb(radiance, radiance, radiance);
        let lit = StandardMaterial { emissive, ..default() };
        let mut materials = scene.stage.world().resource_mut::<Assets<StandardMaterial>>();
        materials.insert(&lamp, lit).expect("the material");
        let [grainy, smooth] = [false, true].map(|on| {
            scene.stage.world().entity_mut(scene.camera).insert(denoise(on));
            scene.picture(&format!("grain_bright_{radiance}_{on}"))
        });
        let (mut bright, mut others, mut worst) = (0, 0, 0.0_f32);
        for (before, after) in grainy.pixels.iter().zip(&smooth.pixels) {
            if before.x > 10.0 {
                bright += 1;
            } else {
                others += 1;
                worst = worst.max((before - after).abs().max_element());
            }
        }
        println!("radiance {radiance}: {bright} bright pixels, the others change by {worst}");
        assert!(bright > 10 && others > 1000, "{bright}, {others}");
        assert!(worst < 0.2, "{worst}");
    }
}

/// Only what needs it is made.
#[gpu_test]
fn grain_is_looked_for_where_fog_shades_a_mesh() {
    let mut scene = Scene::new(Vec3::new(0.0, 2.0, 4.0));
    scene.stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
    scene.stage.world().spawn(sun(Vec3::new(0.0, 1.0, 0.001)));
    let made = |scene: &mut Scene, why: &str| {
        scene.picture("grain_wanted");
        let all = ["vdb_fog_shadows_draw", "vdb_mesh_depth"];
        println!("{why}");
        all.map(|label| pipelines(&mut scene.stage, label))
    };
    let ball = level_set::sphere(DVec3::new(0.0, 35.0, 0.0), 5.0);
    scene.volume(ball, PackKind::Smooth { iso: 0.0 }, VdbMaterial::default());
    assert_eq!(made(&mut scene, "a surface"), [0, 0]);
    scene.stage.world().entity_mut(scene.plane).insert(Visibility::Hidden);
    scene.volume(fog_layer(|_, _| 0.5), PackKind::Fog, black(1.0));
    assert_eq!(made(&mut scene, "no mesh is seen"), [0, 0]);
    scene.stage.world().entity_mut(scene.plane).insert(Visibility::Inherited);
    let camera = scene.camera;
    for (settings, quality) in [
        (VdbCamera::default(), denoise(false)),
        (VdbCamera { mesh_shadows: false, ..default() }, denoise(true)),
        (VdbCamera { enabled: false, ..default() }, denoise(true)),
        (VdbCamera::default(), VdbQuality { shadows: false, ..default() }),
    ] {
        scene.stage.world().entity_mut(camera).insert((settings, quality));
        assert_eq!(made(&mut scene, "switched off"), [0, 0]);
    }
    scene.stage.world().entity_mut(camera).insert((VdbCamera::default(), denoise(true)));
    assert_eq!(made(&mut scene, "a fog"), [1, 1]);
}
