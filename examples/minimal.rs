//! The least that shows a `.vdb` file: the plugin, a camera, a light, a volume. The README has it, too.

use bevy::prelude::*;
use bevy_vdb::prelude::*;

fn main() {
    // `VdbRenderPlugin` loads `.vdb` files and draws `VdbVolume`s; the rest is Bevy as always.
    App::new().add_plugins((DefaultPlugins, VdbRenderPlugin)).add_systems(Startup, setup).run();
}

pub(crate) fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    // The surface or the density in a file. Of several grids, `teapot.vdb#surface` names one.
    let teapot = assets.load("models/teapot.vdb");
    // A volume is placed like a mesh. The model is 6.4 wide and stands on the plane y = 0.
    commands.spawn((VdbVolume(teapot), Transform::from_scale(Vec3::splat(0.5))));
    // Any 3D camera sees it,
    let eye = Transform::from_xyz(1.5, 2.0, 4.5).looking_at(Vec3::new(0.0, 0.7, 0.0), Vec3::Y);
    commands.spawn((Camera3d::default(), eye));
    // lit by all lights that light meshes.
    let sun = DirectionalLight { illuminance: 3_000.0, ..default() };
    commands.spawn((sun, Transform::from_xyz(-2.0, 4.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y)));
}
