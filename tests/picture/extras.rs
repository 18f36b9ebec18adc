//! Several grids on a volume: what shines, and what colours, against the reference tracer.

mod fire;

use std::path::Path;

use bevy::camera::Hdr;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::math::{DAffine3, DQuat, DVec3};
use bevy::pbr::{DistanceFog, FogFalloff};
use bevy::prelude::*;
use bevy_vdb::{
    VdbColorGrid, VdbEmission, VdbGpuUsage, VdbGrid, VdbMaterial, VdbQuality, VdbVectorGrid,
    VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::blackbody;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Blocky, Dimming, Fog, Occupied, Ray, Smooth, emitted};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543, map_values};

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking, pixel_ray};

/// Fog that absorbs what it meets.
fn soot(density_scale: f32) -> VdbMaterial {
    VdbMaterial { base_color: Color::BLACK, density_scale, ..default() }
}

fn cube(low: i32, high: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(low), max: IVec3::splat(high) }
}

/// Voxels of a tenth of a world unit, as a stage has them.
fn tenths() -> DAffine3 {
    DAffine3::from_scale(DVec3::splat(0.1))
}

/// A place for a second grid that no other shares.
fn elsewhere() -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::new(0.07, 0.13, 0.09),
        DQuat::from_euler(EulerRot::XYZ, 0.4, -0.8, 1.3),
        DVec3::new(0.31, 0.17, -0.23),
    )
}

impl Stage {
    fn fog_at(&mut self, tree: &Vdb543<f32>, place: DAffine3) -> Handle<VdbGrid> {
        let grid = VdbGrid::new("fog", tree.clone(), place, PackKind::Fog).unwrap();
        self.world().resource_mut::<Assets<VdbGrid>>().add(grid)
    }

    fn vectors_at(&mut self, tree: &Vdb543<[f32; 3]>, place: DAffine3) -> Handle<VdbVectorGrid> {
        let grid = VdbVectorGrid::new("vectors", tree.clone(), place).unwrap();
        self.world().resource_mut::<Assets<VdbVectorGrid>>().add(grid)
    }
}

/// What a grid sends along a ray of the world through the soot of another one.
struct Fire<'a> {
    values: &'a Vdb543<f32>,
    place: DAffine3,
    density: &'a Vdb543<f32>,
    density_scale: f64,
}

impl Fire<'_> {
    fn radiance(&self, origin: DVec3, dir: DVec3, emission: impl Fn(f64) -> f64) -> f64 {
        let ray = |place: DAffine3| {
            let index = place.inverse();
            Ray::from_f64(index.transform_point3(origin), index.transform_vector3(dir))
        };
        let soot = Fog::new(self.density);
        let dimming = Dimming {
            fog: &soot,
            ray: ray(tenths()),
            extinction_scale: self.density_scale * dir.length(),
        };
        let emission = |value| emission(value) * dir.length();
        emitted(&Fog::new(self.values), &ray(self.place), emission, Some(&dimming), 1e-7).value
    }
}

/// How much a picture is off in one component, relative to the largest that it should have, in pixels of
/// all its parts.
fn worst(picture: &Picture, component: usize, expected: impl Fn(u32, u32) -> f64) -> (f64, f64) {
    let (mut largest, mut worst) = (0.0_f64, 0.0_f64);
    // Every third pixel of every other row: the reference takes far longer than the picture.
    for y in (0..SIZE.y).step_by(2) {
        for x in (y / 2 % 3..SIZE.x).step_by(3) {
            let expected = expected(x, y);
            largest = largest.max(expected);
            worst = worst.max((f64::from(picture.at(x, y)[component]) - expected).abs());
        }
    }
    (worst / largest, largest)
}

#[gpu_test]
fn an_even_box_shines_as_its_closed_form_says() {
    let tree = fog::block(cube(-10, 9), 1.0);
    let mut stage = Stage::new();
    for (sigma, is_dense) in [(0.0_f64, false), (0.0, true), (0.3, true), (3.0, true)] {
        stage.clear();
        let target = stage.target(SIZE);
        // Along an axis, two world units of it, with a voxel's ramp at either end that adds up to one.
        let from = looking(Vec3::Z * 8.0);
        stage.camera(&target, from);
        let nothing = Vdb543::new(0.0);
        let density = stage.fog_at(if is_dense { &tree } else { &nothing }, tenths());
        let grid = stage.fog_at(&tree, tenths());
        let color = LinearRgba::rgb(0.5, 0.25, 2.0);
        let emission = VdbEmission::Scalar { grid, color };
        stage.world().spawn((VdbVolume(density), soot(sigma as f32), emission));
        let pixel = stage.picture(&target).center();
        let (_, dir) = pixel_ray(from, SIZE.x / 2, SIZE.y / 2);
        let length = 2.0 * dir.length();
        let thick = if sigma > 0.0 { -(-sigma * length).exp_m1() / sigma } else { length };
        let expected = color.to_vec3() * thick as f32;
        println!("{sigma} {is_dense}: {pixel} for {expected}");
        let error = ((pixel.truncate() - expected) / expected).abs().max_element();
        assert!(error < 1e-3, "{sigma} {is_dense}: {pixel} for {expected}");
    }
}

