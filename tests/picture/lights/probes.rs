//! Reflection probes and irradiance volumes light surfaces as they light meshes.

use bevy::asset::RenderAssetUsages;
use bevy::light::{IrradianceVolume, ParallaxCorrection};
use bevy::pbr::MeshPipeline;
use bevy::render::RenderApp;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use bevy_vdb::VdbDiagnostics;

use super::*;

/// A reflection probe whose sky has one colour, which fills a box.
fn probe(world: &mut World, color: [f32; 3], place: Transform) -> Entity {
    let mut images = world.resource_mut::<Assets<Image>>();
    let color = Color::linear_rgb(color[0], color[1], color[2]);
    let map = EnvironmentMapLight::hemispherical_gradient(&mut images, color, color, Color::BLACK);
    let falloff = LightProbe { falloff: Vec3::splat(0.2) };
    world.spawn((falloff, EnvironmentMapLight { intensity: 0.7, ..map }, place)).id()
}

/// An irradiance volume of 2³ ambient cubes, no two of whose 48 colours are the same.
fn irradiance(world: &mut World, place: Transform) -> Entity {
    let size = Extent3d { width: 2, height: 4, depth_or_array_layers: 6 };
    let texels = (0..size.width * size.height * size.depth_or_array_layers).flat_map(|i| {
        let level = |step: u32| (40 + i * step % 200) as u8;
        [level(37), level(53), level(71), 255]
    });
    let image = Image::new(
        size,
        TextureDimension::D3,
        texels.collect(),
        TextureFormat::Rgba8Unorm,
        RenderAssetUsages::RENDER_WORLD,
    );
    let voxels = world.resource_mut::<Assets<Image>>().add(image);
    world.spawn((IrradianceVolume { voxels, intensity: 0.9, ..default() }, place)).id()
}

/// Whether the camera has the features of reflection probes and of irradiance volumes, with the ball of the level
/// set or that of triangles.
fn features(pair: &mut Pair, volume: bool) -> [bool; 2] {
    pair.show(volume);
    let report = pair.stage.world().resource::<VdbDiagnostics>().camera(pair.camera).unwrap();
    ["reflection probes", "irradiance volumes"].map(|name| report.has(name))
}

#[gpu_test]
#[ignore = "slow: pipelines of every material"]
fn irradiance_volumes_light_a_ball_as_one_of_triangles() {
    let mut pair = Pair::new(VdbMaterial { perceptual_roughness: 0.3, ..default() });
    let place = Transform::from_xyz(-1.4, 0.0, 0.0).with_scale(Vec3::splat(5.0));
    let place = place.with_rotation(Quat::from_rotation_y(0.4));
    let volume = irradiance(pair.stage.world(), place);
    pair.compare("irradiance");
    let alone = pair.show(true);
    let map = sky(pair.stage.world());
    pair.stage.world().entity_mut(pair.camera).insert(map);
    pair.compare("irradiance_before_a_sky");
    assert_eq!(features(&mut pair, true), [false, true]);
    // Only surfaces need it.
    let fog = pair.stage.grid(fog::sphere(DVec3::ZERO, 20.0, 5.0), PackKind::Fog, 0.1);
    let fog = pair.stage.world().spawn(VdbVolume(fog)).id();
    assert_eq!(features(&mut pair, false), [false, false]);
    pair.stage.world().despawn(fog);
    pair.stage.world().despawn(volume);
    assert_eq!(features(&mut pair, true), [false, false]);
    let without = pair.show(true);
    let off = |(a, b): (&Vec4, &Vec4)| (*a - *b).abs().max_element() > 0.05;
    assert!(alone.pixels.iter().zip(&without.pixels).any(off), "it makes no difference");
}

#[gpu_test]
fn reflection_probes_light_a_ball_as_one_of_triangles() {
    let mut pair = Pair::new(VdbMaterial { perceptual_roughness: 0.3, ..default() });
    pair.show(true);
    let render_world = pair.stage.app.sub_app(RenderApp).world();
    if !render_world.resource::<MeshPipeline>().binding_arrays_are_usable {
        println!(
            "SKIPPED: Bevy has no reflection probes where shaders cannot index arrays of textures"
        );
        return;
    }
    // The ball is in both, in their falloff, and outside.
    let left = Transform::from_xyz(-2.4, 0.0, 0.0).with_scale(Vec3::splat(5.0));
    let right = Transform::from_xyz(1.5, 1.0, 0.0).with_scale(Vec3::new(3.0, 2.0, 6.0));
    let world = pair.stage.world();
    probe(world, [1.0, 0.2, 0.1], left);
    let blue = probe(world, [0.1, 0.3, 1.0], right);
    world.entity_mut(blue).insert(ParallaxCorrection::None);
    pair.compare("probes");
    assert_eq!(features(&mut pair, true), [true, false]);
    let map = sky(pair.stage.world());
    pair.stage.world().entity_mut(pair.camera).insert(map);
    pair.compare("probes_before_a_sky");
    irradiance(pair.stage.world(), left);
    irradiance(pair.stage.world(), right);
    pair.compare("probes_with_irradiance");
    assert_eq!(features(&mut pair, true), [true, true]);
}

/// Where shaders cannot index arrays of textures, Bevy has no reflection probes, and one irradiance volume.
#[gpu_test]
fn without_arrays_of_textures_there_is_one_irradiance_volume() {
    let mut pair = Pair::with(Stage::of_standard_webgpu(), VdbMaterial::default());
    let place = Transform::from_scale(Vec3::splat(5.0));
    let world = pair.stage.world();
    probe(world, [1.0, 0.2, 0.1], place);
    irradiance(world, place);
    pair.compare("one_irradiance_volume");
    assert_eq!(features(&mut pair, true), [false, true]);
}
