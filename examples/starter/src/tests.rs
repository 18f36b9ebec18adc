//! Tests of the game without a window and without a GPU.

use std::time::{Duration, Instant};

use bevy::app::PluginsState;
use bevy::diagnostic::{Diagnostic, DiagnosticMeasurement, DiagnosticPath, DiagnosticsStore};
use bevy::light::{CascadeShadowConfig, DirectionalLightShadowMap};
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::settings::{RenderCreation, WgpuSettings};
use bevy::state::app::StatesPlugin;
use bevy::time::TimeUpdateStrategy;
use bevy::winit::WinitPlugin;
use bevy_vdb::prelude::*;

use crate::loading::{LoadingPlugin, PATIENCE};
use crate::settings::{
    BALANCED, Choice, FAST, GPU_BUDGET_MS, HIGH, LAPTOP, Preset, Settings, SettingsPlugin,
    gpu_times,
};
use crate::{GamePlugin, GameState, assets};

/// An app for one part of the game.
fn app() -> App {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, assets(), StatesPlugin, VdbRenderPlugin))
        .init_resource::<ButtonInput<KeyCode>>()
        .init_resource::<DirectionalLightShadowMap>()
        .init_state::<GameState>();
    app
}

/// The whole game, with a window that nobody sees.
fn game() -> App {
    let no_gpu = WgpuSettings { backends: None, ..default() };
    let render_creation = RenderCreation::Automatic(Box::new(no_gpu));
    let mut app = App::new();
    app.add_plugins((
        DefaultPlugins
            .set(assets())
            .set(RenderPlugin { render_creation, ..default() })
            .disable::<WinitPlugin>()
            .disable::<LogPlugin>(),
        VdbPlugins,
        GamePlugin,
    ));
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app
}

fn is_playing(app: &App) -> bool {
    *app.world().resource::<State<GameState>>().get() == GameState::Playing
}

