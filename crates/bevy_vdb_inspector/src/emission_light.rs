//! Controls of the light that a volume's fire sheds on its surroundings.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::VdbEmissionLight;

use super::widgets::slider;

/// Controls of a volume with a fire.
pub(super) fn adjust(
    ui: &mut egui::Ui,
    mut volume: EntityCommands,
    light: Option<Mut<VdbEmissionLight>>,
) {
    let mut is_on = light.is_some();
    if ui.checkbox(&mut is_on, "lights its surroundings").changed() {
        if is_on {
            volume.insert(VdbEmissionLight::default());
        } else {
            volume.remove::<VdbEmissionLight>();
        }
        return;
    }
    let Some(mut light) = light else { return };
    let mut new = light.clone();
    ui.add(slider(&mut new.max_lights, 1..=32).text("lights"));
    ui.add(slider(&mut new.intensity, 0.0..=10.0).text("light on others"));
    ui.checkbox(&mut new.shadows, "its lights cast shadows");
    light.set_if_neq(new);
}
