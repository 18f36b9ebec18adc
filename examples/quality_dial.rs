//! The cost of quality: a cloud over a teapot, lit by a sun that casts shadows, and a dial.
//!
//! `cargo run --example quality_dial`: keys 1 to 4 set the presets, from exact to fast; B gives the
//! volume passes a budget of 4 ms, and E allows an error of one pixel. Every second it prints the
//! features that are on, their costs, and why they are on.

use std::time::Duration;

use bevy::diagnostic::DiagnosticsStore;
use bevy::prelude::*;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy::time::common_conditions::on_timer;
use bevy_vdb::prelude::*;

fn main() {
    let mut app = App::new();
    // `RenderDiagnosticsPlugin` measures the GPU times that a budget applies to.
    app.add_plugins((DefaultPlugins, VdbRenderPlugin, RenderDiagnosticsPlugin));
    scene(&mut app);
    app.add_systems(Update, tell.run_if(on_timer(Duration::from_secs(1)))).run();
}

/// The scene and the keys.
pub fn scene(app: &mut App) {
    app.insert_resource(GlobalAmbientLight::NONE)
        .add_systems(Startup, setup)
        .add_systems(Update, keys);
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn((
        VdbVolume(assets.load("models/cloud.vdb#density")),
        VdbMaterial { density_scale: 4.0, ..default() },
        // Overrides the camera's setting for this volume.
        VdbVolumeQuality { fog_shadow_step: Some(2.0), ..default() },
        // In its file, the cloud is behind and above the teapot.
        Transform::from_xyz(-0.2, 0.7, 2.0).with_scale(Vec3::splat(0.4)),
    ));
    commands.spawn((
        VdbVolume(assets.load("models/teapot.vdb#surface")),
        Transform::from_scale(Vec3::splat(0.5)),
    ));
    commands.spawn((
        Camera3d::default(),
        VdbQuality::BALANCED,
        Transform::from_xyz(2.0, 3.0, 6.5).looking_at(Vec3::new(0.0, 1.6, 0.0), Vec3::Y),
    ));
    let sun = DirectionalLight { illuminance: 10_000.0, shadow_maps_enabled: true, ..default() };
    commands.spawn((sun, Transform::from_xyz(-2.0, 4.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y)));
}

fn keys(
    mut commands: Commands,
    keys: Res<ButtonInput<KeyCode>>,
    camera: Single<Entity, With<Camera3d>>,
) {
    let mut camera = commands.entity(*camera);
    let digits = [KeyCode::Digit1, KeyCode::Digit2, KeyCode::Digit3, KeyCode::Digit4];
    for (key, (name, preset)) in digits.into_iter().zip(VdbQuality::PRESETS) {
        if keys.just_pressed(key) {
            info!("{name}");
            camera.remove::<VdbDial>().insert(preset);
        }
    }
    if keys.just_pressed(KeyCode::KeyB) {
        camera.insert(VdbDial::Budget { frame_ms: 4.0 });
    }
    if keys.just_pressed(KeyCode::KeyE) {
        camera.insert(VdbDial::MaxError { pixels: 1.0 });
    }
}

fn tell(
    diagnostics: Res<VdbDiagnostics>,
    store: Res<DiagnosticsStore>,
    quality: Single<(Entity, &VdbQuality)>,
) {
    let (camera, quality) = *quality;
    let Some(report) = diagnostics.camera(camera) else { return };
    info!("{quality:?}");
    for feature in &report.features {
        info!("  {}: {}", feature.name, feature.why);
    }
    for pass in &report.passes {
        let ms = VdbDiagnostics::pass_ms(&store, pass.name);
        let ms = ms.map_or("?".into(), |ms| format!("{ms:.2}"));
        info!("  {}, {ms} ms: {}", pass.name, pass.why);
    }
    info!("  {:.1} MB besides the grids", report.bytes() as f64 / 1e6);
}
