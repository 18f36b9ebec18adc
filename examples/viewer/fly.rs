//! A camera that flies: as fast at any frame rate, and as fast as suits the size of what is shown.

use bevy::input::mouse::{AccumulatedMouseMotion, AccumulatedMouseScroll, MouseScrollUnit};
use bevy::prelude::*;
use bevy_egui::input::EguiWantsInput;

use crate::app::Status;
use crate::window::Orbit;

/// Radians a pixel.
const LOOK: f32 = 0.003;
/// Faster with each notch of the wheel.
const NOTCH: f32 = 1.2;
/// With Shift.
const FAST: f32 = 4.0;
/// A frame longer than this is a hitch, not flight.
const LONGEST: f32 = 0.25;

#[derive(Resource)]
pub struct Fly {
    pub on: bool,
    /// Radii of the scene a second.
    pub speed: f32,
}

impl Default for Fly {
    fn default() -> Self {
        Self { on: false, speed: 0.5 }
    }
}

/// `F`.
pub fn toggle(
    keys: Res<ButtonInput<KeyCode>>,
    status: Res<Status>,
    mut fly: ResMut<Fly>,
    mut orbit: Orbit,
) {
    let (true, Some(view)) = (keys.just_pressed(KeyCode::KeyF), &status.view) else { return };
    fly.on = !fly.on;
    if fly.on {
        orbit.rest();
    } else {
        orbit.resume(view, view.radius() as f32);
    }
}

pub fn fly(
    time: Res<Time<Real>>,
    keys: Res<ButtonInput<KeyCode>>,
    buttons: Res<ButtonInput<MouseButton>>,
    (motion, scroll): (Res<AccumulatedMouseMotion>, Res<AccumulatedMouseScroll>),
    egui: Option<Res<EguiWantsInput>>,
    status: Res<Status>,
    mut fly: ResMut<Fly>,
    mut cameras: Query<&mut Transform, With<Camera3d>>,
) {
    let (true, Some(view)) = (fly.on, status.view) else { return };
    if egui.is_none_or(|egui| !egui.wants_any_pointer_input()) {
        let notches = match scroll.unit {
            MouseScrollUnit::Line => scroll.delta.y,
            MouseScrollUnit::Pixel => scroll.delta.y / 100.0,
        };
        fly.speed = (fly.speed * NOTCH.powf(notches)).clamp(1e-4, 1e3);
        if buttons.any_pressed([MouseButton::Left, MouseButton::Right]) {
            cameras.iter_mut().for_each(|mut camera| turn(&mut camera, motion.delta));
        }
    }
    let along = |ahead, back| f32::from(keys.pressed(ahead)) - f32::from(keys.pressed(back));
    let wish = Vec3::new(
        along(KeyCode::KeyD, KeyCode::KeyA),
        along(KeyCode::KeyE, KeyCode::KeyQ),
        along(KeyCode::KeyS, KeyCode::KeyW),
    );
    if wish == Vec3::ZERO {
        return;
    }
    let fast = if keys.any_pressed([KeyCode::ShiftLeft, KeyCode::ShiftRight]) { FAST } else { 1.0 };
    let speed = fast * fly.speed * view.radius() as f32;
    for mut camera in &mut cameras {
        let step = step(camera.rotation, wish, speed, time.delta_secs());
        camera.translation += step;
    }
}

/// Where `seconds` of flight lead. `wish` is in the camera's space.
fn step(rotation: Quat, wish: Vec3, speed: f32, seconds: f32) -> Vec3 {
    rotation * wish.normalize_or_zero() * speed * seconds.min(LONGEST)
}

/// Looks around by a motion in pixels; the horizon stays level.
fn turn(camera: &mut Transform, motion: Vec2) {
    let (yaw, pitch, _) = camera.rotation.to_euler(EulerRot::YXZ);
    let pitch = (pitch - LOOK * motion.y).clamp(-1.55, 1.55);
    camera.rotation = Quat::from_euler(EulerRot::YXZ, yaw - LOOK * motion.x, pitch, 0.0);
}
