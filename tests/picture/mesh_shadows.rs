//! Shadows of volumes on meshes, where the reference tracer and closed forms say that they are.

use bevy::camera::Hdr;
use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass};
use bevy::light::{
    CascadeShadowConfigBuilder, Cascades, DirectionalLightShadowMap, NotShadowCaster,
    NotShadowReceiver, PointLightShadowMap,
};
use bevy::math::DVec3;
use bevy::pbr::DefaultOpaqueRendererMethod;
use bevy::prelude::*;
use bevy::render::render_resource::PipelineCache;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Blocky, Occupied, Ray, Smooth};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking, pixel_ray};

pub(super) const VOXEL: f64 = 0.1;
/// Where the ball is.
const CENTER: DVec3 = DVec3::new(0.3, 2.0, -0.2);
const RADIUS: f64 = 1.0;

/// A white mesh in the plane y = 0, seen from a place above.
pub(super) struct Scene {
    pub stage: Stage,
    target: Handle<Image>,
    pub camera: Entity,
    view: Transform,
    pub plane: Entity,
}

impl Scene {
    pub fn new(from: Vec3) -> Self {
        Self::on(Stage::new(), from)
    }

    /// In an app that may have shown another scene, and need not compile its pipelines again.
    pub fn on(mut stage: Stage, from: Vec3) -> Self {
        stage.clear();
        stage.world().insert_resource(DirectionalLightShadowMap { size: 1024 });
        stage.world().insert_resource(PointLightShadowMap { size: 512 });
        let target = stage.target(SIZE);
        let view = looking(from);
        let camera = stage.camera(&target, view);
        let plane = stage.matt_plane(40.0, 0.0);
        Self { stage, target, camera, view, plane }
    }

    pub fn picture(&mut self, name: &str) -> Picture {
        let picture = self.stage.picture(&self.target);
        picture.save(&format!("mesh_shadows_{name}"));
        picture
    }

    pub fn volume(&mut self, tree: Vdb543<f32>, kind: PackKind, material: VdbMaterial) -> Entity {
        let grid = self.stage.grid(tree, kind, VOXEL);
        self.stage.world().spawn((VdbVolume(grid), material)).id()
    }

    /// The place of the plane that a pixel shows, if it is in the middle of it.
    pub fn place(&self, x: u32, y: u32) -> Option<DVec3> {
        self.place_at(0.0, x, y)
    }

    /// The same if the plane is at another height.
    pub fn place_at(&self, height: f64, x: u32, y: u32) -> Option<DVec3> {
        let (origin, dir) = pixel_ray(self.view, x, y);
        let at = origin + dir * ((height - origin.y) / dir.y);
        (dir.y < 0.0 && at.length() < 5.0).then_some(at)
    }

    /// What a texel of the largest cascade of a sun covers, in world units.
    fn cascade_texel(&mut self, light: Entity) -> Option<f64> {
        let cascades = self.stage.world().get::<Cascades>(light)?;
        cascades.cascades.get(&self.camera)?.last().map(|last| f64::from(last.texel_size))
    }

    fn hides(&self, center: DVec3, radius: f64, x: u32, y: u32) -> bool {
        let (origin, dir) = pixel_ray(self.view, x, y);
        distance_from_line(origin, dir, center) < radius
    }
}

pub(super) fn sun(to_sun: Vec3) -> impl Bundle {
    let cascades =
        CascadeShadowConfigBuilder { num_cascades: 2, maximum_distance: 15.0, ..default() };
    let light = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    (light, cascades.build(), looking(to_sun))
}

const TO_SUN: Vec3 = Vec3::new(0.5, 1.0, 0.3);
pub(super) const BULB: Vec3 = Vec3::new(1.0, 6.0, 0.7);

pub(super) fn bulb() -> impl Bundle {
    let lamp =
        PointLight { intensity: 900.0, range: 100.0, shadow_maps_enabled: true, ..default() };
    (lamp, Transform::from_translation(BULB))
}

pub(super) fn spot() -> impl Bundle {
    let lamp = SpotLight {
        intensity: 900.0,
        range: 100.0,
        outer_angle: 1.2,
        inner_angle: 1.1,
        shadow_maps_enabled: true,
        ..default()
    };
    (lamp, Transform::from_translation(BULB).looking_at(Vec3::ZERO, Vec3::X))
}

