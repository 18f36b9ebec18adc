//! The least that shows a `.vdb` file: the plugin, a volume, a camera, a light. The README has it, too.

use bevy::prelude::*;
use bevy_vdb::prelude::*;

fn main() {
    App::new().add_plugins((DefaultPlugins, VdbRenderPlugin)).add_systems(Startup, setup).run();
}

pub(crate) fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    // A file is a set of grids, each with a name: `#density` is the grid in here.
    commands.spawn((
        VdbVolume(assets.load("models/cloud.vdb#density")),
        VdbMaterial { density_scale: 4.0, ..default() },
        Transform::from_xyz(0.0, 1.0, 0.0),
    ));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(3.0, 3.0, 6.0).looking_at(Vec3::Y, Vec3::Y),
    ));
    commands.spawn((
        DirectionalLight { illuminance: 3_000.0, ..default() },
        Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.0), Vec3::Y),
    ));
}
