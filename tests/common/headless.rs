//! Bevy's plugins for an app without a GPU, and without a window system.

use bevy::app::PluginGroupBuilder;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::settings::{RenderCreation, WgpuSettings};
use bevy::winit::WinitPlugin;

/// With a window that nobody sees, or none, and assets that are not watched.
pub fn plugins(window: Option<Window>, assets: AssetPlugin) -> PluginGroupBuilder {
    let no_gpu = WgpuSettings { backends: None, ..default() };
    let render_creation = RenderCreation::Automatic(Box::new(no_gpu));
    DefaultPlugins
        .set(RenderPlugin { render_creation, ..default() })
        .set(WindowPlugin { primary_window: window, ..default() })
        .set(AssetPlugin { watch_for_changes_override: Some(false), ..assets })
        .disable::<WinitPlugin>()
        .disable::<LogPlugin>()
}
