//! A lit ball that shows the direction of a light, rotated with the mouse or the arrow keys.

use std::f32::consts::TAU;

use bevy::prelude::*;
use bevy_egui::egui;

/// The radius of the ball, in points.
const RADIUS: f32 = 44.0;
/// The rotation per press of an arrow key, in radians.
const STEP: f32 = 5.0 * TAU / 360.0;
/// The rings and sectors of the ball's mesh.
const RINGS: u32 = 10;
const SECTORS: u32 = 32;

/// Shows the ball and returns whether the direction changed. `to_light` has unit length, in camera
/// space: x right, y up, z towards the viewer.
pub(super) fn show(ui: &mut egui::Ui, label: &str, to_light: &mut Vec3) -> bool {
    let size = egui::Vec2::splat(2.0 * RADIUS + 8.0);
    let (area, response) = ui.allocate_exact_size(size, egui::Sense::click_and_drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, label));
    let before = *to_light;
    if response.drag_started() || response.clicked() {
        response.request_focus();
    }
    if response.clicked() {
        if let Some(at) = response.interact_pointer_pos() {
            *to_light = under(vector(at - area.center()) / RADIUS);
        }
    } else if response.dragged() {
        *to_light = turned(*to_light, vector(response.drag_delta()) / RADIUS);
    }
    if response.has_focus() {
        let all_arrows =
            egui::EventFilter { horizontal_arrows: true, vertical_arrows: true, ..default() };
        ui.memory_mut(|memory| memory.set_focus_lock_filter(response.id, all_arrows));
        let pressed = |key| ui.input(|input| input.num_presses(key)) as f32;
        let across = pressed(egui::Key::ArrowRight) - pressed(egui::Key::ArrowLeft);
        let up = pressed(egui::Key::ArrowUp) - pressed(egui::Key::ArrowDown);
        *to_light = turned(*to_light, STEP * Vec2::new(across, up));
    }
    draw(ui, area.center(), *to_light, &response);
    response.on_hover_text("direction of the light, seen from the camera: drag, click or arrows");
    *to_light != before
}

/// Flips y, which points downwards on screens.
fn vector(points: egui::Vec2) -> Vec2 {
    Vec2::new(points.x, -points.y)
}

/// The visible point of the unit ball at a position, or on its rim for positions outside.
fn under(place: Vec2) -> Vec3 {
    let place = place.clamp_length_max(1.0);
    place.extend((1.0 - place.length_squared()).max(0.0).sqrt()).normalize_or(Vec3::Z)
}

/// A direction after rolling the ball by this many radii to the right and up.
fn turned(direction: Vec3, roll: Vec2) -> Vec3 {
    let angle = roll.length();
    let Some(axis) = Vec3::new(-roll.y, roll.x, 0.0).try_normalize() else { return direction };
    (Quat::from_axis_angle(axis, angle) * direction).normalize()
}

fn draw(ui: &egui::Ui, center: egui::Pos2, to_light: Vec3, response: &egui::Response) {
    let painter = ui.painter();
    let place = |v: Vec3| center + RADIUS * egui::vec2(v.x, -v.y);
    let mut mesh = egui::Mesh::default();
    for ring in 0..=RINGS {
        // Rings are equally spaced on the ball, so they are dense near the rim on screen, where the
        // shading changes most.
        let from_middle = 0.25 * TAU * ring as f32 / RINGS as f32;
        for sector in 0..SECTORS {
            let (sin, cos) = (TAU * sector as f32 / SECTORS as f32).sin_cos();
            let normal = (from_middle.sin() * Vec2::new(cos, sin)).extend(from_middle.cos());
            let lit = 0.12 + 0.88 * normal.dot(to_light).max(0.0);
            let shade = (255.0 * lit.powf(1.0 / 2.2)) as u8;
            mesh.colored_vertex(place(normal), egui::Color32::from_gray(shade));
            if ring < RINGS {
                let next = (sector + 1) % SECTORS;
                let [a, b] = [sector, next].map(|sector| ring * SECTORS + sector);
                mesh.add_triangle(a, b, a + SECTORS);
                mesh.add_triangle(b, b + SECTORS, a + SECTORS);
            }
        }
    }
    painter.add(mesh);
    let visuals = ui.style().interact(response);
    let rim = if response.has_focus() {
        ui.visuals().selection.stroke
    } else {
        egui::Stroke::new(1.0_f32, visuals.bg_stroke.color)
    };
    painter.circle_stroke(center, RADIUS, rim);
    // The light: a dot if it is in front of the ball, a ring if it is behind.
    let color = egui::Color32::from_rgb(255, 190, 60);
    if to_light.z >= 0.0 {
        painter.circle_filled(place(to_light), 4.0, color);
    } else {
        painter.circle_stroke(place(to_light), 4.0, egui::Stroke::new(1.5_f32, color));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: Vec3, b: Vec3) -> bool {
        a.distance(b) < 1e-5
    }

    #[test]
    fn what_is_clicked_is_where_the_light_is() {
        assert!(close(under(Vec2::ZERO), Vec3::Z));
        assert!(close(under(Vec2::new(0.6, 0.0)), Vec3::new(0.6, 0.0, 0.8)));
        assert!(close(under(Vec2::new(0.0, 9.0)), Vec3::Y));
    }

    #[test]
    fn the_ball_rolls_with_the_mouse() {
        // The middle follows the mouse, and continues over the rim to the back.
        assert!(turned(Vec3::Z, Vec2::new(0.1, 0.0)).x > 0.09);
        assert!(turned(Vec3::Z, Vec2::new(0.0, 0.1)).y > 0.09);
        assert!(close(turned(Vec3::Z, Vec2::new(TAU / 4.0, 0.0)), Vec3::X));
        assert!(close(turned(Vec3::Z, Vec2::new(0.0, TAU / 2.0)), Vec3::NEG_Z));
        assert!(close(turned(Vec3::Z, Vec2::ZERO), Vec3::Z));
    }
}
