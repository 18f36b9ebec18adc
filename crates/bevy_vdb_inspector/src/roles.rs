//! The roles of a file's grids in the selected volume: density or surface, emission, colours.

use bevy::asset::AssetPath;
use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{
    VdbColorGrid, VdbEmission, VdbEmissionLight, VdbGrid, VdbPlayer, VdbVectorGrid, VdbVolume,
};

use super::emission_light;
use super::state::VdbInspector;
use super::volumes::FromFile;

/// Loaded grids of a file, by label.
type Labelled<A> = Vec<(String, Handle<A>)>;

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    mut commands: Commands,
    inspector: Res<VdbInspector>,
    assets: Res<AssetServer>,
    (grids, vectors): (Res<Assets<VdbGrid>>, Res<Assets<VdbVectorGrid>>),
    mut volumes: Query<(
        Entity,
        &mut VdbVolume,
        (Option<&mut VdbEmission>, Option<&mut VdbEmissionLight>),
        Option<&VdbColorGrid>,
        Option<&FromFile>,
        Option<&mut VdbPlayer>,
    )>,
) {
    let selected = inspector.volume.and_then(|volume| volumes.get_mut(volume).ok());
    let Some((entity, mut volume, (emission, light), colors, from_file, mut player)) = selected
    else {
        ui.weak("there is no volume");
        return;
    };
    let file = volume.0.path().or(from_file.map(|FromFile(file)| file));
    let file = file.map(AssetPath::without_label);
    let (scalars, colorful) = match &file {
        Some(file) => (of_file(&assets, &grids, file), of_file(&assets, &vectors, file)),
        None => default(),
    };
    let own = volume.0.clone();
    if scalars.len() > 1 {
        // A repacked grid still counts as the grid of the file that it was made from.
        let other = from_file.filter(|_| own.path().is_none()).and_then(|FromFile(at)| at.label());
        let grid = |(label, grid)| (label, if other == Some(label) { &own } else { grid });
        let all: Vec<_> = scalars.iter().map(|(label, one)| grid((&**label, one))).collect();
        let mut grid = &own;
        if super::widgets::pick(ui, "grid", &mut grid, &all) {
            volume.0 = grid.clone();
            // Of the next frames of a sequence, too.
            if let (Some(player), Some(path)) = (&mut player, grid.path()) {
                player.grid = path.label().map(str::to_owned);
            }
        }
    }
    let is_fog = |handle: &Handle<VdbGrid>| {
        grids.get(handle).is_some_and(|grid| matches!(grid.kind(), PackKind::Fog))
    };
    let fogs = scalars.into_iter().filter(|(_, grid)| *grid != own && is_fog(grid));
    let fire = fogs.map(|(label, grid)| (label, Fire::Fog(grid)));
    let colored = colorful.iter().map(|(label, grid)| (label.clone(), Fire::Colors(grid.clone())));
    let fires: Vec<(String, Fire)> = fire.chain(colored).collect();
    let (mut own, burns) = (emission.as_deref().map(Fire::of), emission.is_some());
    if (!fires.is_empty() || own.is_some()) && pick(ui, "fire", &mut own, &fires, "made in memory")
    {
        match own.as_ref().map(|fire| fire.guess(&grids, &vectors)) {
            None => _ = commands.entity(entity).remove::<VdbEmission>(),
            Some(Some(guess)) => _ = commands.entity(entity).insert(guess),
            Some(None) => {}
        }
        // A player that sets no roles leaves the fire on this frame; one that does brings it back.
        if let Some(player) = &mut player {
            player.sets_roles = own.is_some() || colors.is_some();
        }
    } else if let Some(mut emission) = emission {
        let mut new = emission.clone();
        adjust(ui, &mut new);
        emission.set_if_neq(new);
        emission_light::adjust(ui, commands.entity(entity), light);
    }
    let mut own = colors.map(|colors| colors.0.clone());
    if (!colorful.is_empty() || own.is_some())
        && pick(ui, "colours", &mut own, &colorful, "made in memory")
    {
        if let Some(player) = &mut player {
            player.sets_roles = own.is_some() || burns;
        }
        match own {
            None => commands.entity(entity).remove::<VdbColorGrid>(),
            Some(grid) => commands.entity(entity).insert(VdbColorGrid(grid)),
        };
    }
    if fires.is_empty() && colorful.is_empty() {
        ui.weak("the file has no other grids");
    }
}

