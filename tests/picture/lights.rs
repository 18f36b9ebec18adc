//! The same under all lights as a mesh of the same material.

mod lit_fog;
mod probes;

use std::f64::consts::PI;

use bevy::light::EnvironmentMapLight;
use bevy::math::{DVec2, DVec3};
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbRenderMode, VdbSun, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::phase;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{SIZE, looking, pixel_ray};

const RADIUS: f32 = 2.0;

/// A ball of a level set and a ball of triangles in the same place, of one material.
struct Pair {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
    volume: Entity,
    mesh: Entity,
}

impl Pair {
    fn new(material: VdbMaterial) -> Self {
        Self::with(Stage::new(), material)
    }

    fn with(mut stage: Stage, material: VdbMaterial) -> Self {
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::new(1.0, 2.0, 6.0)));
        // Fine, so that normals are off by less than sharp highlights show.
        let voxel = 0.02;
        let tree = level_set::sphere(DVec3::ZERO, f64::from(RADIUS) / voxel);
        let grid = stage.grid(tree, PackKind::Smooth { iso: 0.0 }, voxel);
        let world = stage.world();
        let volume = world.spawn(VdbVolume(grid)).id();
        let mesh = Sphere::new(RADIUS).mesh().uv(256, 128);
        let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
        let mesh = world.spawn(Mesh3d(mesh)).id();
        let mut pair = Self { stage, target, camera, volume, mesh };
        pair.be_of(material);
        pair
    }

    /// Gives both the same material.
    fn be_of(&mut self, material: VdbMaterial) {
        let standard = StandardMaterial {
            base_color: material.base_color,
            perceptual_roughness: material.perceptual_roughness,
            metallic: material.metallic,
            reflectance: material.reflectance,
            ..default()
        };
        let world = self.stage.world();
        let standard = world.resource_mut::<Assets<StandardMaterial>>().add(standard);
        world.entity_mut(self.volume).insert(material);
        world.entity_mut(self.mesh).insert(MeshMaterial3d(standard));
    }

    fn show(&mut self, volume: bool) -> Picture {
        let visible = |on| if on { Visibility::Visible } else { Visibility::Hidden };
        self.stage.world().entity_mut(self.volume).insert(visible(volume));
        self.stage.world().entity_mut(self.mesh).insert(visible(!volume));
        self.stage.picture(&self.target)
    }

    /// Asserts that both look the same.
    fn compare(&mut self, name: &str) {
        // Bevy makes room for the lists of lights a few frames after it was short of it.
        self.stage.update(8);
        let (volume, mesh) = (self.show(true), self.show(false));
        volume.save(&format!("light_{name}_volume"));
        mesh.save(&format!("light_{name}_mesh"));
        let brightest = mesh.pixels.iter().map(|p| p.truncate().max_element()).fold(0.0, f32::max);
        assert!(brightest > 0.01, "{name}: the mesh is black");
        // Not where only one of them covers the pixel.
        let pairs: Vec<_> = volume
            .pixels
            .iter()
            .zip(&mesh.pixels)
            .map(|(a, b)| (a.truncate(), b.truncate()))
            .filter(|(a, b)| *a != Vec3::ZERO && *b != Vec3::ZERO)
            .collect();
        assert!(pairs.len() > 200, "{name}: {} pixels", pairs.len());
        let sum = |of: fn(&(Vec3, Vec3)) -> Vec3| pairs.iter().map(of).sum::<Vec3>();
        let ratio = sum(|pair| pair.0) / sum(|pair| pair.1);
        let off = |(a, b): &&(Vec3, Vec3)| (*a - *b).abs().max_element() > 0.02 * brightest;
        let differ = pairs.iter().filter(off).count();
        println!("{name}: {} pixels, brightness {ratio}, {differ} off by 2 %", pairs.len());
        assert!((ratio - 1.0).abs().max_element() < 0.02, "{name}: {ratio} times as bright");
        assert!(differ * 100 < pairs.len(), "{name}: {differ} of {} pixels", pairs.len());
    }
}

fn sun() -> impl Bundle {
    let light =
        DirectionalLight { illuminance: 5.0, color: Color::linear_rgb(1.0, 0.9, 0.7), ..default() };
    (light, looking(Vec3::new(3.0, 2.0, 2.0)))
}

fn point() -> impl Bundle {
    let light = PointLight { intensity: 300.0, range: 15.0, radius: 0.2, ..default() };
    (light, Transform::from_xyz(-3.0, 1.0, 3.0))
}

fn spot() -> impl Bundle {
    // Its cone ends on the ball.
    let light = SpotLight { intensity: 500.0, outer_angle: 0.3, inner_angle: 0.1, ..default() };
    (light, looking(Vec3::new(1.0, -3.0, 4.0)))
}

/// A rectangle near the ball, which sees it in part.
fn rectangle() -> impl Bundle {
    let light = RectLight { intensity: 200.0, width: 2.5, height: 0.5, range: 15.0, ..default() };
    (light, looking(Vec3::new(3.0, 1.5, 3.0)))
}

