//! Volumes before Bevy's atmosphere.

use bevy::light::Atmosphere;
use bevy::light::atmosphere::ScatteringMedium;
use bevy::math::DVec3;
use bevy::pbr::AtmosphereSettings;
use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::synth::level_set;

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, glow, looking};

/// Mesa's lavapipe does, of Bevy's own shaders for it, without a volume anywhere.
fn dies_of_a_sky() -> bool {
    let instance = wgpu::Instance::default();
    let adapter = bevy::tasks::block_on(instance.request_adapter(&Default::default()));
    let name = adapter.map(|adapter| adapter.get_info().name).unwrap_or_default();
    let dies = name.contains("llvmpipe");
    if dies {
        eprintln!("SKIPPED: Bevy's atmosphere crashes {name}");
    }
    dies
}

fn shown(sky: bool, volumes: bool, samples: Msaa) -> Picture {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 0.5, 8.0)));
    stage.world().entity_mut(camera).insert(samples);
    let light = DirectionalLight { illuminance: 10.0, ..default() };
    stage.world().spawn((light, looking(Vec3::new(0.3, 1.0, 0.5))));
    if sky {
        let medium = ScatteringMedium::earth(64, 64);
        let medium = stage.world().resource_mut::<Assets<ScatteringMedium>>().add(medium);
        stage.world().spawn(Atmosphere::earth(medium));
        stage.world().entity_mut(camera).insert(AtmosphereSettings::default());
    }
    if volumes {
        let ball = stage.grid(level_set::sphere(DVec3::ZERO, 15.0), SURFACE, 0.1);
        let red = glow(LinearRgba::rgb(2.0, 0.0, 0.0));
        stage.world().spawn((VdbVolume(ball), red, Transform::from_xyz(-2.0, 0.0, 0.0)));
        let cloud = stage.ball_of_fog(15.0, 4.0);
        // Black, so that what is seen in it is what it lets through.
        let black = VdbMaterial { density_scale: 0.5, ..glow(LinearRgba::BLACK) };
        stage.world().spawn((VdbVolume(cloud), black, Transform::from_xyz(2.0, 0.0, 0.0)));
    }
    let picture = stage.picture(&target);
    picture.save(&format!("sky_{sky}_{volumes}_{}", samples.samples()));
    picture
}

/// A surface hides the sky, and fog dims it: the sky is behind both.
#[gpu_test]
fn the_sky_is_behind_volumes() {
    if dies_of_a_sky() {
        return;
    }
    for samples in [Msaa::Off, Msaa::Sample4] {
        let [sky, own, both] = [(true, false), (false, true), (true, true)]
            .map(|(sky, volumes)| shown(sky, volumes, samples));
        let (mut surface, mut veiled, mut empty) = (0, 0, 0);
        for ((sky, own), both) in sky.pixels.iter().zip(&own.pixels).zip(&both.pixels) {
            let [sky, seen] = [sky.z, both.z];
            assert!(sky > 0.01, "a sky of {sky}");
            if own.x > 1.9 {
                surface += 1;
                // Bevy's air before it is of eight metres.
                assert!(seen < 0.01 * sky, "{seen} of a sky of {sky} before the ball");
                assert!((both.x / own.x - 1.0).abs() < 0.01, "{both} of {own}");
            } else if own.x == 0.0 {
                let part = seen / sky;
                veiled += usize::from(part < 0.8);
                empty += usize::from(part > 0.99);
                assert!(part < 1.001, "the sky is {part} times as bright with a fog before it");
            }
        }
        println!("{surface} pixels of the ball, {veiled} of the fog, {empty} of the sky");
        assert!(surface > 200 && empty > 1000, "{surface} of the ball, {empty} of the sky");
        // The middle of the fog: its density is 1 within 1.1 units, and falls to nothing at 1.5.
        let middle = UVec2::new(SIZE.x / 2 + 20, SIZE.y / 2 + 5);
        let part = both.at(middle.x, middle.y).z / sky.at(middle.x, middle.y).z;
        println!("{part} of the sky is seen through the middle of the fog");
        assert!(veiled > 200, "{veiled} pixels of fog before the sky");
        assert!(part < 0.45, "{part} of the sky in the middle of the fog");
    }
}

/// Bevy's sky has no public name, so that nothing can be ordered by it. It is drawn where the schedule puts it:
/// before the composite, or it would lie over fog, which has no depth.
#[gpu_test]
fn the_sky_is_drawn_before_volumes_are() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z));
    stage.update(2);
    let render = stage.app.sub_app(bevy::render::RenderApp).world();
    let schedules = render.resource::<Schedules>();
    let schedule = schedules.get(bevy::core_pipeline::Core3d).expect("the schedule of cameras");
    let names: Vec<String> = schedule
        .systems()
        .expect("it has run")
        .map(|(_, system)| system.name().to_string())
        .collect();
    let place = |name: &str| {
        names
            .iter()
            .position(|own| own.contains(name))
            .unwrap_or_else(|| panic!("{name}: {names:?}"))
    };
    assert!(place("render_sky") < place("composite::composite"), "{names:?}");
}
