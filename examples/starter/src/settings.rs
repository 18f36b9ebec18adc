//! Graphics settings: four presets, a dial that holds the frame rate, and the menu for them.

use std::collections::BTreeSet;
use std::time::Duration;

use bevy::diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore, FrameTimeDiagnosticsPlugin};
use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap};
use bevy::prelude::*;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy::time::common_conditions::on_timer;
use bevy_vdb::prelude::*;

use crate::GameState;
use crate::scene::SHADOW_DISTANCE;

/// Settings of a preset: the quality of volumes, and the shadow maps of the sun.
///
/// The size of the maps matters more than with meshes alone: in every frame, a ray is traced for
/// each texel that a volume may cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preset {
    pub volumes: VdbQuality,
    /// The edge of a shadow map in texels: a power of two.
    pub shadow_map_size: usize,
    /// The number of shadow maps, one behind the other along the view: 1 or more.
    pub cascades: usize,
}

/// Small GPUs, or 4K.
pub const FAST: Preset = Preset { volumes: VdbQuality::FAST, shadow_map_size: 1024, cascades: 1 };

/// Integrated graphics at 1920×1080.
pub const LAPTOP: Preset = Preset {
    volumes: VdbQuality {
        // Rays per pixel along each axis. 0.7² is about half as many rays, in about half the time.
        // Edges of volumes get a little coarser; meshes and the user interface stay sharp.
        resolution: 0.7,
        // Fog in steps of one voxel, lit by the sun to within 2 %. Without fog, it is the same as
        // `HIGH`.
        ..VdbQuality::BALANCED
    },
    // A quarter of the texels of Bevy's default, 2048. They are small enough, because shadows end
    // at `SHADOW_DISTANCE` and not at Bevy's 150 units.
    shadow_map_size: 1024,
    // Half of Bevy's default, 4: a scene that is not very deep needs no more.
    cascades: 2,
};

/// A graphics card.
pub const BALANCED: Preset =
    Preset { volumes: VdbQuality::BALANCED, shadow_map_size: 2048, cascades: 2 };

/// A fast graphics card. The shadow maps are Bevy's defaults.
pub const HIGH: Preset = Preset { volumes: VdbQuality::HIGH, shadow_map_size: 2048, cascades: 4 };

/// The GPU time in milliseconds that the dial allows volumes in each frame: a third of a frame at
/// 60 Hz. The rest is for meshes, shadow maps and effects.
pub const GPU_BUDGET_MS: f32 = 5.5;

/// The time in milliseconds that the dial allows each whole frame if GPU times cannot be measured.
/// Less than a frame at 60 Hz could never be met: vertical sync stretches each frame to 16.7 ms, or
/// to 33.3 ms if it is late.
const FRAME_BUDGET_MS: f32 = 20.0;

/// The far end of the first of several shadow maps, in world units: behind the volumes, so that
/// their shadows are in the sharpest map.
const FIRST_CASCADE: f32 = 14.0;

/// The player's choice. Games usually save this in a file.
#[derive(Clone, Copy, Debug, PartialEq, Resource)]
pub struct Settings {
    pub preset: Preset,
    /// Whether a [`VdbDial`] adjusts the quality of volumes to the frame rate.
    pub has_dial: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { preset: LAPTOP, has_dial: false }
    }
}

/// The action of a button or key.
#[derive(Clone, Component, Copy, Debug, PartialEq)]
pub enum Choice {
    Preset(Preset),
    /// Turns the dial on or off.
    Dial,
}

const CHOICES: [(KeyCode, &str, Choice); 5] = [
    (KeyCode::Digit1, "1  Fast", Choice::Preset(FAST)),
    (KeyCode::Digit2, "2  Laptop", Choice::Preset(LAPTOP)),
    (KeyCode::Digit3, "3  Balanced", Choice::Preset(BALANCED)),
    (KeyCode::Digit4, "4  High", Choice::Preset(HIGH)),
    (KeyCode::Digit5, "5  Hold the frame rate", Choice::Dial),
];