fn sky(world: &mut World) -> EnvironmentMapLight {
    let mut images = world.resource_mut::<Assets<Image>>();
    let [top, middle, bottom] = [[0.3, 0.5, 1.0], [0.6, 0.6, 0.6], [0.4, 0.2, 0.1]]
        .map(|[r, g, b]| Color::linear_rgb(r, g, b));
    let map = EnvironmentMapLight::hemispherical_gradient(&mut images, top, middle, bottom);
    EnvironmentMapLight { intensity: 0.8, ..map }
}

#[gpu_test]
fn under_each_light_a_ball_looks_as_one_of_triangles_does() {
    let mut pair = Pair::new(VdbMaterial::default());
    let mut under = |name: &str, spawn: &dyn Fn(&mut World) -> Entity| {
        let light = spawn(pair.stage.world());
        pair.compare(name);
        pair.stage.world().despawn(light);
    };
    under("directional", &|world| world.spawn(sun()).id());
    under("point", &|world| world.spawn(point()).id());
    under("spot", &|world| world.spawn(spot()).id());
    under("rectangle", &|world| world.spawn(rectangle()).id());
    let ambient =
        AmbientLight { brightness: 0.6, color: Color::linear_rgb(1.0, 0.5, 0.2), ..default() };
    pair.stage.world().entity_mut(pair.camera).insert(ambient);
    pair.compare("ambient");
    let map = sky(pair.stage.world());
    pair.stage.world().entity_mut(pair.camera).remove::<AmbientLight>().insert(map);
    pair.compare("environment");
}

#[gpu_test]
fn of_each_material_a_ball_looks_as_one_of_triangles_does() {
    let base_color = Color::linear_rgb(0.9, 0.6, 0.2);
    let mut pair = Pair::new(VdbMaterial::default());
    let map = sky(pair.stage.world());
    let camera = pair.camera;
    let world = pair.stage.world();
    world.spawn(sun());
    world.spawn(sun()).insert(looking(Vec3::new(-1.0, 4.0, 0.0)));
    world.spawn(point());
    world.spawn(spot());
    world.spawn(rectangle());
    world.entity_mut(camera).insert((map, AmbientLight { brightness: 0.1, ..default() }));
    for (perceptual_roughness, metallic, reflectance) in
        [(0.3, 1.0, 0.5), (0.4, 0.4, 0.8), (1.0, 0.0, 0.0)]
    {
        pair.be_of(VdbMaterial {
            base_color,
            perceptual_roughness,
            metallic,
            reflectance,
            ..default()
        });
        pair.compare(&format!("all_{perceptual_roughness}_{metallic}_{reflectance}"));
    }
}

/// The two parts of the picture are all of it, and a sun's factor goes for its light alone.
#[gpu_test]
fn parts_of_the_light_add_up() {
    let mut pair = Pair::new(VdbMaterial { metallic: 0.3, perceptual_roughness: 0.4, ..default() });
    let (camera, map) = (pair.camera, sky(pair.stage.world()));
    let world = pair.stage.world();
    let light = world.spawn(sun()).id();
    world.spawn(point());
    world.spawn(rectangle());
    world.entity_mut(camera).insert((map, AmbientLight { brightness: 0.1, ..default() }));
    let mut show = |mode| {
        pair.stage.world().entity_mut(camera).insert(VdbCamera { mode, ..default() });
        let picture = pair.show(true);
        picture.save(&format!("part_{mode:?}"));
        picture
    };
    let parts = [VdbRenderMode::Diffuse, VdbRenderMode::Glossy].map(&mut show);
    let lit = show(VdbRenderMode::Lit);
    let [diffuse, glossy] = parts.each_ref().map(|part| part.count(|p| p.max_element() > 0.02));
    assert!(diffuse > 500 && glossy > 500, "{diffuse} diffuse pixels, {glossy} glossy ones");
    for ((lit, diffuse), glossy) in lit.pixels.iter().zip(&parts[0].pixels).zip(&parts[1].pixels) {
        let sum = (diffuse + glossy).truncate();
        // Three numbers of 16-bit floats.
        assert!(
            (lit.truncate() - sum).abs().max_element() <= 2e-3 * sum.max_element(),
            "{lit} {sum}"
        );
    }

    let mut sum_with = |intensity: f32| {
        pair.stage.world().entity_mut(light).insert(VdbSun { intensity, ..default() });
        pair.show(true).pixels.iter().map(|p| p.truncate().as_dvec3()).sum::<DVec3>()
    };
    let [none, once, thrice] = [0.0, 1.0, 3.0].map(&mut sum_with);
    let factor = (thrice - none) / (once - none);
    assert!((factor - 3.0).abs().max_element() < 0.01, "three times the sun is {factor}");
    assert!(none.min_element() > 0.1 * once.min_element(), "the other lights are left");
}