/// Updates the app until the loading screen is gone.
fn wait_until_playing(app: &mut App) {
    let start = Instant::now();
    while !is_playing(app) {
        assert!(start.elapsed() < Duration::from_secs(120), "loading does not end");
        app.update();
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// All texts on the screen.
fn texts(app: &mut App) -> String {
    let mut texts = app.world_mut().query::<&Text>();
    let texts: Vec<&str> = texts.iter(app.world()).map(|text| text.as_str()).collect();
    texts.join("\n")
}

#[test]
fn the_game_starts_with_all_volumes() {
    let mut app = game();
    app.update();
    assert!(texts(&mut app).contains("Loading models"), "{}", texts(&mut app));
    wait_until_playing(&mut app);
    let mut volumes = app.world_mut().query::<&VdbVolumeState>();
    let states: Vec<_> = volumes.iter(app.world()).collect();
    // Without a renderer, no camera sees them.
    assert_eq!(states, [&VdbVolumeState::Unseen; 2]);
    for _ in 0..3 {
        app.update();
    }
    let texts = texts(&mut app);
    assert!(texts.contains("2  Laptop") && !texts.contains(".vdb"), "{texts}");
}

#[test]
fn a_missing_file_is_named_and_the_game_goes_on() {
    let mut app = app();
    app.add_plugins(LoadingPlugin);
    let missing = app.world().resource::<AssetServer>().load("models/missing.vdb");
    app.world_mut().spawn(VdbVolume(missing));
    wait_until_playing(&mut app);
    let texts = texts(&mut app);
    assert!(texts.contains("models/missing.vdb could not be loaded: "), "{texts}");
}

#[test]
fn loading_ends_when_nothing_moves() {
    let mut app = app();
    app.add_plugins(LoadingPlugin)
        .insert_resource(TimeUpdateStrategy::ManualDuration(PATIENCE / 10));
    // No file belongs to this handle, so it never loads.
    let grid = app.world().resource::<Assets<VdbGrid>>().reserve_handle();
    app.world_mut().spawn(VdbVolume(grid));
    let mut updates = 0;
    while !is_playing(&app) {
        assert!(updates < 20, "loading does not end");
        app.update();
        updates += 1;
    }
    assert!(updates > 10, "loading ended after {updates} tenths of its time");
    assert!(texts(&mut app).contains("not ready yet"), "{}", texts(&mut app));
    for _ in 0..10 {
        app.update();
    }
    assert_eq!(texts(&mut app), "", "the notice stays forever");
}

#[test]
fn loading_goes_on_while_a_fraction_that_dropped_climbs_back() {
    let mut app = app();
    app.add_plugins(LoadingPlugin)
        .insert_resource(TimeUpdateStrategy::ManualDuration(PATIENCE / 10));
    let grid = app.world().resource::<Assets<VdbGrid>>().reserve_handle();
    app.world_mut().spawn(VdbVolume(grid));
    // Without a `VdbVolume`, only this test changes the state.
    app.world_mut().spawn(VdbVolumeState::Drawn);
    app.update();
    // From 1 of 2 volumes to 1 of 12, and up to 5 of 12.
    let late: Vec<Entity> =
        (0..10).map(|_| app.world_mut().spawn(VdbVolumeState::Loading).id()).collect();
    for volume in &late[..4] {
        for _ in 0..5 {
            app.update();
        }
        assert!(!is_playing(&app), "the game starts although volumes arrive");
        app.world_mut().entity_mut(*volume).insert(VdbVolumeState::Drawn);
    }
    wait_until_playing(&mut app);
}

/// The settings with a camera and a sun.
fn settings() -> (App, Entity, Entity) {
    let mut app = app();
    app.add_plugins(SettingsPlugin).insert_state(GameState::Playing);
    let camera = app.world_mut().spawn(Camera3d::default()).id();
    let sun = app.world_mut().spawn(DirectionalLight::default()).id();
    app.update();
    (app, camera, sun)
}

fn press(app: &mut App, key: KeyCode) {
    app.world_mut().resource_mut::<ButtonInput<KeyCode>>().press(key);
    app.update();
    app.world_mut().resource_mut::<ButtonInput<KeyCode>>().reset_all();
}

fn assert_applied(app: &App, [camera, sun]: [Entity; 2], preset: Preset) {
    let world = app.world();
    assert_eq!(world.get::<VdbQuality>(camera), Some(&preset.volumes));
    assert_eq!(world.get::<VdbDial>(camera), None);
    let cascades = world.get::<CascadeShadowConfig>(sun).map(|config| config.bounds.len());
    assert_eq!(cascades, Some(preset.cascades));
    assert_eq!(world.resource::<DirectionalLightShadowMap>().size, preset.shadow_map_size);
}

#[test]
fn keys_apply_presets() {
    let (mut app, camera, sun) = settings();
    assert_applied(&app, [camera, sun], LAPTOP);
    for (key, preset) in [
        (KeyCode::Digit1, FAST),
        (KeyCode::Digit2, LAPTOP),
        (KeyCode::Digit3, BALANCED),
        (KeyCode::Digit4, HIGH),
    ] {
        press(&mut app, key);
        assert_applied(&app, [camera, sun], preset);
    }
}

#[test]
fn a_preset_ends_the_dial() {
    let (mut app, camera, sun) = settings();
    press(&mut app, KeyCode::Digit5);
    assert!(app.world().get::<VdbDial>(camera).is_some());
    press(&mut app, KeyCode::Digit5);
    assert_applied(&app, [camera, sun], LAPTOP);
    press(&mut app, KeyCode::Digit5);
    press(&mut app, KeyCode::Digit4);
    assert_applied(&app, [camera, sun], HIGH);
}

#[test]
fn the_budget_is_one_that_can_be_reached() {
    let (mut app, camera, _) = settings();
    press(&mut app, KeyCode::Digit5);
    let budget = |app: &App| match app.world().get::<VdbDial>(camera) {
        Some(VdbDial::Budget { frame_ms }) => *frame_ms,
        other => panic!("{other:?}"),
    };
    assert!(budget(&app) > 1000.0 / 60.0, "vertical sync takes longer");

    let mut trace = Diagnostic::new(DiagnosticPath::const_new("render/vdb_trace/elapsed_gpu"));
    trace.add_measurement(DiagnosticMeasurement { time: Instant::now(), value: 1.0 });
    app.world_mut().resource_mut::<DiagnosticsStore>().add(trace);
    app.update();
    assert_eq!(budget(&app), GPU_BUDGET_MS);
}

#[test]
fn gpu_times_count_each_pass_once() {
    let ms = |pass: &str| Some(if pass == "vdb_cast" { 4.0 } else { 1.5 });
    // Two cameras.
    let passes = ["vdb_cast", "vdb_trace", "vdb_composite", "vdb_trace", "vdb_composite"];
    let shown = gpu_times(passes.into_iter(), ms);
    assert_eq!(shown, "\nVolumes: 3.0 ms on the GPU\nTheir shadows on meshes: 4.0 ms more");
    let shown = gpu_times(passes.into_iter().chain(["vdb_fog_shadows", "vdb_opacity"]), ms);
    assert_eq!(shown, "\nVolumes: 3.0 ms on the GPU\nTheir shadows on meshes: 7.0 ms more");
    // The last time of a pass that has stopped is still known.
    assert_eq!(gpu_times(["vdb_trace"].into_iter(), ms), "\nVolumes: 1.5 ms on the GPU");
    assert_eq!(gpu_times(passes.into_iter(), |_| None), "");
}

#[test]
fn buttons_do_what_keys_do() {
    let (mut app, camera, sun) = settings();
    let mut buttons = app.world_mut().query::<(Entity, &Choice)>();
    let fast = buttons.iter(app.world()).find(|(_, choice)| **choice == Choice::Preset(FAST));
    let fast = fast.expect("a button for each preset").0;
    app.world_mut().entity_mut(fast).insert(Interaction::Pressed);
    app.update();
    assert_applied(&app, [camera, sun], FAST);
    assert_eq!(app.world().resource::<Settings>().preset, FAST);
}

#[test]
fn presets_get_no_cheaper() {
    let texels = |preset: Preset| preset.cascades * preset.shadow_map_size.pow(2);
    for [a, b] in [[FAST, LAPTOP], [LAPTOP, BALANCED], [BALANCED, HIGH]] {
        assert!(a.volumes.resolution <= b.volumes.resolution && texels(a) <= texels(b));
        assert!(a.volumes.fog_light_error >= b.volumes.fog_light_error);
    }
}