/// What is blocked of a ray from a place to a light, by the reference.
type Blocks<'a> = &'a dyn Fn(DVec3, DVec3) -> bool;

/// The distance of a point from the line through `origin` along `dir`.
fn distance_from_line(origin: DVec3, dir: DVec3, point: DVec3) -> f64 {
    (point - origin).reject_from(dir).length()
}

/// Whether the ball blocks a ray. The reference is slow, so it traces only rays that pass within two voxels of
/// the surface; geometry decides all others.
fn blocked_by_ball(at: DVec3, way: DVec3, reference: impl Fn(&Ray) -> bool) -> bool {
    let distance = distance_from_line(at, way, CENTER);
    if (distance - RADIUS).abs() > 2.0 * VOXEL {
        return distance < RADIUS && (CENTER - at).dot(way) > 0.0;
    }
    reference(&Ray::from_f64(at / VOXEL, way / VOXEL))
}

/// Holds what is left of the light on the plane against the oracle. `texel` is what a texel of the
/// shadow map covers: Bevy smooths over three of them to each side, and moves what is lit by two.
fn compare(
    scene: &Scene,
    (with, without): (&Picture, &Picture),
    to_light: &dyn Fn(DVec3) -> DVec3,
    blocks: Blocks,
    texel: f64,
) {
    let (mut lit, mut dark, mut edges, mut wrong) = (0, 0, 0, 0);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let Some(at) = scene.place(x, y) else { continue };
            let full = without.at(x, y).x;
            if full < 1e-3 || scene.hides(CENTER, RADIUS + 2.0 * VOXEL, x, y) {
                continue;
            }
            let blocked = |by: DVec3| {
                let at = at + by;
                blocks(at, to_light(at))
            };
            let around: Vec<bool> = (0..16)
                .map(|i| {
                    let angle = f64::from(i) * std::f64::consts::TAU / 16.0;
                    blocked(DVec3::new(angle.cos(), 0.0, angle.sin()) * 6.0 * texel)
                })
                .chain([blocked(DVec3::ZERO)])
                .collect();
            let part = with.at(x, y).x / full;
            if around.iter().all(|&is_dark| is_dark) {
                dark += 1;
                wrong += usize::from(part > 0.01);
            } else if !around.iter().any(|&is_dark| is_dark) {
                lit += 1;
                wrong += usize::from((part - 1.0).abs() > 0.01);
            } else {
                edges += 1;
            }
        }
    }
    println!("{lit} pixels lit, {dark} in the shadow, {edges} at its edge, {wrong} wrong");
    assert!(lit > 500 && dark > 80 && edges < 2 * dark, "{lit} lit, {dark} dark, {edges} edges");
    assert_eq!(wrong, 0, "pixels are lit that should not be, or the other way round");
}

#[gpu_test]
#[ignore = "slow: each kind of surface under each light"]
fn a_ball_throws_its_shadow_on_a_mesh() {
    let tree = level_set::sphere(CENTER / VOXEL, RADIUS / VOXEL);
    let smooth = Smooth::new(&tree, 0.0);
    let voxels = Blocky::new(&tree, Occupied::BelowIso(0.0));
    let by_smooth = |at, way| blocked_by_ball(at, way, |ray| smooth.first_root(ray).is_some());
    let by_voxels = |at, way| blocked_by_ball(at, way, |ray| voxels.first_voxel(ray).is_some());
    let kinds: [(&str, PackKind, Blocks); 2] =
        [("smooth", PackKind::Smooth { iso: 0.0 }, &by_smooth), ("voxels", SURFACE, &by_voxels)];
    let mut stage = Stage::new();
    for (name, kind, blocks) in kinds {
        let mut scene = Scene::on(stage, Vec3::new(-2.0, 7.0, 5.0));
        let lights: [(&str, &dyn Fn(&mut World) -> Entity, f64); 3] = [
            ("sun", &|world| world.spawn(sun(TO_SUN)).id(), 0.0),
            // What a lamp sees of a floor 7 units away, at the edge of a map of a right angle.
            ("bulb", &|world| world.spawn(bulb()).id(), 14.0 / 512.0),
            ("spot", &|world| world.spawn(spot()).id(), 14.0 * 2.6 / 1024.0),
        ];
        // One light is enough to see what another surface throws.
        let lights = &lights[..if kind == SURFACE { 1 } else { 3 }];
        for (light_name, light, texel) in lights {
            let light = light(scene.stage.world());
            let without = scene.picture(&format!("{light_name}_alone"));
            let texel = scene.cascade_texel(light).unwrap_or(*texel);
            let ball = scene.volume(tree.clone(), kind, VdbMaterial::default());
            let with = scene.picture(&format!("{light_name}_{name}"));
            print!("{name}, {light_name}: ");
            let to_light = |at: DVec3| match *light_name {
                "sun" => TO_SUN.as_dvec3(),
                _ => BULB.as_dvec3() - at,
            };
            compare(&scene, (&with, &without), &to_light, blocks, texel);
            scene.stage.world().despawn(ball);
            scene.stage.world().despawn(light);
        }
        stage = scene.stage;
    }
}

