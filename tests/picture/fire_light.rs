//! Fire that lights its surroundings: against sums over its voxels in f64.

use std::f64::consts::PI;

use bevy::light::PointLightShadowMap;
use bevy::math::{Affine3A, DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::{SIZE, burley, looking, pixel_ray};

/// A flame: taller than wide, and bent.
fn flame() -> Vdb543<f32> {
    let bbox = CoordBox { min: IVec3::new(-8, 0, -8), max: IVec3::new(8, 30, 8) };
    fog::from_densities(bbox, |ijk| {
        let p = ijk.as_dvec3();
        let high = p.y / 30.0;
        let bend = 3.0 * (0.2 * p.y).sin() * high;
        let radius = 6.0 * (0.4 + 2.0 * high).min(1.0) * (1.0 - high).max(0.0).sqrt();
        (1.0 - (p.x - bend).hypot(p.z) / radius.max(0.1)).max(0.0) as f32
    })
}

/// In cd/m² per world unit, for a value of 1.
const COLOR: LinearRgba = LinearRgba { red: 4.0, green: 2.0, blue: 0.5, alpha: 1.0 };

/// What the sources of a flame of scalars shed on a white surface, as seen from somewhere: cd/m². With
/// trilinear interpolation, each voxel has its value and the volume of a voxel.
fn reflected(sources: &[(DVec3, f64)], (at, normal): (DVec3, DVec3), to_viewer: DVec3) -> f64 {
    let of = |(source, intensity): &(DVec3, f64)| {
        let to = *source - at;
        let (distance, to) = (to.length(), to.normalize());
        let illuminance = intensity * normal.dot(to).max(0.0) / (distance * distance);
        illuminance * burley(normal, to_viewer, to, 1.0)
    };
    sources.iter().map(of).sum()
}

/// The voxels that shine, with their places in the scene and their red intensities.
fn sources(tree: &Vdb543<f32>, place: Affine3A) -> Vec<(DVec3, f64)> {
    let place =
        DAffine3::from_mat3_translation(place.matrix3.as_dmat3(), place.translation.as_dvec3());
    let place = place * DAffine3::from_scale(DVec3::splat(0.1));
    let volume = place.matrix3.determinant().abs();
    let shining = tree.active_values().map(|voxel| {
        let intensity = f64::from(COLOR.red) * f64::from(voxel.value) * volume;
        (place.transform_point3(voxel.origin.as_dvec3()), intensity)
    });
    shining.collect()
}

/// A floor below the fire, and a wall beside it.
const FLOOR: (DVec3, DVec3) = (DVec3::new(0.0, -0.9, 0.0), DVec3::Y);
const WALL: (DVec3, DVec3) = (DVec3::new(-1.9, 0.0, 0.0), DVec3::X);

fn view() -> Transform {
    Transform::from_xyz(4.5, 3.6, 7.0).looking_at(Vec3::new(-0.3, 0.7, 0.0), Vec3::Y)
}

impl Stage {
    /// The floor and the wall, white and rough.
    fn floor_and_wall(&mut self) {
        let material = StandardMaterial {
            base_color: Color::WHITE,
            perceptual_roughness: 1.0,
            reflectance: 0.0,
            ..default()
        };
        let material = self.world().resource_mut::<Assets<StandardMaterial>>().add(material);
        for (at, normal) in [FLOOR, WALL] {
            let (at, normal) = (at.as_vec3(), Dir3::new(normal.as_vec3()).unwrap());
            let mesh = Plane3d::new(*normal, Vec2::splat(8.0));
            let mesh = self.world().resource_mut::<Assets<Mesh>>().add(mesh);
            let at = Transform::from_translation(at);
            self.world().spawn((Mesh3d(mesh), MeshMaterial3d(material.clone()), at));
        }
    }

    /// Goes on until the lights of fires are there: those that shine.
    fn lit(&mut self, lights: impl Fn(usize) -> bool) -> Vec<PointLight> {
        for _ in 0..1000 {
            self.update(1);
            let world = self.world();
            let mut all = world.query::<&PointLight>();
            let shine = |light: &PointLight| light.intensity > 0.0;
            let own: Vec<PointLight> = all.iter(world).copied().filter(shine).collect();
            if lights(own.len()) {
                return own;
            }
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        panic!("the lights of the fire never come or go");
    }

    /// Empty smoke that a fire burns in.
    fn no_smoke(&mut self) -> VdbVolume {
        VdbVolume(self.grid(Vdb543::new(0.0), PackKind::Fog, 0.1))
    }
}

/// The floor or the wall that a pixel shows, and whether the box around a ball is in front of it.
fn seen(x: u32, y: u32, ball: (DVec3, f64)) -> Option<((DVec3, DVec3), DVec3)> {
    let (origin, dir) = pixel_ray(view(), x, y);
    let dir = dir.normalize();
    let meets = |(at, normal): (DVec3, DVec3)| (at - origin).dot(normal) / dir.dot(normal);
    let planes = [FLOOR, WALL].map(|plane| (meets(plane), plane));
    let nearest = planes.into_iter().filter(|(t, _)| *t > 0.0).min_by(|a, b| a.0.total_cmp(&b.0));
    let (t, (_, normal)) = nearest?;
    let along = (ball.0 - origin).dot(dir);
    let is_hidden = (origin + dir * along).distance(ball.0) < ball.1;
    (!is_hidden).then_some(((origin + dir * t, normal), dir))
}

/// The errors of a picture's floor and wall, where they are farther from the fire than half its radius and
/// near enough to see much of it: the largest, the mean, the mean ratio, and the number of pixels.
fn errors(
    picture: &Picture,
    sources: &[(DVec3, f64)],
    (far, ball): (f64, (DVec3, f64)),
    visible: f64,
) -> (f64, f64, f64, u32) {
    let (mut worst, mut sum, mut ratio, mut count) = (0.0_f64, 0.0, 0.0, 0);
    for y in (0..SIZE.y).step_by(2) {
        for x in (0..SIZE.x).step_by(2) {
            let Some((at, dir)) = seen(x, y, ball) else { continue };
            let distance = |(source, _): &(DVec3, f64)| source.distance_squared(at.0);
            let nearest = sources.iter().map(distance).fold(f64::INFINITY, f64::min).sqrt();
            // Pixels of the edge between both show some of each.
            let at_edge = (at.0.y - FLOOR.0.y).max(at.0.x - WALL.0.x) < 0.15;
            if nearest < far || nearest > 4.0 || at_edge {
                continue;
            }
            let exact = visible * reflected(sources, at, -dir);
            let share = f64::from(picture.at(x, y).x) / exact;
            worst = worst.max((share - 1.0).abs());
            sum += (share - 1.0).abs();
            ratio += share;
            count += 1;
        }
    }
    (worst, sum / f64::from(count), ratio / f64::from(count), count)
}

#[gpu_test]
fn fire_lights_a_floor_and_a_wall_as_the_sum_over_its_voxels() {
    let tree = flame();
    let mut stage = Stage::new();
    // The second one is turned, stretched, and larger than the first.
    let turned = Transform {
        translation: Vec3::new(0.1, -0.3, 0.3),
        rotation: Quat::from_euler(EulerRot::XYZ, 0.2, 0.5, -0.3),
        scale: Vec3::new(0.7, 1.2, -0.9),
    };
    for (name, place) in [("straight", Transform::from_xyz(0.0, -0.2, 0.0)), ("turned", turned)] {
        stage.clear();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, view());
        stage.floor_and_wall();
        let (smoke, grid) = (stage.no_smoke(), stage.grid(tree.clone(), PackKind::Fog, 0.1));
        let emission = VdbEmission::Scalar { grid, color: COLOR };
        // The end of the range is far away.
        let light = VdbEmissionLight { min_illuminance: 1e-4, ..default() };
        stage.world().spawn((smoke, emission, light, place));
        let lights = stage.lit(|count| count > 0);
        stage.picture(&target).save(&format!("fire_{name}"));
        // Without the fire in the picture.
        stage.world().entity_mut(camera).insert(VdbCamera { enabled: false, ..default() });
        let picture = stage.picture(&target);
        picture.save(&format!("fire_light_{name}"));
        let sources = sources(&tree, place.compute_affine());
        let radius = 0.6 * f64::from(place.scale.x.max(place.scale.y));
        let nothing = (DVec3::ZERO, -1.0);
        let far = (0.5 * radius, nothing);
        let (worst, mean, ratio, count) = errors(&picture, &sources, far, 1.0);
        println!(
            "{name}: {} lights, {count} pixels: {worst:.3}, mean {mean:.4}, ratio {ratio:.4}",
            lights.len()
        );
        assert!(count > 300, "{count} pixels");
        // What is promised, and the power itself.
        assert!(worst < 0.1 && (ratio - 1.0).abs() < 0.03, "{name}: {worst} {ratio}");
    }
}

/// In a ball of black smoke around it, fire is as dim as its transmittance says, which shadow maps say, too.
#[gpu_test]
#[ignore = "slow: smoke by rays"]
fn smoke_around_a_fire_dims_its_light() {
    let tree = fog::sphere(DVec3::ZERO, 3.0, 2.0);
    let smoke = fog::sphere(DVec3::ZERO, 8.0, 1.0);
    // To the middle of the rim.
    let (radius, extinction) = (0.75, 1.0);
    let mut stage = Stage::new();
    // Every texel of six faces sends a ray.
    stage.world().insert_resource(PointLightShadowMap { size: 64 });
    for shadows in [false, true] {
        stage.clear();
        let target = stage.target(SIZE);
        stage.camera(&target, view());
        stage.floor_and_wall();
        let grid = stage.grid(tree.clone(), PackKind::Fog, 0.1);
        let volume = VdbVolume(stage.grid(smoke.clone(), PackKind::Fog, 0.1));
        let material =
            VdbMaterial { base_color: Color::BLACK, density_scale: extinction, ..default() };
        let emission = VdbEmission::Scalar { grid, color: COLOR };
        let light = VdbEmissionLight { min_illuminance: 1e-4, shadows, ..default() };
        stage.world().spawn((volume, material, emission, light));
        stage.lit(|count| count > 0);
        let picture = stage.picture(&target);
        picture.save(&format!("fire_in_smoke_shadows_{shadows}"));
        let sources = sources(&tree, Affine3A::IDENTITY);
        let visible = (-f64::from(extinction) * radius).exp();
        let ball = (0.1, (DVec3::ZERO, 0.9));
        let (worst, mean, ratio, count) = errors(&picture, &sources, ball, visible);
        println!("shadows {shadows}: {count} pixels: {worst:.3}, mean {mean:.4}, ratio {ratio:.4}");
        assert!(count > 300, "{count} pixels");
        // Shadow maps are exact in the mean only, and small ones full of grain. They begin a little way
        // from the lights.
        let tolerance = if shadows { 0.1 } else { 0.02 };
        assert!((ratio - 1.0).abs() < tolerance, "{shadows}: {ratio}");
        assert!(shadows || worst < 0.1, "{worst}");
    }
}

/// A metal that reflects by rays shows the flames, and not the highlights of their lights as well.
#[gpu_test]
#[ignore = "slow: each roughness, with and without reflections"]
fn metals_reflect_a_fire_once() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, view());
    let (smoke, grid) = (stage.no_smoke(), stage.grid(flame(), PackKind::Fog, 0.1));
    let fire = stage.world().spawn((smoke, VdbEmission::Scalar { grid, color: COLOR })).id();
    let slab = level_set::cuboid(DVec3::new(-40.0, -20.0, -40.0), DVec3::new(40.0, -9.0, 40.0));
    let slab = VdbVolume(stage.grid(slab, PackKind::Smooth { iso: 0.0 }, 0.1));
    let slab = stage.world().spawn(slab).id();
    for perceptual_roughness in [0.0, 0.5] {
        let metal = VdbMaterial { metallic: 1.0, perceptual_roughness, ..default() };
        stage.world().entity_mut(slab).insert(metal);
        for reflections in [0, 1] {
            // Denoised reflections change from frame to frame.
            let quality = VdbQuality { reflections, denoise: false, ..default() };
            stage.world().entity_mut(camera).insert(quality);
            stage.world().entity_mut(fire).remove::<VdbEmissionLight>();
            let alone = stage.picture(&target);
            alone.save(&format!("fire_in_metal_alone_{perceptual_roughness}_{reflections}"));
            let light = VdbEmissionLight { min_illuminance: 1e-4, ..default() };
            stage.world().entity_mut(fire).insert(light);
            stage.lit(|count| count > 0);
            let picture = stage.picture(&target);
            picture.save(&format!("fire_in_metal_{perceptual_roughness}_{reflections}"));
            let added = |(a, b): (&Vec4, &Vec4)| (*a - *b).truncate().max_element();
            let added = picture.pixels.iter().zip(&alone.pixels).map(added).fold(0.0, f32::max);
            println!("roughness {perceptual_roughness}, {reflections} reflections: {added} more");
            // Without reflections there are highlights.
            assert!(if reflections > 0 { added < 1e-3 } else { added > 0.05 }, "{added}");
        }
    }
}

