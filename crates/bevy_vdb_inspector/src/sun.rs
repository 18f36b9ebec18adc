//! A directional light: its direction, colour and illuminance.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::VdbSun;

use super::ball;
use super::material::color;
use super::state::VdbInspector;
use super::widgets::entity_name;

/// The largest illuminance, in lux: more than direct sunlight at noon.
const BRIGHTEST: f32 = 150_000.0;

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    mut commands: Commands,
    mut inspector: ResMut<VdbInspector>,
    cameras: Query<&GlobalTransform>,
    mut suns: Query<(
        Entity,
        &mut DirectionalLight,
        &mut Transform,
        &GlobalTransform,
        Option<&mut VdbSun>,
        Option<&Name>,
    )>,
) {
    let mut chosen = inspector.sun;
    let names = suns.iter().map(|(entity, .., name)| (entity, entity_name(entity, name)));
    super::widgets::pick_entity(ui, "light", &mut chosen, names);
    if chosen != inspector.sun {
        inspector.sun = chosen;
    }
    let sun = chosen.and_then(|sun| suns.get_mut(sun).ok());
    let Some((entity, mut light, mut transform, global, volume_sun, _)) = sun else {
        ui.weak("there is no directional light");
        return;
    };
    let camera = inspector.camera.and_then(|camera| cameras.get(camera).ok());
    let view = camera.map_or(Quat::IDENTITY, GlobalTransform::rotation);
    let mut to_light = (view.inverse() * Vec3::from(global.back())).normalize_or(Vec3::Z);
    let mut new = *light;
    ui.horizontal(|ui| {
        if ball::show(ui, "direction of the sun", &mut to_light) {
            // Only the light's own transform changes, not that of its parent.
            let parent = global.rotation() * transform.rotation.inverse();
            let back = parent.inverse() * (view * to_light);
            let up = if back.y.abs() > 0.999 { Vec3::Z } else { Vec3::Y };
            transform.look_to(-back, up);
        }
        ui.vertical(|ui| {
            let mut rgb = new.color.to_srgba().to_f32_array_no_alpha();
            if color(ui, "sun's colour", |ui| ui.color_edit_button_rgb(&mut rgb)) {
                new.color = Color::srgb_from_array(rgb);
            }
            ui.checkbox(&mut new.shadow_maps_enabled, "casts shadows");
        });
    });
    let illuminance =
        super::widgets::slider(&mut new.illuminance, 0.0..=BRIGHTEST).logarithmic(true);
    ui.add(illuminance.smallest_positive(1.0).suffix(" lx").text("illuminance"));
    let mut intensity = volume_sun.as_ref().map_or(1.0, |sun| sun.intensity);
    let slider = super::widgets::slider(&mut intensity, 0.0..=10.0).text("× on volumes");
    if ui.add(slider).changed() {
        match volume_sun {
            Some(mut sun) => sun.intensity = intensity,
            None => _ = commands.entity(entity).insert(VdbSun { intensity, ..default() }),
        }
    }
    if !same(&light, &new) {
        *light = new;
    }
}

/// Whether the properties shown in the panel are equal.
fn same(a: &DirectionalLight, b: &DirectionalLight) -> bool {
    (a.color, a.illuminance, a.shadow_maps_enabled)
        == (b.color, b.illuminance, b.shadow_maps_enabled)
}