/// The plane is in the shadow by whatever path it is drawn, and the ball looks as it does without a map.
#[gpu_test]
#[ignore = "slow: the pipelines of each way to draw"]
fn the_shadow_is_there_however_a_camera_draws() {
    let tree = level_set::sphere(CENTER / VOXEL, RADIUS / VOXEL);
    let smooth = Smooth::new(&tree, 0.0);
    let blocks = |at, way| blocked_by_ball(at, way, |ray| smooth.first_root(ray).is_some());
    let mut stage = Stage::new();
    for way in ["plain", "msaa", "ldr", "deferred"] {
        let mut scene = Scene::on(stage, Vec3::new(-2.0, 7.0, 5.0));
        let world = scene.stage.world();
        let light = world.spawn(sun(TO_SUN)).id();
        match way {
            "msaa" => _ = world.entity_mut(scene.camera).insert(Msaa::Sample4),
            "ldr" => _ = world.entity_mut(scene.camera).remove::<Hdr>(),
            "deferred" => {
                world.insert_resource(DefaultOpaqueRendererMethod::deferred());
                world.entity_mut(scene.camera).insert((DepthPrepass, DeferredPrepass));
            }
            _ => {}
        }
        let without = scene.picture(&format!("{way}_alone"));
        scene.volume(tree.clone(), PackKind::Smooth { iso: 0.0 }, VdbMaterial::default());
        let with = scene.picture(way);
        print!("{way}: ");
        let to_sun = |_| TO_SUN.as_dvec3();
        let texel = scene.cascade_texel(light).expect("a sun has cascades");
        compare(&scene, (&with, &without), &to_sun, &blocks, texel);

        // For volumes, the maps are as meshes have them.
        let settings = VdbCamera { mesh_shadows: false, ..default() };
        scene.stage.world().entity_mut(scene.camera).insert(settings);
        let off = scene.picture(&format!("{way}_off"));
        let (mut on_ball, mut on_plane) = (0, 0);
        for y in 0..SIZE.y {
            for x in 0..SIZE.x {
                if scene.hides(CENTER, RADIUS - VOXEL, x, y) {
                    on_ball += 1;
                    let difference = (with.at(x, y) - off.at(x, y)).abs().max_element();
                    assert!(difference < 1e-3, "{way}: at {x}, {y} of the ball, {difference}");
                } else if !scene.hides(CENTER, RADIUS + VOXEL, x, y) && scene.place(x, y).is_some()
                {
                    on_plane += 1;
                    assert_eq!(off.at(x, y), without.at(x, y), "{way}: at {x}, {y}, switched off");
                }
            }
        }
        assert!(on_ball > 100 && on_plane > 1000, "{on_ball} of the ball, {on_plane} of the plane");
        stage = scene.stage;
    }
}