impl Settings {
    fn choose(&mut self, choice: Choice) {
        *self = match choice {
            Choice::Preset(preset) => Self { preset, has_dial: false },
            Choice::Dial => Self { has_dial: !self.has_dial, ..*self },
        };
    }

    fn is_chosen(&self, choice: Choice) -> bool {
        match choice {
            Choice::Preset(preset) => self.preset == preset,
            Choice::Dial => self.has_dial,
        }
    }
}

pub struct SettingsPlugin;

impl Plugin for SettingsPlugin {
    fn build(&self, app: &mut App) {
        // `RenderDiagnosticsPlugin` measures GPU times. Without it, the dial has only the time
        // between frames, which includes much that does not depend on the quality of volumes.
        app.add_plugins((FrameTimeDiagnosticsPlugin::default(), RenderDiagnosticsPlugin))
            .init_resource::<Settings>()
            .add_systems(OnEnter(GameState::Playing), spawn_menu)
            .add_systems(
                Update,
                (choose.run_if(in_state(GameState::Playing)), apply, set_budget, paint).chain(),
            )
            .add_systems(
                Update,
                (toggle_menu, show_frame_rate.run_if(on_timer(Duration::from_millis(500)))),
            );
    }
}

fn choose(
    keys: Res<ButtonInput<KeyCode>>,
    buttons: Query<(&Interaction, &Choice), Changed<Interaction>>,
    mut settings: ResMut<Settings>,
) {
    for (interaction, choice) in &buttons {
        if *interaction == Interaction::Pressed {
            settings.choose(*choice);
        }
    }
    for (key, _, choice) in CHOICES {
        if keys.just_pressed(key) {
            settings.choose(choice);
        }
    }
}

/// Applies the settings when they change, and to cameras and suns that are new. The first time is
/// behind the loading screen, so that the shaders for the player's settings are compiled there.
fn apply(
    mut commands: Commands,
    settings: Res<Settings>,
    cameras: Query<Entity, With<Camera3d>>,
    suns: Query<Entity, With<DirectionalLight>>,
    new: Query<(), Or<(Added<Camera3d>, Added<DirectionalLight>)>>,
    mut shadow_maps: ResMut<DirectionalLightShadowMap>,
) {
    if !settings.is_changed() && new.is_empty() {
        return;
    }
    let Settings { preset, has_dial } = *settings;
    for camera in &cameras {
        let mut camera = commands.entity(camera);
        // Otherwise the dial would change what the preset sets.
        camera.remove::<VdbDial>().insert(preset.volumes);
        if has_dial {
            camera.insert(VdbDial::Budget { frame_ms: FRAME_BUDGET_MS });
        }
    }
    let cascades = CascadeShadowConfigBuilder {
        num_cascades: preset.cascades,
        first_cascade_far_bound: FIRST_CASCADE,
        maximum_distance: SHADOW_DISTANCE,
        ..default()
    };
    let cascades = cascades.build();
    for sun in &suns {
        commands.entity(sun).insert(cascades.clone());
    }
    shadow_maps.size = preset.shadow_map_size;
}

/// Gives the dial the budget for what it measures: GPU times as soon as there are any.
fn set_budget(store: Res<DiagnosticsStore>, mut dials: Query<&mut VdbDial>) {
    let has_gpu_times = VdbDiagnostics::pass_ms(&store, "vdb_trace").is_some();
    let frame_ms = if has_gpu_times { GPU_BUDGET_MS } else { FRAME_BUDGET_MS };
    for mut dial in &mut dials {
        dial.set_if_neq(VdbDial::Budget { frame_ms });
    }
}

#[derive(Component)]
struct Menu;

#[derive(Component)]
struct FrameRate;

const PANEL: Color = Color::srgba(0.05, 0.06, 0.08, 0.8);
const BUTTON: Color = Color::srgb(0.16, 0.18, 0.22);
const HOVERED: Color = Color::srgb(0.24, 0.27, 0.33);
const CHOSEN: Color = Color::srgb(0.16, 0.4, 0.68);

