//! What features cost.

use bevy::light::DirectionalLightShadowMap;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy_vdb::{
    VdbCamera, VdbDial, VdbFeatureCosts, VdbMaterial, VdbMeasureFeatures, VdbQuality, VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::fog;

use super::common::Stage;
use super::{SIZE, looking};

/// A cloud in the sun, of which the rays to the sun take most; nothing that the app has set is changed by
/// measuring.
#[gpu_test]
#[ignore = "slow: times of many frames without each feature"]
fn what_features_cost_is_measured() {
    let mut stage = Stage::with(|app| {
        app.add_plugins(RenderDiagnosticsPlugin);
    });
    stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::from_xyz(2.5, 0.0, -1.0).with_scale(Vec3::splat(0.5)));
    let grid = stage.grid(fog::sphere(DVec3::ZERO, 20.0, 10.0), PackKind::Fog, 0.1);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default()));
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(1.0, 2.0, 1.0))));
    // By rays, shadows are most of the time.
    let quality = VdbQuality { fog_shadow_step: 2.0, fog_light_error: 0.0, ..default() };
    stage.world().entity_mut(camera).insert(quality);
    let before = stage.picture(&target);
    let shown = stage.world().get::<VdbCamera>(camera).unwrap().clone();

    // A dial would look for what fits.
    let dial = VdbDial::Budget { frame_ms: 1e-3 };
    stage.world().entity_mut(camera).insert((dial, VdbMeasureFeatures));
    let mut frames = 0;
    loop {
        stage.update(1);
        frames += 1;
        assert!(frames < 4000, "it takes forever");
        if stage.world().get::<VdbMeasureFeatures>(camera).is_none() {
            break;
        }
        assert_eq!(*stage.world().get::<VdbQuality>(camera).unwrap(), quality);
    }
    stage.world().entity_mut(camera).remove::<VdbDial>().insert(quality);
    assert_eq!(*stage.world().get::<VdbCamera>(camera).unwrap(), shown);
    let costs = stage.world().get::<VdbFeatureCosts>(camera).unwrap().clone();
    println!("after {frames} frames: {costs:.2?}");
    let names: Vec<_> = costs.features.iter().map(|cost| cost.name).collect();
    assert_eq!(names, ["voxels", "fog", "beam optimisation", "shadows"]);
    assert!(costs.is_gpu_time && costs.total_ms > 0.0);
    let part = |name: &str| {
        costs.features.iter().find(|cost| cost.name == name).unwrap().ms / costs.total_ms
    };
    // Other programs take their time from it, too: a half is far from both.
    assert!(part("fog") > 0.5 && part("shadows") > 0.5, "{costs:?}");
    assert!(stage.picture(&target) == before, "something is still left out");
}