/// e^-τ of the light comes through a fog, and all of what comes from elsewhere.
#[gpu_test]
fn fog_dims_the_light_on_a_mesh() {
    let to_sun = Vec3::new(0.0, 4.0, -1.0).normalize();
    let ambient = AmbientLight { brightness: 0.5, ..default() };
    let mut stage = Stage::new();
    for (with_ambient, scales) in [(false, &[0.1_f32, 0.5, 2.0][..]), (true, &[0.5])] {
        let mut scene = Scene::on(stage, Vec3::new(0.0, 2.0, 4.0));
        scene.stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
        if with_ambient {
            scene.stage.world().entity_mut(scene.camera).insert(ambient.clone());
        }
        let around = scene.picture("fog_ambient").center().x;
        assert_eq!(around > 0.0, with_ambient, "{around}");
        scene.stage.world().spawn(sun(to_sun));
        let bright = scene.picture("fog_none");
        // Whole between y = 2.95 and 4.05; above and below, its density falls to nothing over a voxel.
        let layer = CoordBox { min: IVec3::new(-60, 30, -90), max: IVec3::new(59, 40, 59) };
        for &scale in scales {
            let black = VdbMaterial { base_color: Color::BLACK, density_scale: scale, ..default() };
            let volume = scene.volume(fog::block(layer, 1.0), PackKind::Fog, black);
            let picture = scene.picture(&format!("fog_{scale}_{with_ambient}"));
            let expected = (-f64::from(scale) * 1.1 / f64::from(to_sun.y)).exp();
            let (mut sum, mut count, mut worst) = (0.0, 0.0, 0.0_f64);
            for y in SIZE.y / 2..SIZE.y {
                for x in 20..SIZE.x - 20 {
                    let direct = bright.at(x, y).x - around;
                    let part = f64::from((picture.at(x, y).x - around) / direct);
                    sum += part;
                    count += 1.0;
                    worst = worst.max((part - expected).abs());
                }
            }
            let mean: f64 = sum / count;
            println!(
                "scale {scale}, ambient {with_ambient}: {mean:.4} of the light comes through, \
                 {expected:.4} expected, {worst:.4} off at worst"
            );
            // Half a 64th, and what 16-bit floats hold.
            assert!((mean - expected).abs() < 0.5 / 64.0 + 2e-3, "{mean}, not {expected}");
            // The most that a texel weighs in Bevy's smoothing: four twelfths of each axis.
            assert!(worst < 1.0 / 9.0, "{worst} off");
            scene.stage.world().despawn(volume);
        }
        stage = scene.stage;
    }
}

pub(super) fn pipelines(stage: &mut Stage, label: &str) -> usize {
    let render = stage.app.sub_app(bevy::render::RenderApp).world();
    let all = render.resource::<PipelineCache>().pipelines();
    let own = all.filter(|pipeline| {
        use bevy::render::render_resource::PipelineDescriptor::RenderPipelineDescriptor;
        let RenderPipelineDescriptor(descriptor) = &pipeline.descriptor else { return false };
        descriptor.label.as_ref().is_some_and(|own| own == label)
    });
    own.count()
}

/// Only what needs it is made, and what wants no shadow has none.
#[gpu_test]
fn shadows_on_meshes_are_thrown_where_they_are_wanted() {
    // The ball is above the camera, out of the picture.
    let mut scene = Scene::new(Vec3::new(0.1, 1.0, 0.1));
    let tree = level_set::sphere(DVec3::new(0.0, 40.0, 0.0), RADIUS / VOXEL);
    let ball = scene.volume(tree, PackKind::Smooth { iso: 0.0 }, VdbMaterial::default());
    let far = Vec3::new(0.0, 1.0, 0.001);
    let light = scene.stage.world().spawn(sun(far)).id();
    scene.stage.world().entity_mut(scene.plane).insert(Visibility::Hidden);
    scene.picture("no_mesh");
    assert_eq!(pipelines(&mut scene.stage, "vdb_cast"), 0, "no mesh is seen");
    scene.stage.world().entity_mut(scene.plane).insert(Visibility::Inherited);
    let set = |scene: &mut Scene, on: bool| {
        let mut light = scene.stage.world().entity_mut(light);
        light.get_mut::<DirectionalLight>().expect("a light").shadow_maps_enabled = on;
    };
    set(&mut scene, false);
    let lit = scene.picture("no_maps").center().x;
    assert!(lit > 0.1, "{lit}");
    assert_eq!(pipelines(&mut scene.stage, "vdb_cast"), 0, "no light throws shadows");
    set(&mut scene, true);
    assert_eq!(scene.picture("above").center().x, 0.0, "above the camera");
    assert_eq!(pipelines(&mut scene.stage, "vdb_cast"), 1);
    // No volume is seen that would need the maps without volumes.
    assert_eq!(pipelines(&mut scene.stage, "vdb_mesh_depth"), 0);
    let is_lit = |scene: &mut Scene, why: &str| {
        assert_eq!(scene.picture("wanted").center().x, lit, "{why}");
    };
    let camera = scene.camera;
    for settings in [
        (VdbCamera::default(), VdbQuality { shadows: false, ..default() }),
        (VdbCamera { mesh_shadows: false, ..default() }, VdbQuality::default()),
        (VdbCamera { enabled: false, ..default() }, VdbQuality::default()),
    ] {
        scene.stage.world().entity_mut(camera).insert(settings.clone());
        is_lit(&mut scene, &format!("{settings:?}"));
    }
    scene.stage.world().entity_mut(camera).insert((VdbCamera::default(), VdbQuality::default()));
    scene.stage.world().entity_mut(ball).insert(NotShadowCaster);
    is_lit(&mut scene, "no caster");
    scene.stage.world().entity_mut(ball).remove::<NotShadowCaster>();
    scene.stage.world().entity_mut(scene.plane).insert(NotShadowReceiver);
    is_lit(&mut scene, "no receiver");
    scene.stage.world().entity_mut(scene.plane).remove::<NotShadowReceiver>();
    assert_eq!(scene.picture("above").center().x, 0.0, "as before");
    scene.stage.world().entity_mut(ball).insert(Visibility::Hidden);
    is_lit(&mut scene, "hidden");
    let layer = bevy::camera::visibility::RenderLayers::layer(2);
    scene.stage.world().entity_mut(ball).insert((Visibility::Inherited, layer));
    is_lit(&mut scene, "in a layer that the camera does not see");
    // Fog has pipelines of its own.
    let of_fog = |scene: &mut Scene| pipelines(&mut scene.stage, "vdb_cast_fog");
    assert_eq!(of_fog(&mut scene), 0);
    let block = CoordBox { min: IVec3::new(-20, 20, -20), max: IVec3::new(20, 40, 20) };
    scene.volume(fog::block(block, 1e3), PackKind::Fog, VdbMaterial::default());
    assert!(scene.picture("above_fog").center().x < 0.01 * lit, "below a dense fog");
    assert_eq!(of_fog(&mut scene), 1);
    assert_eq!(pipelines(&mut scene.stage, "vdb_cast"), 1, "no surface is there any more");
}

