//! The models among the app's assets, and the replacement of a volume's model.

use std::path::{Path, PathBuf};

use bevy::asset::io::{AssetSourceId, ErasedAssetReader};
use bevy::asset::{AssetPath, LoadState};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::tasks::futures::check_ready;
use bevy::tasks::futures_lite::StreamExt;
use bevy::tasks::{IoTaskPool, Task};
use bevy_egui::egui;
use bevy_vdb::vdb_core::display::escaped;
use bevy_vdb::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbRoles, VdbVolume};

/// The largest number of directory entries visited, because links may form cycles.
const MOST_ENTRIES: usize = 100_000;

/// A message: the user has picked a model in the panel. If
/// [`replaces_models`](super::VdbInspectorPlugin::replaces_models) is off, the app displays it.
#[derive(Clone, Debug, Message)]
pub struct VdbModelPicked {
    /// The `.vdb` file among the app's assets.
    pub path: AssetPath<'static>,
    /// The selected volume.
    pub volume: Option<Entity>,
}

/// The known models.
#[derive(Debug, Default, Resource)]
pub(super) struct Models {
    /// `.vdb` files among the assets, by ascending path; `None` until they have been requested.
    found: Option<Vec<PathBuf>>,
    searching: Option<Task<Result<Vec<PathBuf>, String>>>,
    /// Files being loaded, and the volumes that will show them.
    opening: Vec<(Entity, AssetPath<'static>, Handle<VdbFile>)>,
    /// Files whose grids are displayed; the handles keep their other grids loaded, for the user to
    /// choose from.
    opened: HashMap<Entity, Handle<VdbFile>>,
    /// The last error.
    error: Option<String>,
}

/// The drop-down of a volume's model.
pub(super) fn show(
    ui: &mut egui::Ui,
    models: &mut Models,
    assets: &AssetServer,
    picked: &mut MessageWriter<VdbModelPicked>,
    volume: Option<(Entity, &VdbVolume)>,
) {
    if models.found.is_none() && models.searching.is_none() {
        let assets = assets.clone();
        models.searching = Some(IoTaskPool::get().spawn(async move { find(assets).await }));
    }
    let own = volume.as_ref().and_then(|(_, volume)| volume.0.path());
    let now = own.map_or_else(|| "made in memory".into(), |path| file_name(path.path()));
    ui.horizontal(|ui| {
        let shown = if volume.is_some() { now } else { String::new() };
        egui::ComboBox::from_label("model").selected_text(shown).truncate().show_ui(ui, |ui| {
            for path in models.found.iter().flatten() {
                let selected = own.is_some_and(|own| own.path() == path);
                if ui
                    .selectable_label(selected, escaped(&path.to_string_lossy()).to_string())
                    .clicked()
                {
                    let path = AssetPath::from_path_buf(path.clone());
                    let volume = volume.as_ref().map(|(entity, _)| *entity);
                    picked.write(VdbModelPicked { path, volume });
                    ui.close();
                }
            }
            if models.found.as_ref().is_some_and(Vec::is_empty) {
                ui.weak("no .vdb file among the assets");
            }
        });
        if ui.button("⟳").on_hover_text("search the assets again").clicked() {
            models.found = None;
        }
    });
    for (_, path, _) in &models.opening {
        ui.label(format!("loading {} …", escaped(&path.to_string())));
    }
    if let Some(error) = &models.error {
        super::widgets::complain(ui, error);
    }
}

fn file_name(path: &Path) -> String {
    escaped(&path.file_name().unwrap_or_default().to_string_lossy()).to_string()
}

/// Receives the models that were found.
pub(super) fn search(mut models: ResMut<Models>) {
    let models = models.bypass_change_detection();
    let Some(result) = models.searching.as_mut().and_then(check_ready) else { return };
    models.searching = None;
    models.found = Some(result.unwrap_or_else(|error| {
        models.error = Some(error);
        Vec::new()
    }));
}

/// All `.vdb` files among the app's own assets.
async fn find(assets: AssetServer) -> Result<Vec<PathBuf>, String> {
    let source = assets.get_source(AssetSourceId::Default).map_err(|error| error.to_string())?;
    let mut found = in_folders(source.reader()).await?;
    found.sort_unstable();
    Ok(found)
}

async fn in_folders(reader: &dyn ErasedAssetReader) -> Result<Vec<PathBuf>, String> {
    let (mut found, mut folders, mut seen) = (Vec::new(), vec![PathBuf::new()], 0);
    while let Some(folder) = folders.pop() {
        let entries = reader.read_directory(&folder).await;
        let mut entries = match entries {
            Ok(entries) => entries,
            // An unreadable folder must not hide the others.
            Err(_) if folder != Path::new("") => continue,
            Err(error) => return Err(format!("the asset folder cannot be listed: {error}")),
        };
        while let Some(path) = entries.next().await {
            seen += 1;
            if seen > MOST_ENTRIES {
                return Ok(found);
            }
            if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("vdb")) {
                found.push(path);
            } else if reader.is_directory(&path).await.unwrap_or(false) {
                folders.push(path);
            }
        }
    }
    Ok(found)
}

/// Loads the picked model, and replaces the volume's grid once the file has been loaded.
pub(super) fn replace(
    mut commands: Commands,
    mut models: ResMut<Models>,
    mut picked: MessageReader<VdbModelPicked>,
    assets: Res<AssetServer>,
    (files, grids): (Res<Assets<VdbFile>>, Res<Assets<VdbGrid>>),
    mut volumes: Query<&mut VdbVolume>,
) {
    let models = models.bypass_change_detection();
    for VdbModelPicked { path, volume } in picked.read() {
        let Some(volume) = *volume else { continue };
        models.opening.retain(|(entity, ..)| *entity != volume);
        models.opening.push((volume, path.clone(), assets.load(path.clone())));
        models.error = None;
    }
    for (entity, path, handle) in std::mem::take(&mut models.opening) {
        let (state, file) = (assets.load_state(&handle), files.get(&handle));
        match (state, file, volumes.get_mut(entity)) {
            (LoadState::Failed(error), ..) => models.error = Some(error.to_string()),
            (LoadState::Loaded, Some(file), Ok(mut volume)) => {
                // A surface and its colours, or smoke and its fire.
                let VdbRoles { surfaces, density, emission, colors, .. } = file.roles(&grids);
                let (grid, emission, colors) = match surfaces.into_iter().next() {
                    Some(surface) => (Some(surface), None, colors),
                    None => (density, emission, None),
                };
                let Some(grid) = grid else {
                    models.error = Some(format!("{path}: the file has no grids that can be shown"));
                    continue;
                };
                volume.0 = grid;
                models.opened.insert(entity, handle);
                let mut entity = commands.entity(entity);
                entity.remove::<(VdbEmission, VdbColorGrid)>();
                emission.map(|emission| entity.insert(emission));
                colors.map(|colors| entity.insert(colors));
            }
            (_, _, Err(_)) => {}
            _ => models.opening.push((entity, path, handle)),
        }
    }
    models.opened.retain(|entity, _| volumes.contains(*entity));
}
