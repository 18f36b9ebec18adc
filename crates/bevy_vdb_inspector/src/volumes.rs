//! The volumes of the app, and the kind, fog or surface, of the selected one.

use bevy::asset::AssetPath;
use bevy::prelude::*;
use bevy::tasks::futures::check_ready;
use bevy::tasks::{AsyncComputeTaskPool, Task};
use bevy_egui::egui;
use bevy_vdb::vdb_core::display::escaped;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{VdbGrid, VdbGridError, VdbVolume};

use super::models::{self, Models, VdbModelPicked};
use super::state::VdbInspector;
use super::widgets::entity_name;

/// A volume's grid being repacked as another kind.
#[derive(Component)]
pub(super) struct Repacking(Task<Result<VdbGrid, VdbGridError>>);

/// The grid from the file that a volume showed before repacking.
#[derive(Component)]
pub(super) struct FromFile(pub(super) AssetPath<'static>);

/// Why repacking failed.
#[derive(Component)]
pub(super) struct NotRepacked(String);

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    mut commands: Commands,
    mut inspector: ResMut<VdbInspector>,
    mut models: ResMut<Models>,
    (assets, grids): (Res<AssetServer>, Res<Assets<VdbGrid>>),
    mut picked: MessageWriter<VdbModelPicked>,
    mut volumes: Query<(
        Entity,
        &VdbVolume,
        &mut Visibility,
        Option<&Name>,
        Has<Repacking>,
        Option<&NotRepacked>,
    )>,
) {
    let mut entities: Vec<Entity> = volumes.iter().map(|(entity, ..)| entity).collect();
    entities.sort_unstable();
    for entity in entities {
        let Ok((_, volume, mut visibility, name, ..)) = volumes.get_mut(entity) else { continue };
        let name = match (name, grids.get(&volume.0)) {
            (None, Some(grid)) if !grid.name().is_empty() => escaped(grid.name()).to_string(),
            _ => entity_name(entity, name),
        };
        ui.horizontal(|ui| {
            let mut shown = *visibility != Visibility::Hidden;
            let checkbox = ui.checkbox(&mut shown, "");
            checkbox.widget_info(|| checkbox_info(shown, &format!("show {name}")));
            if checkbox.changed() {
                *visibility = if shown { Visibility::Inherited } else { Visibility::Hidden };
            }
            let selected = inspector.volume == Some(entity);
            if ui.selectable_label(selected, &name).clicked() && !selected {
                inspector.volume = Some(entity);
            }
        });
    }
    let selected = inspector.volume.and_then(|volume| volumes.get_mut(volume).ok());
    let Some((entity, volume, _, _, repacking, not_repacked)) = selected else {
        models::show(ui, &mut models, &assets, &mut picked, None);
        return;
    };
    models::show(ui, &mut models, &assets, &mut picked, Some((entity, volume)));
    let Some(grid) = grids.get(&volume.0) else {
        ui.label("the grid has not been loaded");
        return;
    };
    if let Some(kind) = pick_kind(ui, grid.kind()) {
        let grid = grid.clone();
        let task = AsyncComputeTaskPool::get().spawn(async move { grid.with_kind(kind) });
        commands.entity(entity).insert(Repacking(task)).remove::<NotRepacked>();
    }
    if repacking {
        ui.label("repacking …");
    }
    if let Some(NotRepacked(why)) = not_repacked {
        super::widgets::complain(ui, why);
    }
}

fn checkbox_info(on: bool, label: &str) -> egui::WidgetInfo {
    egui::WidgetInfo::selected(egui::WidgetType::Checkbox, true, on, label)
}

/// The kind that the user has selected, if it has changed.
fn pick_kind(ui: &mut egui::Ui, kind: PackKind) -> Option<PackKind> {
    let iso = match kind {
        PackKind::Surface { iso } | PackKind::Smooth { iso } => iso,
        PackKind::Fog => 0.0,
    };
    let (smooth, voxels) = (PackKind::Smooth { iso }, PackKind::Surface { iso });
    let mut wanted = kind;
    let all = [("fog", PackKind::Fog), ("smooth surface", smooth), ("voxels", voxels)];
    let mut changed = super::widgets::pick(ui, "shown as", &mut wanted, &all);
    if let PackKind::Surface { iso } | PackKind::Smooth { iso } = &mut wanted {
        ui.horizontal(|ui| {
            let value = egui::DragValue::new(iso).speed(0.01).update_while_editing(false);
            let value = ui.add(value);
            let label = ui.label("iso-value").id;
            changed |= value.labelled_by(label).changed();
        });
    }
    (changed && wanted != kind).then_some(wanted)
}

/// Displays grids that have been repacked.
pub(super) fn finish_repacking(
    mut commands: Commands,
    mut grids: ResMut<Assets<VdbGrid>>,
    mut volumes: Query<(Entity, &mut VdbVolume, &mut Repacking)>,
) {
    for (entity, mut volume, mut repacking) in &mut volumes {
        match check_ready(&mut repacking.0) {
            None => continue,
            Some(Ok(grid)) => {
                if let Some(path) = volume.0.path() {
                    commands.entity(entity).insert(FromFile(path.clone()));
                }
                volume.0 = grids.add(grid);
            }
            Some(Err(error)) => {
                commands.entity(entity).insert(NotRepacked(error.to_string()));
            }
        }
        commands.entity(entity).remove::<Repacking>();
    }
}
