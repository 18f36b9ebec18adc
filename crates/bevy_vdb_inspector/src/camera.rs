//! The position of the camera, and its settings for the display of volumes.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::{VdbCamera, VdbRenderMode};

use super::state::VdbInspector;
use super::widgets::entity_name;

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    mut inspector: ResMut<VdbInspector>,
    mut cameras: Query<(Entity, &mut VdbCamera, &GlobalTransform, Option<&Name>)>,
) {
    let mut chosen = inspector.camera;
    let names = cameras.iter().map(|(entity, _, _, name)| (entity, entity_name(entity, name)));
    super::widgets::pick_entity(ui, "camera", &mut chosen, names);
    if chosen != inspector.camera {
        inspector.camera = chosen;
    }
    let camera = chosen.and_then(|camera| cameras.get_mut(camera).ok());
    let Some((_, mut camera, transform, _)) = camera else {
        ui.weak("there is no camera");
        return;
    };
    let (at, facing) = (transform.translation(), transform.forward());
    ui.label(format!("at {:.3}, {:.3}, {:.3}", at.x, at.y, at.z));
    ui.label(format!("facing {:.3}, {:.3}, {:.3}", facing.x, facing.y, facing.z));
    let mut new = camera.clone();
    ui.checkbox(&mut new.enabled, "shows volumes");
    let modes: Vec<_> = VdbRenderMode::ALL.iter().map(|mode| (mode.name(), *mode)).collect();
    super::widgets::pick(ui, "mode", &mut new.mode, &modes);
    if new.mode == VdbRenderMode::Steps {
        let scale = super::widgets::slider(&mut new.steps_scale, 1.0..=2_000.0).logarithmic(true);
        ui.add(scale.text("steps shown in red"));
    }
    if new.mode == VdbRenderMode::Maximum {
        let scale = super::widgets::slider(&mut new.maximum_scale, 1e-3..=1e3).logarithmic(true);
        ui.add(scale.text("value shown in white"));
    }
    ui.checkbox(&mut new.mesh_shadows, "shadows on meshes");
    ui.checkbox(&mut new.multiple_scattering, "multiple scattering");
    ui.label("node borders:");
    ui.horizontal(|ui| {
        ui.checkbox(&mut new.overlays.leaves, "leaves");
        ui.checkbox(&mut new.overlays.lower, "128³");
        ui.checkbox(&mut new.overlays.upper, "4,096³");
    });
    camera.set_if_neq(new);
}