/// Until the light of a fire has been computed, a dark one takes its place, for which pipelines are compiled.
#[gpu_test]
fn a_dark_light_comes_before_that_of_a_fire() {
    let mut stage = Stage::new();
    let (smoke, grid) = (stage.no_smoke(), stage.grid(flame(), PackKind::Fog, 0.1));
    let emission = VdbEmission::Scalar { grid, color: COLOR };
    stage.world().spawn((smoke, emission, VdbEmissionLight::default()));
    let lights = |stage: &mut Stage| -> Vec<f32> {
        let mut all = stage.world().query::<&PointLight>();
        all.iter(stage.world()).map(|light| light.intensity).collect()
    };
    stage.update(1);
    assert_eq!(lights(&mut stage), [0.0]);
    stage.lit(|count| count > 0);
    let shining = lights(&mut stage);
    assert!(shining.iter().all(|intensity| *intensity > 0.0), "{shining:?}");
}

fn power(lights: &[PointLight]) -> f32 {
    lights.iter().map(|light| light.intensity).sum()
}

#[gpu_test]
fn lights_come_change_and_go_with_their_fire() {
    let mut stage = Stage::new();
    let (smoke, grid) = (stage.no_smoke(), stage.grid(flame(), PackKind::Fog, 0.1));
    let emission = |grid: &Handle<VdbGrid>, color: LinearRgba| VdbEmission::Scalar {
        grid: grid.clone(),
        color,
    };
    let burning = (smoke.clone(), emission(&grid, COLOR));
    let fire = stage.world().spawn(burning.clone()).id();
    stage.update(30);
    assert!(stage.lit(|_| true).is_empty(), "a fire has lights that nobody asked for");
    stage.world().entity_mut(fire).insert(VdbEmissionLight::default());
    let first = power(&stage.lit(|count| count > 0));
    let near = |own: f32, expected: f32| {
        assert!((own / expected - 1.0).abs() < 1e-3, "{own} instead of {expected}");
    };
    // In lumens: 4π times the intensity of all voxels.
    let voxels: f32 = flame().active_values().map(|voxel| voxel.value).sum();
    let luminance = 0.2126 * COLOR.red + 0.7152 * COLOR.green + 0.0722 * COLOR.blue;
    near(first, 4.0 * PI as f32 * luminance * voxels * 1e-3);
    // What needs no look at the grid changes in the same frame.
    let mut now = |change: &dyn Fn(&mut EntityWorldMut)| {
        change(&mut stage.world().entity_mut(fire));
        stage.update(1);
        power(&stage.lit(|_| true))
    };
    near(now(&|fire| _ = fire.insert(emission(&grid, COLOR * 2.0))), 2.0 * first);
    near(now(&|fire| _ = fire.insert(Transform::from_scale(Vec3::splat(2.0)))), 16.0 * first);
    let half = VdbEmissionLight { intensity: 0.5, max_lights: 1, ..default() };
    near(now(&|fire| _ = fire.insert(half.clone())), 8.0 * first);
    assert_eq!(stage.lit(|_| true).len(), 1);
    let mut grids = stage.world().resource_mut::<Assets<VdbGrid>>();
    grids.get_mut(&grid).unwrap().edit(|voxels| voxels.set(IVec3::new(100, 3, 3), 1e4)).unwrap();
    for _ in 0..500 {
        stage.update(1);
        if power(&stage.lit(|_| true)) > 9.0 * first {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    assert!(power(&stage.lit(|_| true)) > 9.0 * first, "an edit changes nothing");
    // Whatever it needs goes; its lights go with it, and come back.
    stage.world().entity_mut(fire).remove::<VdbEmission>();
    stage.update(1);
    assert_eq!(stage.lit(|_| true).len(), 0);
    stage.world().entity_mut(fire).insert(emission(&grid, COLOR));
    stage.lit(|count| count == 1);
    stage.world().entity_mut(fire).remove::<VdbEmissionLight>();
    stage.update(1);
    assert_eq!(stage.lit(|_| true).len(), 0);
    stage.world().entity_mut(fire).insert(half);
    stage.lit(|count| count == 1);
    stage.world().despawn(fire);
    stage.update(1);
    assert_eq!(stage.lit(|_| true).len(), 0);
}

/// In a lamp with a radius, as in a fire, fog is lit like in a ball of light, without a glare in the middle.
#[gpu_test]
fn fog_in_a_lamp_with_a_radius_has_no_glare() {
    let mut stage = Stage::new();
    let fog = stage.cube_of_fog(10, 0.1);
    for quality in [VdbQuality::EXACT, VdbQuality::HIGH] {
        for radius in [0.0, 0.6_f32] {
            stage.clear();
            let target = stage.target(SIZE);
            let from = looking(Vec3::Z * 8.0);
            let camera = stage.camera(&target, from);
            stage.world().entity_mut(camera).insert(quality);
            let density_scale = 0.01;
            let thin = VdbMaterial { density_scale, ..default() };
            stage.world().spawn((VdbVolume(fog.clone()), thin));
            let candela = 100.0;
            let lamp = PointLight {
                intensity: 4.0 * PI as f32 * candela,
                range: 1e4,
                radius,
                ..default()
            };
            stage.world().spawn((lamp, Transform::default()));
            let pixel = stage.picture(&target).center();
            let (origin, dir) = pixel_ray(from, SIZE.x / 2, SIZE.y / 2);
            let across = origin.cross(dir.normalize()).length();
            let soft = (across * across + f64::from(radius * radius) / 3.0).sqrt();
            // Half a voxel to the low side, as samples are points.
            let integral = ((0.95 / soft).atan() + (1.05 / soft).atan()) / soft;
            let expected = f64::from(density_scale * candela) / (4.0 * PI) * integral;
            println!("radius {radius}: {} for {expected}", pixel.x);
            // Single points of a lamp's light stand for a part of the ray.
            assert!((f64::from(pixel.x) / expected - 1.0).abs() < 0.05, "{radius}: {pixel}");
        }
    }
}
