//! The smallest app that shows a `.vdb` file: the plugin, a volume, a camera and a light. The
//! README contains the same code.

use bevy::prelude::*;
use bevy_vdb::prelude::*;

fn main() {
    App::new().add_plugins((DefaultPlugins, VdbRenderPlugin)).add_systems(Startup, setup).run();
}

pub(crate) fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    // A volume is placed like a mesh. The teapot is 6.4 units wide and stands on the plane y = 0.
    let teapot = VdbVolume(assets.load("models/teapot.vdb"));
    commands.spawn((teapot, Transform::from_scale(Vec3::splat(0.5))));
    // Any 3D camera sees it, and any light that lights meshes lights it.
    let eye = Transform::from_xyz(1.5, 2.0, 4.5).looking_at(Vec3::new(0.0, 0.7, 0.0), Vec3::Y);
    commands.spawn((Camera3d::default(), eye));
    let sun = DirectionalLight { illuminance: 3_000.0, ..default() };
    commands.spawn((sun, Transform::from_xyz(-2.0, 4.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y)));
}
