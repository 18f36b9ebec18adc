//! stub
use bevy::prelude::*;
use bevy_panorbit_camera::PanOrbitCameraPlugin;
use bevy_egui::EguiPlugin;
fn main() { App::new().add_plugins((DefaultPlugins, EguiPlugin::default(), PanOrbitCameraPlugin)).run(); }