#[gpu_test]
#[ignore = "slow: integrals for every pixel of three pictures"]
fn black_bodies_shine_through_soot_as_the_reference_tracer_says() {
    // Warm in the middle; elsewhere than the soot is, for the most part, and in voxels of its own.
    let values = fog::sphere(DVec3::new(1.0, 3.0, -2.0), 14.0, 13.0);
    let density = fog::sphere(DVec3::new(4.0, -3.0, 2.0), 14.0, 6.0);
    let (scale, offset, strength) = (2300.0, 700.0, 1e-6);
    let mut stage = Stage::new();
    for (soots, is_lit) in [(1, false), (2, false), (1, true)] {
        stage.clear();
        let target = stage.target(SIZE);
        let view = looking(Vec3::new(1.0, 1.5, 5.0));
        stage.camera(&target, view);
        let grid = stage.fog_at(&values, elsewhere());
        let soot_grid = stage.fog_at(&density, tenths());
        let density_scale = 1.5 / soots as f32;
        let emission = VdbEmission::Temperature { grid, scale, offset, strength };
        stage.world().spawn((VdbVolume(soot_grid.clone()), soot(density_scale), emission));
        (1..soots).for_each(|_| {
            stage.world().spawn((VdbVolume(soot_grid.clone()), soot(density_scale)));
        });
        if is_lit {
            // Soot that absorbs all shows no lamp, but is no longer lit evenly.
            stage.world().spawn((PointLight::default(), Transform::from_xyz(2.0, 2.0, 2.0)));
        }
        let picture = stage.picture(&target);
        picture.save(&format!("blackbody_{soots}_{is_lit}"));
        let fire =
            Fire { values: &values, place: elsewhere(), density: &density, density_scale: 1.5 };
        for (component, name) in ["red", "green", "blue"].into_iter().enumerate() {
            let (worst, largest) = worst(&picture, component, |x, y| {
                let (origin, dir) = pixel_ray(view, x, y);
                fire.radiance(origin, dir, |value| {
                    let kelvin = f64::from(scale) * value + f64::from(offset);
                    let color = blackbody(if value > 0.0 { kelvin } else { 0.0 });
                    f64::from(strength) * color[component].max(0.0)
                })
            });
            println!("{soots} {is_lit}: {name} to {worst:.2e} of {largest:.3e}");
            assert!(largest > 0.01, "{name}: {largest}");
            // What 32 slabs leave of a soot that differs within them.
            assert!(worst < 5e-3, "{soots} {is_lit}: {name} is off by {worst:.2e}");
        }
    }
}

#[gpu_test]
fn vectors_shine_in_their_colours_without_any_soot() {
    let values = fog::sphere(DVec3::ZERO, 14.0, 6.0);
    let colors = map_values(&values, |value| [value, 0.25 * value * value, -value]);
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 1.5, 5.0));
    stage.camera(&target, view);
    let nothing = stage.fog_at(&Vdb543::new(0.0), tenths());
    let grid = stage.vectors_at(&colors, elsewhere());
    stage.world().spawn((VdbVolume(nothing), VdbEmission::Color { grid, strength: 0.5 }));
    let picture = stage.picture(&target);
    picture.save("vectors_shine");
    for component in 0..2 {
        let own = map_values(&colors, |value| value[component]);
        let none = Vdb543::new(0.0);
        let fire = Fire { values: &own, place: elsewhere(), density: &none, density_scale: 0.0 };
        let (worst, largest) = worst(&picture, component, |x, y| {
            let (origin, dir) = pixel_ray(view, x, y);
            fire.radiance(origin, dir, |value| 0.5 * value)
        });
        println!("component {component} to {worst:.2e} of {largest:.3}");
        // What a picture of 16 bits holds, and a ray in f32.
        assert!(largest > 0.1 && worst < 1e-3, "{component}: {worst:.2e} of {largest}");
    }
    assert_eq!(picture.count(|pixel| pixel.z != 0.0), 0, "what is negative shines");
    // It hides nothing.
    assert!(picture.count(|pixel| pixel.x > 0.01) > 500);
}

