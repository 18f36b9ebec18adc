//! The quality settings of the camera.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::{VdbQuality, VdbTraversal};

use super::state::VdbInspector;

const TRAVERSALS: [(&str, VdbTraversal); 4] = [
    ("HDDA with skipping", VdbTraversal::HddaSkip),
    ("HDDA", VdbTraversal::Hdda),
    ("DDA", VdbTraversal::Dda),
    ("ray marching", VdbTraversal::March),
];

const EDGE_SAMPLES: [(&str, u32); 5] = [("none", 0), ("2", 2), ("4", 4), ("8", 8), ("16", 16)];

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    inspector: Res<VdbInspector>,
    mut cameras: Query<&mut VdbQuality>,
) {
    let quality = inspector.camera.and_then(|camera| cameras.get_mut(camera).ok());
    let Some(mut quality) = quality else { return };
    let mut new = *quality;
    ui.horizontal(|ui| {
        for (name, preset) in VdbQuality::PRESETS {
            if ui.button(name).clicked() {
                new = preset;
            }
        }
    });
    ui.checkbox(&mut new.shadows, "shadows");
    ui.checkbox(&mut new.smooth_normals, "smooth normals");
    ui.add(super::widgets::slider(&mut new.reflections, 0..=16).text("reflections"));
    if new.reflections > 0 {
        ui.checkbox(&mut new.mesh_reflections, "reflections of meshes");
    }
    ui.checkbox(&mut new.denoise, "removal of grain");
    let mut exact = new.fog_step == 0.0;
    if ui.checkbox(&mut exact, "exact fog, cell by cell").changed() {
        new.fog_step = if exact { 0.0 } else { 1.0 };
    }
    if !exact {
        let step = super::widgets::slider(&mut new.fog_step, 0.25..=16.0).logarithmic(true);
        ui.add(step.text("voxels per sample"));
    }
    let error = super::widgets::slider(&mut new.fog_light_error, 0.0..=0.2).logarithmic(true);
    // With three decimals, one press of an arrow key would change nothing at the lower end.
    let error = error.smallest_positive(0.002).max_decimals(4).text("error of light in fog");
    ui.add(error).on_hover_text("relative, of lights with shadows; 0 sends rays to them instead");
    ui.add(super::widgets::slider(&mut new.detail, 0.0..=64.0).text("detail, pixels per voxel"));
    ui.add(super::widgets::slider(&mut new.resolution, 0.25..=1.0).text("resolution"));
    super::widgets::pick(ui, "further rays on edges", &mut new.edge_samples, &EDGE_SAMPLES);
    ui.add(super::widgets::slider(&mut new.accumulate, 0..=256).text("accumulated frames"));
    super::widgets::pick(ui, "rays", &mut new.traversal, &TRAVERSALS);
    quality.set_if_neq(new);
}
