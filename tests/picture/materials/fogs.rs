//! Functions that change fog.

use bevy::light::{DirectionalLightShadowMap, PointLightShadowMap};
use vdb_core::tree::CoordBox;

use super::*;
use crate::common::Picture;

/// A fog over a floor, in the light of a sun and a lamp with shadows.
fn fog_over_floor(stage: &mut Stage) -> Entity {
    let floor = stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(8.0, 0.2, 8.0));
    let white = StandardMaterial { perceptual_roughness: 1.0, ..default() };
    let white = stage.world().resource_mut::<Assets<StandardMaterial>>().add(white);
    let place = Transform::from_xyz(0.0, -1.6, 0.0);
    stage.world().spawn((Mesh3d(floor), MeshMaterial3d(white), place));
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(1.0, 4.0, 1.0))));
    let lamp = PointLight { intensity: 200.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((lamp, Transform::from_xyz(-2.0, 2.0, 2.0)));
    let grid = stage.grid(fog::sphere(DVec3::ZERO, 12.0, 9.0), PackKind::Fog, 0.1);
    stage.world().spawn(VdbVolume(grid)).id()
}

/// The largest difference between two pictures, over the brightest pixel of the first.
fn largest_difference(a: &Picture, b: &Picture) -> f32 {
    let brightest = a.pixels.iter().map(|pixel| pixel.max_element()).fold(0.0, f32::max);
    let pairs = a.pixels.iter().zip(&b.pixels);
    pairs.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max) / brightest
}

/// Fog of which a function leaves half is fog of half the density, in all that sees it: exact and sampled rays, rays
/// towards lights, the light cache and the shadow maps of meshes. And so it is with its albedo.
#[gpu_test]
#[ignore = "slow: each way of lighting compiles shaders of its own"]
fn half_of_a_fog_is_fog_of_half_the_density() {
    let mut stage = Stage::with(add_materials);
    stage.world().insert_resource(DirectionalLightShadowMap { size: 128 });
    stage.world().insert_resource(PointLightShadowMap { size: 64 });
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.5, 2.0, 6.0)));
    let volume = fog_over_floor(&mut stage);
    let color = LinearRgba::rgb(1.0, 0.5, 0.25);
    for (name, quality) in [
        ("exact", VdbQuality { fog_step: 0.0, fog_light_error: 0.0, ..default() }),
        ("sampled", VdbQuality { fog_step: 1.0, fog_light_error: 0.0, ..default() }),
        ("cached", VdbQuality::default()),
    ] {
        stage.world().entity_mut(camera).insert(quality);
        let material = VdbMaterial { density_scale: 2.0, ..default() };
        stage.world().entity_mut(volume).remove::<Thinned>().insert(material.clone());
        let whole = stage.picture(&target);
        let half = VdbMaterial { density_scale: 1.0, base_color: color.into(), ..default() };
        stage.world().entity_mut(volume).insert(half);
        let half = stage.picture(&target);
        let own = Thinned { share: 0.5, top: 9.0, color };
        stage.world().entity_mut(volume).insert((material, own));
        let thinned = stage.picture(&target);
        for (picture, what) in [(&whole, "whole"), (&half, "half"), (&thinned, "thinned")] {
            picture.save(&format!("materials_fog_{name}_{what}"));
        }
        let effect = largest_difference(&half, &whole);
        assert!(effect > 0.1, "{name}: half is the whole but for {effect}");
        // Factors of two are exact; but light is in the cache with 16 bits, and albedos are summed.
        let error = largest_difference(&half, &thinned);
        println!("{name}: {error}, of {effect}");
        assert!(error < 2e-3, "{name}: {error}");
    }
}

/// Where a function leaves nothing, there is nothing; elsewhere all is as it was.
#[gpu_test]
fn functions_know_where_they_are_in_a_fog() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    // In tiles and in leaves, away from the origin of index space.
    let cube = CoordBox { min: IVec3::new(90, -40, 0), max: IVec3::new(149, 19, 63) };
    let local_from_index = DAffine3::from_scale(DVec3::splat(0.05))
        * DAffine3::from_translation(DVec3::new(-119.5, 10.5, -31.5));
    let grid =
        VdbGrid::new("test", fog::block(cube, 1.0), local_from_index, PackKind::Fog).unwrap();
    let grid = stage.world().resource_mut::<Assets<VdbGrid>>().add(grid);
    let shine = VdbMaterial { emissive: GREEN, base_color: Color::BLACK, ..default() };
    // What is above in the space of the entity is on the left.
    let turned = Transform::from_rotation(Quat::from_rotation_z(std::f32::consts::FRAC_PI_2));
    let volume = stage.world().spawn((VdbVolume(grid), shine, turned)).id();
    for fog_step in [0.0, 1.0] {
        stage.world().entity_mut(camera).insert(VdbQuality { fog_step, ..default() });
        let [all, below] =
            [9.0, 0.0].map(|top| Thinned { share: 1.0, top, color: LinearRgba::WHITE });
        stage.world().entity_mut(volume).insert(all);
        let whole = stage.picture(&target);
        stage.world().entity_mut(volume).insert(below);
        let part = stage.picture(&target);
        part.save(&format!("materials_fog_part_{fog_step}"));
        let (mut left, mut right) = (0, 0);
        for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
            let (before, now) = (whole.at(x, y), part.at(x, y));
            if before.y < 0.1 || x.abs_diff(SIZE.x / 2) < 2 {
                continue;
            }
            if x < SIZE.x / 2 {
                assert!(now.y == 0.0, "{fog_step}: {x}, {y}: {now} is left of {before}");
                left += 1;
            } else {
                assert!(now == before, "{fog_step}: {x}, {y}: {now}, {before}");
                right += 1;
            }
        }
        assert!(left > 300 && right > 300, "{fog_step}: {left} left, {right} right");
    }
}
