//! A starter for games with volumes: a loading screen, a scene of meshes and volumes, and a
//! settings menu. `README.md` says how to begin a game with it.

use bevy::prelude::*;
use bevy_vdb::prelude::*;

mod loading;
mod scene;
mod settings;
#[cfg(test)]
mod tests;

fn main() -> AppExit {
    let window = Window { title: "bevy_vdb starter".into(), ..default() };
    let window = WindowPlugin { primary_window: Some(window), ..default() };
    App::new()
        // `VdbPlugins` come after `DefaultPlugins`, because they look for the renderer.
        .add_plugins((DefaultPlugins.set(window).set(assets()), VdbPlugins))
        .add_plugins(GamePlugin)
        .run()
}

/// The folder with the assets. This example uses that of the repository; in a game of your own,
/// return `AssetPlugin::default()`, which is the folder `assets` beside `Cargo.toml` and, in a game
/// that you ship, beside the program.
fn assets() -> AssetPlugin {
    AssetPlugin {
        file_path: concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets").into(),
        ..default()
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, States)]
enum GameState {
    /// The scene is there, behind the loading screen.
    #[default]
    Loading,
    Playing,
}

/// Everything that belongs to this game.
struct GamePlugin;

impl Plugin for GamePlugin {
    fn build(&self, app: &mut App) {
        app.init_state::<GameState>().add_plugins((
            loading::LoadingPlugin,
            scene::ScenePlugin,
            settings::SettingsPlugin,
        ));
    }
}