#[gpu_test]
fn surfaces_have_the_colours_of_a_grid_that_stands_otherwise() {
    let tree = level_set::sphere(DVec3::new(0.3, 0.2, -0.1), 15.0);
    let (rise, base) = (DVec3::new(0.008, -0.005, 0.007), 0.5);
    // Trilinear interpolation repeats a ramp; it ends within the picture, where its background begins, and
    // with it the tree's only node.
    let corner = IVec3::new(-40, -40, 12);
    let place = elsewhere() * DAffine3::from_translation(corner.as_dvec3());
    let background = [0.7_f32, 0.0, 0.25];
    let mut colors = Vdb543::new(background);
    for x in -40..40 {
        for y in -40..40 {
            for z in 12..64 {
                let value = (base + rise.dot(DVec3::new(x.into(), y.into(), z.into()))) as f32;
                colors.set(IVec3::new(x, y, z) - corner, [value, 1.0 - value, 0.5 * value]);
            }
        }
    }
    let mut stage = Stage::new();
    for kind in [SURFACE, PackKind::Smooth { iso: 0.0 }] {
        stage.clear();
        let target = stage.target(SIZE);
        let view = looking(Vec3::new(1.0, 1.5, 5.0));
        stage.camera(&target, view);
        let grid = stage.grid(tree.clone(), kind, 0.1);
        let material = VdbMaterial { reflectance: 0.0, ..default() };
        let placed = Transform::from_xyz(0.2, -0.1, 0.0).with_rotation(Quat::from_rotation_z(0.3));
        let ball = stage.world().spawn((VdbVolume(grid), material, placed)).id();
        let sun = Transform::default().looking_to(-view.translation, Vec3::Y);
        stage.world().spawn((DirectionalLight { illuminance: 3.0, ..default() }, sun));
        let white = stage.picture(&target);
        let grid = stage.vectors_at(&colors, place);
        stage.world().entity_mut(ball).insert(VdbColorGrid(grid));
        let picture = stage.picture(&target);
        picture.save(&format!("colored_{kind:?}"));

        let world_from_local = DAffine3::from_rotation_translation(
            placed.rotation.as_dquat(),
            placed.translation.as_dvec3(),
        );
        let index_from_world = (world_from_local * tenths()).inverse();
        let color_from_index = elsewhere().inverse() * tenths();
        let (smooth, voxels) =
            (Smooth::new(&tree, 0.0), Blocky::new(&tree, Occupied::BelowIso(0.0)));
        let (mut inside, mut outside, mut worst) = (0, 0, 0.0_f64);
        for y in 0..SIZE.y {
            for x in 0..SIZE.x {
                let seen = white.at(x, y);
                if seen.x < 0.05 {
                    continue;
                }
                let (origin, dir) = pixel_ray(view, x, y);
                let origin = index_from_world.transform_point3(origin);
                let ray = Ray::from_f64(origin, index_from_world.transform_vector3(dir));
                let t = if kind == SURFACE {
                    voxels.first_voxel(&ray).map(|hit| hit.t)
                } else {
                    smooth.first_root(&ray).map(|hit| hit.t)
                };
                let Some(t) = t else { continue };
                let at = color_from_index.transform_point3(ray.at(t));
                let value = base + rise.dot(at);
                let in_box = at.cmpgt(corner.as_dvec3()).all()
                    && at.cmplt(DVec3::new(39.0, 39.0, 63.0)).all();
                let beyond = at.cmplt(corner.as_dvec3() - 1.0).any()
                    || at.cmpgt(DVec3::new(40.0, 40.0, 64.0)).any();
                let expected = match (in_box, beyond) {
                    (true, _) => DVec3::new(value, 1.0 - value, 0.5 * value),
                    (_, true) => DVec3::from_array(background.map(f64::from)),
                    _ => continue,
                };
                (inside, outside) = (inside + i32::from(in_box), outside + i32::from(beyond));
                let shown = (picture.at(x, y) / seen).truncate().as_dvec3();
                worst = worst.max((shown - expected).abs().max_element());
            }
        }
        println!("{kind:?}: {inside} in the grid, {outside} beyond it, to {worst:.2e}");
        assert!(inside > 200 && outside > 200, "{inside} and {outside} pixels");
        // Two pictures of 16 bits.
        assert!(worst < 2e-3, "{worst}");
    }
}

#[gpu_test]
fn further_grids_are_on_the_gpu_while_something_shown_uses_them() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 5.0));
    let tree = fog::sphere(DVec3::ZERO, 8.0, 3.0);
    let (fog, hot) = (stage.fog_at(&tree, tenths()), stage.fog_at(&tree, elsewhere()));
    let ball = stage.grid(level_set::sphere(DVec3::ZERO, 8.0), SURFACE, 0.1);
    let colors = stage.vectors_at(&map_values(&tree, |v| [v, 1.0, v]), tenths());
    let fire = stage.world().spawn((VdbVolume(fog), VdbEmission::kelvin(hot))).id();
    let ball = stage.world().spawn((VdbVolume(ball), VdbColorGrid(colors))).id();
    let mut grids = || {
        stage.picture(&target);
        stage.world().resource::<VdbGpuUsage>().grids()
    };
    assert_eq!(grids(), 2 + 1 + 1, "one of vectors is one");
    stage.world().entity_mut(fire).remove::<VdbEmission>();
    let mut grids = || {
        stage.picture(&target);
        stage.world().resource::<VdbGpuUsage>().grids()
    };
    assert_eq!(grids(), 2 + 1);
    // What is hidden keeps its own grid, ready to be shown, and no other.
    stage.world().entity_mut(ball).insert(Visibility::Hidden);
    stage.picture(&target);
    assert_eq!(stage.world().resource::<VdbGpuUsage>().grids(), 2);
}
