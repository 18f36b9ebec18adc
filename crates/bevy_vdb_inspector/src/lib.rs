//! A panel for [`bevy_vdb`] that shows and edits volumes, materials, cameras and quality settings:
//! [`VdbInspectorPlugin`]; and a timeline of sequences: [`VdbTimeline`].
//!
//! Each section of the panel is a system in its own file. It receives the `egui::Ui` to draw into,
//! edits components like any system of an app, and writes only what the user has changed.
//!
//! # Cargo features
//!
//! - `record`: the section "Recording", in apps with the `VdbRecordPlugin` of `bevy_vdb`.

#![deny(missing_docs)]

/// Compiles the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod ball;
mod camera;
mod emission_light;
mod grid;
mod material;
mod memory;
mod models;
mod performance;
mod quality;
mod ramp;
#[cfg(feature = "record")]
mod recording;
mod roles;
mod sequences;
mod state;
mod sun;
mod timeline;
mod tools;
mod volumes;
mod widgets;

use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::diagnostic::FrameTimeDiagnosticsPlugin;
use bevy::ecs::system::IntoSystem;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy_egui::render::egui_pass;
use bevy_egui::{EguiContext, EguiPlugin, EguiPrimaryContextPass, PrimaryEguiContext, egui};
use bevy_vdb::{VdbCamera, VdbVolume};

pub use models::VdbModelPicked;
pub use state::VdbInspector;
pub use timeline::VdbTimeline;

/// The width of the panel, and its margin to the edge of the window, in points.
const WIDTH: f32 = 300.0;
const MARGIN: f32 = 8.0;

/// An inspector panel over the image of the camera with the primary context of `bevy_egui`, by
/// default the first one spawned, and a [`VdbTimeline`] below it if a sequence is played.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # use bevy_vdb_inspector::VdbInspectorPlugin;
/// App::new().add_plugins((DefaultPlugins, VdbRenderPlugin, VdbInspectorPlugin::default())).run();
/// ```
///
/// Adds `EguiPlugin` and Bevy's frame and GPU diagnostics unless the app has added them; an app
/// that adds any of them does so before this plugin. With the cargo feature `record`, the panel has
/// a section for recording if the app has the `VdbRecordPlugin`.
///
/// Keyboard: F2 toggles the panel ([`VdbInspector::key`]), Tab moves between controls, Space
/// presses buttons, arrows move sliders, and Ctrl with plus and minus changes the size. Other
/// systems should ignore keyboard and mouse while the panel uses them: see `EguiWantsInput` of
/// `bevy_egui`.
#[derive(Clone, Copy, Debug)]
pub struct VdbInspectorPlugin {
    /// Whether a model picked in the panel replaces the model of the selected volume. On by
    /// default. Otherwise the app handles [`VdbModelPicked`].
    pub replaces_models: bool,
}

impl Default for VdbInspectorPlugin {
    fn default() -> Self {
        Self { replaces_models: true }
    }
}

impl Plugin for VdbInspectorPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EguiPlugin>() {
            app.add_plugins(EguiPlugin::default());
        }
        if !app.is_plugin_added::<FrameTimeDiagnosticsPlugin>() {
            app.add_plugins(FrameTimeDiagnosticsPlugin::default());
        }
        let renders = app.get_sub_app(RenderApp).is_some();
        if renders && !app.is_plugin_added::<RenderDiagnosticsPlugin>() {
            app.add_plugins(RenderDiagnosticsPlugin);
        }
        app.init_resource::<VdbInspector>()
            .init_resource::<models::Models>()
            .add_message::<VdbModelPicked>()
            .add_systems(Update, (toggle, models::search, volumes::finish_repacking))
            .add_systems(EguiPrimaryContextPass, (select, sequences::show, panel).chain());
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            // `bevy_egui` does not order its pass relative to post-processing, which could draw
            // over the panel or change its colours.
            let in_between = (|| {}).after(Core3dSystems::PostProcess).before(egui_pass);
            render_app.add_systems(Core3d, in_between);
        }
        if self.replaces_models {
            app.add_systems(Update, models::replace);
        }
    }
}

fn toggle(keys: Option<Res<ButtonInput<KeyCode>>>, mut inspector: ResMut<VdbInspector>) {
    let pressed = |key| keys.as_ref().is_some_and(|keys| keys.just_pressed(key));
    if inspector.key.is_some_and(pressed) {
        inspector.open = !inspector.open;
    }
}

/// Replaces every selection that is empty or no longer exists.
fn select(
    mut inspector: ResMut<VdbInspector>,
    volumes: Query<Entity, With<VdbVolume>>,
    cameras: Query<(Entity, Has<PrimaryEguiContext>), With<VdbCamera>>,
    suns: Query<Entity, With<DirectionalLight>>,
) {
    if !inspector.volume.is_some_and(|volume| volumes.contains(volume)) {
        inspector.volume = volumes.iter().min();
    }
    if !inspector.camera.is_some_and(|camera| cameras.contains(camera)) {
        let own = cameras.iter().min_by_key(|(camera, has_panel)| (!has_panel, *camera));
        inspector.camera = own.map(|(camera, _)| camera);
    }
    if !inspector.sun.is_some_and(|sun| suns.contains(sun)) {
        inspector.sun = suns.iter().min();
    }
}

fn panel(world: &mut World) {
    let mut contexts = world.query_filtered::<&mut EguiContext, With<PrimaryEguiContext>>();
    let context = contexts.single_mut(world).map(|mut context| context.get_mut().clone());
    let mut open = world.resource::<VdbInspector>().open;
    let (Ok(context), true) = (context, open) else { return };
    let window = context.content_rect();
    let below = timeline::height_at_bottom(&context);
    egui::Window::new("bevy_vdb")
        .open(&mut open)
        .pivot(egui::Align2::RIGHT_TOP)
        .default_pos(window.right_top() + egui::vec2(-MARGIN, MARGIN))
        .default_width(WIDTH)
        .default_height(window.height())
        .max_height((window.height() - below - 6.0 * MARGIN).max(0.0))
        .vscroll(true)
        .show(&context, |ui| {
            ui.spacing_mut().slider_width = 0.4 * WIDTH;
            section(ui, world, "Performance", true, performance::show);
            section(ui, world, "Memory", false, memory::show);
            section(ui, world, "Volumes", true, volumes::show);
            section(ui, world, "Grids of the file", true, roles::show);
            section(ui, world, "Grid", false, grid::show);
            section(ui, world, "Material", true, material::show);
            section(ui, world, "Ramp", false, ramp::show);
            section(ui, world, "Camera", true, camera::show);
            section(ui, world, "Sun", true, sun::show);
            section(ui, world, "Quality", false, quality::show);
            #[cfg(feature = "record")]
            if recording::is_there(world) {
                section(ui, world, "Recording", false, recording::show);
            }
            section(ui, world, "Tools", false, tools::show);
        });
    if !open {
        world.resource_mut::<VdbInspector>().open = false;
    }
}

/// A collapsible section of the panel.
fn section<M: 'static>(
    ui: &mut egui::Ui,
    world: &mut World,
    title: &str,
    open: bool,
    system: impl IntoSystem<InMut<'static, egui::Ui>, (), M> + 'static,
) {
    egui::CollapsingHeader::new(title).default_open(open).show(ui, |ui| {
        if let Err(error) = world.run_system_cached_with(system, ui) {
            widgets::complain(ui, error.to_string());
        }
    });
}
