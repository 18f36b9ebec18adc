//! A flying camera. Its speed is independent of the frame rate, and proportional to the size of the
//! scene.

use bevy::input::mouse::{AccumulatedMouseMotion, AccumulatedMouseScroll, MouseScrollUnit};
use bevy::prelude::*;
use bevy_egui::input::EguiWantsInput;

use crate::app::Status;
use crate::window::Orbit;

/// The rotation per pixel of mouse motion, in radians.
const LOOK: f32 = 0.003;
/// The factor of the speed per notch of the mouse wheel.
const NOTCH: f32 = 1.2;
/// The factor of the speed with Shift.
const FAST: f32 = 4.0;
/// The longest time step in seconds; longer frames are hitches.
const LONGEST: f32 = 0.25;

#[derive(Resource)]
pub struct Fly {
    pub on: bool,
    /// The speed in radii of the scene per second.
    pub speed: f32,
}

impl Default for Fly {
    fn default() -> Self {
        Self { on: false, speed: 0.5 }
    }
}

/// Toggles flying when F is pressed.
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

/// The displacement after `seconds` of flight. `wish` is a direction in view space.
fn step(rotation: Quat, wish: Vec3, speed: f32, seconds: f32) -> Vec3 {
    rotation * wish.normalize_or_zero() * speed * seconds.min(LONGEST)
}

/// Rotates the camera by a mouse motion in pixels; the horizon stays level.
fn turn(camera: &mut Transform, motion: Vec2) {
    let (yaw, pitch, _) = camera.rotation.to_euler(EulerRot::YXZ);
    let pitch = (pitch - LOOK * motion.y).clamp(-1.55, 1.55);
    camera.rotation = Quat::from_euler(EulerRot::YXZ, yaw - LOOK * motion.x, pitch, 0.0);
}
