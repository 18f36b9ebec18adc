//! Cooking by Bevy's asset processing.

use std::sync::Arc;

use bevy::asset::AssetLoader;
use bevy::asset::io::Writer;
use bevy::asset::processor::{Process, ProcessContext, ProcessError};
use bevy::prelude::*;
use bevy::tasks::futures_lite::AsyncWriteExt;
use serde::{Deserialize, Serialize};
use vdb_core::AnyTree;
use vdb_core::cooked::{CookOptions, CookedFile, VERSION};
use vdb_core::display::{escaped, quoted};
use vdb_core::pack::PackKind;
use vdb_core::tree::trim_narrow_band;

use super::background;
use super::error::{VdbLoaderError, few};
use super::loader::{VdbLoader, half_width, kind, read, take_in, tell_of_conversions};
use super::settings::{VdbLoaderSettings, VdbRenderAs};

/// Cooks `.vdb` files when Bevy processes assets (`AssetMode::Processed`): packs their grids for the
/// GPU, so that the app decodes them in milliseconds. Assets keep their paths; their grids are
/// *cooked* ([`VdbGrid::tree`](crate::VdbGrid::tree)).
///
/// For all `.vdb` files of an app, after `DefaultPlugins` and `VdbPlugins`:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # let mut app = App::new();
/// app.set_default_asset_processor::<VdbCooker>("vdb");
/// ```
///
/// Or for a single file, in the `.meta` file beside it:
///
/// ```ron
/// (
///     meta_format_version: "1.0",
///     asset: Process(
///         processor: "bevy_vdb::VdbCooker",
///         settings: (load: (grids: Some(["density", "flame"]), values: Byte)),
///     ),
/// )
/// ```
///
/// Points are cooked as the volume that [`VdbLoaderSettings::points`] displays. Vector grids are left out;
/// a warning names them, and what else cannot be cooked. A cooked file is loaded by
/// [`VdbLoader`] as a [`VdbFile`](crate::VdbFile) with labelled grids; a
/// [`VdbGrid`](crate::VdbGrid) needs a label in its path, `"teapot.vdb#surface"`.
#[derive(Clone, Default, TypePath)]
#[type_path = "bevy_vdb"]
pub struct VdbCooker;

/// Settings for cooking a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct VdbCookSettings {
    /// The settings for loading the file. Those of points have no effect: points are left out. By
    /// default, values are exact: [`VdbValues::Exact`](crate::VdbValues::Exact).
    pub load: VdbLoaderSettings,
    /// The version of cooked files. Its default changes with the format, so Bevy recooks files whose
    /// settings are not in a `.meta` file.
    pub version: u32,
}

impl Default for VdbCookSettings {
    fn default() -> Self {
        Self { load: VdbLoaderSettings::default(), version: VERSION }
    }
}

impl Process for VdbCooker {
    type Settings = VdbCookSettings;
    type OutputLoader = VdbLoader;

    async fn process(
        &self,
        context: &mut ProcessContext<'_>,
        settings: &VdbCookSettings,
        writer: &mut Writer,
    ) -> Result<<VdbLoader as AssetLoader>::Settings, ProcessError> {
        let failed = |error: VdbLoaderError| ProcessError::AssetTransformError(error.into());
        let (path, load) = (context.path().clone(), settings.load.clone());
        load.check().map_err(failed)?;
        let bytes = take_in(context.asset_reader(), None, &load.limits).await.map_err(failed)?;
        let task = background::run(move || cook(bytes, &load));
        let (bytes, left_out, problems) = task.await.map_err(failed)?;
        for problem in few(&problems) {
            warn!("{}: {problem}", escaped(&path.to_string()));
        }
        if !left_out.is_empty() {
            let names = left_out.iter().map(|name| quoted(name).to_string()).collect::<Vec<_>>();
            warn!(
                "{}: the cooked file is without {}, because only grids of floats are cooked",
                escaped(&path.to_string()),
                names.join(", ")
            );
        }
        writer.write_all(&bytes).await.map_err(|error| failed(error.into()))?;
        let limits = settings.load.limits.clone();
        Ok(VdbLoaderSettings { limits, ..default() })
    }
}

/// The bytes of the cooked file, the names of vector grids, which are left out, and reports about
/// other grids.
fn cook(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
) -> Result<(Vec<u8>, Vec<String>, Vec<String>), VdbLoaderError> {
    let (mut file, mut problems, converted) = read(bytes, settings, None)?;
    tell_of_conversions(&converted, &mut problems);
    let mut left_out = Vec::new();
    for grid in &mut file.grids {
        let AnyTree::Float(tree) = &grid.tree else {
            left_out.push(grid.unique_name.clone());
            continue;
        };
        let kind = kind(tree, grid.class, settings);
        if let Some(half_width) = half_width(&grid.transform, kind, settings) {
            grid.tree = AnyTree::Float(Arc::new(trim_narrow_band(tree, half_width)));
        }
    }
    let options = CookOptions {
        format: settings.values.into(),
        kind: match settings.render_as {
            VdbRenderAs::Auto => None,
            VdbRenderAs::Surface { iso } if settings.smooth => Some(PackKind::Smooth { iso }),
            VdbRenderAs::Surface { iso } => Some(PackKind::Surface { iso }),
            VdbRenderAs::Fog => Some(PackKind::Fog),
        },
        smooth: settings.smooth,
        limits: settings.limits.clone(),
        ..CookOptions::default()
    };
    Ok((CookedFile::cook(&file, &options)?.write()?, left_out, problems))
}