fn spawn_menu(mut commands: Commands) {
    let panel = Node {
        position_type: PositionType::Absolute,
        left: px(16),
        top: px(16),
        padding: UiRect::all(px(12)),
        flex_direction: FlexDirection::Column,
        row_gap: px(6),
        border_radius: BorderRadius::all(px(8)),
        ..default()
    };
    commands
        .spawn((Menu, DespawnOnExit(GameState::Playing), panel, BackgroundColor(PANEL)))
        .with_children(|menu| {
            menu.spawn((FrameRate, small("")));
            for (_, label, choice) in CHOICES {
                menu.spawn(button(label, choice));
            }
            menu.spawn(small("Arrow keys: camera\nEsc: this menu"));
        });
}

fn small(text: &'static str) -> impl Bundle {
    (Text::new(text), TextFont::from_font_size(13.0))
}

fn button(label: &'static str, choice: Choice) -> impl Bundle {
    let node = Node {
        padding: UiRect::axes(px(10), px(6)),
        border_radius: BorderRadius::all(px(4)),
        ..default()
    };
    let text = (Text::new(label), TextFont::from_font_size(16.0));
    (Button, choice, node, BackgroundColor(BUTTON), children![text])
}

fn paint(
    settings: Res<Settings>,
    mut buttons: Query<(&Choice, &Interaction, &mut BackgroundColor)>,
) {
    for (choice, interaction, mut background) in &mut buttons {
        let color = match interaction {
            _ if settings.is_chosen(*choice) => CHOSEN,
            Interaction::None => BUTTON,
            Interaction::Hovered | Interaction::Pressed => HOVERED,
        };
        background.set_if_neq(BackgroundColor(color));
    }
}

fn toggle_menu(keys: Res<ButtonInput<KeyCode>>, mut menu: Single<&mut Visibility, With<Menu>>) {
    if keys.just_pressed(KeyCode::Escape) {
        menu.toggle_inherited_hidden();
    }
}

fn show_frame_rate(
    store: Res<DiagnosticsStore>,
    volumes: Res<VdbDiagnostics>,
    mut text: Single<&mut Text, With<FrameRate>>,
) {
    let mean = |path: &DiagnosticPath| store.get(path).and_then(Diagnostic::smoothed);
    let frames = mean(&FrameTimeDiagnosticsPlugin::FPS);
    let ms = mean(&FrameTimeDiagnosticsPlugin::FRAME_TIME);
    let mut shown = match frames.zip(ms) {
        Some((frames, ms)) => format!("{frames:.0} frames per second, {ms:.1} ms"),
        None => String::new(),
    };
    let cameras = volumes.cameras();
    let passes = cameras.iter().flat_map(|(_, camera)| &camera.passes).map(|pass| pass.name);
    shown += &gpu_times(passes, |pass| VdbDiagnostics::pass_ms(&store, pass));
    text.set_if_neq(Text(shown));
}

/// Lines with the GPU times of the passes that run. `ms` is the time of a pass for all cameras
/// together, or `None` with drivers that have no timestamps.
pub fn gpu_times(
    passes: impl Iterator<Item = &'static str>,
    ms: impl Fn(&str) -> Option<f64>,
) -> String {
    // Several cameras have the same passes.
    let mut passes: BTreeSet<&'static str> = passes.collect();
    let shadows = ["vdb_opacity", "vdb_cast", "vdb_fog_shadows"];
    let shadows = shadows.map(|pass| passes.take(pass).and_then(&ms));
    let shadows_ms = shadows.into_iter().flatten().reduce(|a, b| a + b);
    let volumes_ms: f64 = passes.into_iter().filter_map(&ms).sum();
    let mut lines = String::new();
    if volumes_ms > 0.0 {
        lines += &format!("\nVolumes: {volumes_ms:.1} ms on the GPU");
    }
    if let Some(shadows_ms) = shadows_ms {
        lines += &format!("\nTheir shadows on meshes: {shadows_ms:.1} ms more");
    }
    lines
}