/// The loaded grids of one file, by ascending label.
fn of_file<A: Asset>(assets: &AssetServer, all: &Assets<A>, file: &AssetPath) -> Labelled<A> {
    let own = all.ids().filter_map(|id| {
        let path = assets.get_path(id)?;
        let label = path.label().filter(|_| path.without_label() == *file)?;
        Some((label.to_owned(), assets.get_id_handle(id)?))
    });
    let mut own: Labelled<A> = own.collect();
    own.sort_by(|a, b| a.0.cmp(&b.0));
    own
}

/// A grid that may emit.
#[derive(Clone, PartialEq)]
enum Fire {
    Fog(Handle<VdbGrid>),
    Colors(Handle<VdbVectorGrid>),
}

impl Fire {
    fn of(emission: &VdbEmission) -> Self {
        match emission {
            VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
                Self::Fog(grid.clone())
            }
            VdbEmission::Color { grid, .. } => Self::Colors(grid.clone()),
        }
    }

    fn guess(
        &self,
        grids: &Assets<VdbGrid>,
        vectors: &Assets<VdbVectorGrid>,
    ) -> Option<VdbEmission> {
        match self {
            Self::Fog(handle) => Some(VdbEmission::guess(handle.clone(), grids.get(handle)?)),
            Self::Colors(handle) => {
                Some(VdbEmission::guess_color(handle.clone(), vectors.get(handle)?))
            }
        }
    }
}

/// A drop-down list of values and "none"; returns whether the choice has changed. A value that is
/// not in the list is shown as `otherwise`.
fn pick<T: Clone + PartialEq>(
    ui: &mut egui::Ui,
    label: &str,
    value: &mut Option<T>,
    all: &[(String, T)],
    otherwise: &str,
) -> bool {
    let before = value.clone();
    let now = all.iter().find(|(_, one)| Some(one) == before.as_ref()).map(|(name, _)| &**name);
    let now = if before.is_none() { "none" } else { now.unwrap_or(otherwise) };
    egui::ComboBox::from_label(label).selected_text(now).truncate().show_ui(ui, |ui| {
        let all = all.iter().map(|(name, one)| (&**name, Some(one.clone())));
        for (name, one) in std::iter::once(("none", None)).chain(all) {
            if ui.selectable_value(value, one, name).clicked() {
                ui.close();
            }
        }
    });
    *value != before
}

/// The parameters of the emission.
fn adjust(ui: &mut egui::Ui, emission: &mut VdbEmission) {
    match emission {
        VdbEmission::Temperature { scale, offset, strength, .. } => {
            let kelvin = super::widgets::slider(scale, 0.0..=10_000.0).logarithmic(true);
            ui.add(kelvin.smallest_positive(0.1).text("kelvin per unit"));
            ui.add(super::widgets::slider(offset, 0.0..=5_000.0).text("kelvin at 0"));
            glow(ui, strength);
        }
        VdbEmission::Color { strength, .. } => glow(ui, strength),
        // There is no control for a colour of unbounded luminance, which only apps can set.
        VdbEmission::Scalar { .. } => {}
    }
}

fn glow(ui: &mut egui::Ui, strength: &mut f32) {
    let slider = super::widgets::slider(strength, 0.0..=100_000.0).logarithmic(true);
    ui.add(slider.smallest_positive(1e-6).max_decimals(6).text("strength"));
}
