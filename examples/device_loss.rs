//! Survives the loss of its GPU, as after a driver update or crash or when a graphics card is
//! unplugged. D destroys the device; everything is back on screen a moment later.

use bevy::prelude::*;
use bevy::render::error_handler::{ErrorType, RenderError, RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::RenderCreation;
use bevy_vdb::prelude::*;

fn main() {
    App::new()
        .add_plugins((DefaultPlugins, VdbRenderPlugin))
        .insert_resource(RenderErrorHandler(recover))
        .add_systems(Startup, setup)
        .add_systems(Update, (turn, lose))
        .run();
}

/// Bevy's default handler quits the app on any error. Errors other than a lost GPU are bugs, which
/// another device would not fix.
fn recover(error: &RenderError, world: &mut World, _: &mut World) -> RenderErrorPolicy {
    if let ErrorType::DeviceLost = error.ty {
        // The settings of the app's RenderPlugin, which are the default ones.
        return RenderErrorPolicy::Recover(RenderCreation::default());
    }
    world.write_message(AppExit::error());
    RenderErrorPolicy::StopRendering
}

fn lose(keys: Res<ButtonInput<KeyCode>>, device: Res<RenderDevice>) {
    if keys.just_pressed(KeyCode::KeyD) {
        // Bevy 0.19.1 panics if it is still reading back one of its light buffers.
        device.poll(PollType::wait_indefinitely()).ok();
        device.wgpu_device().destroy();
        // Notifies Bevy, which happens automatically when a device is really lost.
        device.poll(PollType::wait_indefinitely()).ok();
    }
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn(VdbVolume(assets.load("models/teapot.vdb#surface")));
    commands.spawn((
        VdbVolume(assets.load("models/cloud.vdb#density")),
        VdbMaterial { density_scale: 4.0, ..default() },
    ));
    let eye = Transform::from_xyz(3.0, 4.5, 12.0).looking_at(Vec3::new(0.5, 2.2, -1.0), Vec3::Y);
    commands.spawn((Camera3d::default(), eye, AmbientLight { brightness: 130.0, ..default() }));
    let sun = DirectionalLight { illuminance: 3_000.0, shadow_maps_enabled: true, ..default() };
    commands.spawn((sun, Transform::from_xyz(-6.0, 8.0, 5.0).looking_at(Vec3::ZERO, Vec3::Y)));
}

fn turn(time: Res<Time>, mut volumes: Query<&mut Transform, With<VdbVolume>>) {
    volumes.iter_mut().for_each(|mut volume| volume.rotate_y(0.3 * time.delta_secs()));
}