/// Each camera has cascades of its own, and both share the maps of a bulb.
#[gpu_test]
#[ignore = "slow: each light and each camera alone"]
fn two_cameras_see_the_shadow() {
    let tree = level_set::sphere(CENTER / VOXEL, RADIUS / VOXEL);
    // What one app keeps does not make the other's pictures alike.
    let mut stages = [(); 2].map(|()| Some(Stage::new()));
    for is_sun in [true, false] {
        let mut shown = |cameras: &[usize]| {
            let stage = &mut stages[cameras.len() - 1];
            let own = stage.take().expect("an app");
            let mut scene = Scene::on(own, Vec3::new(-2.0, 7.0, 5.0));
            let material = VdbMaterial::default();
            scene.volume(tree.clone(), PackKind::Smooth { iso: 0.0 }, material.clone());
            let beside = CoordBox { min: IVec3::new(-30, 10, -10), max: IVec3::new(-15, 25, 5) };
            scene.volume(fog::block(beside, 1.0), PackKind::Fog, material);
            let world = scene.stage.world();
            // Both see the same, however coarse.
            world.insert_resource(DirectionalLightShadowMap { size: 256 });
            world.insert_resource(PointLightShadowMap { size: 128 });
            if is_sun {
                world.spawn(sun(TO_SUN))
            } else {
                world.spawn(bulb())
            };
            let places = [Vec3::new(-2.0, 7.0, 5.0), Vec3::new(4.0, 6.0, -2.0)];
            world.despawn(scene.camera);
            let targets = cameras.iter().map(|&i| {
                let target = scene.stage.target(SIZE);
                let camera = scene.stage.camera(&target, looking(places[i]));
                let order = Camera { order: i as isize, ..default() };
                scene.stage.world().entity_mut(camera).insert(order);
                target
            });
            let targets: Vec<_> = targets.collect();
            let pictures: Vec<_> =
                targets.iter().map(|target| scene.stage.picture(target)).collect();
            *stage = Some(scene.stage);
            pictures
        };
        let both = shown(&[0, 1]);
        for (i, together) in both.iter().enumerate() {
            let alone = &shown(&[i])[0];
            together.save(&format!("mesh_shadows_two_{is_sun}_{i}"));
            let differ = together.pixels.iter().zip(&alone.pixels).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "camera {i}, sun {is_sun}: {differ} pixels differ");
        }
        assert_ne!(both[0], both[1]);
    }
}
