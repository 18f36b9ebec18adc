//! What the picture may cost.

use bevy::prelude::*;
use bevy_egui::egui;

use super::VdbInspector;
use crate::{VdbCamera, VdbTraversal};

const TRAVERSALS: [(&str, VdbTraversal); 4] = [
    ("leaps", VdbTraversal::HddaSdf),
    ("HDDA", VdbTraversal::Hdda),
    ("DDA", VdbTraversal::Dda),
    ("marching", VdbTraversal::March),
];

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    inspector: Res<VdbInspector>,
    mut cameras: Query<&mut VdbCamera>,
) {
    let camera = inspector.camera.and_then(|camera| cameras.get_mut(camera).ok());
    let Some(mut camera) = camera else { return };
    let mut new = camera.clone();
    ui.checkbox(&mut new.shadows, "shadows");
    ui.add(super::slider(&mut new.reflections, 0..=16).text("reflections"));
    let mut exact = new.fog_step == 0.0;
    if ui.checkbox(&mut exact, "fog cell by cell, exactly").changed() {
        new.fog_step = if exact { 0.0 } else { 1.0 };
    }
    if !exact {
        let step = super::slider(&mut new.fog_step, 0.25..=16.0).logarithmic(true);
        ui.add(step.text("voxels a sample"));
    }
    super::pick(ui, "rays", &mut new.traversal, &TRAVERSALS);
    camera.set_if_neq(new);
}
