//! The plugin.

use bevy::asset::AssetTrackingSystems;
use bevy::camera::visibility::VisibilitySystems;
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponentPlugin;

use crate::bounds::update_bounds;
use crate::dial::turn_dials;
use crate::levels::{PendingLevels, make_levels};
use crate::measure::{LeftOut, measure_features};
use crate::reload::{LoadedFiles, tell_of_lost_grids};
use crate::render;
use crate::volume_state::update_states;
use crate::{
    VdbCamera, VdbColorGrid, VdbDiagnostics, VdbDial, VdbEmission, VdbFile, VdbGrid, VdbGridLoader,
    VdbLoadProgress, VdbLoader, VdbMaterial, VdbMeasureFeatures, VdbQuality, VdbSun, VdbVectorGrid,
    VdbVectorGridLoader, VdbVolume, VdbVolumeQuality, VdbVolumeState,
};

/// Loads `.vdb` files and displays [`VdbVolume`]s in every `Camera3d`.
///
/// Without a renderer (on a server, or in a test with `MinimalPlugins` and `AssetPlugin`) it still
/// loads files and keeps bounds up to date.
#[derive(Clone, Copy, Debug, Default)]
pub struct VdbRenderPlugin;

impl Plugin for VdbRenderPlugin {
    fn build(&self, app: &mut App) {
        let (progress, loaded) = (VdbLoadProgress::default(), LoadedFiles::default());
        app.init_asset::<VdbGrid>()
            .init_asset::<VdbVectorGrid>()
            .init_asset::<VdbFile>()
            // Where nothing says what a file is to be, Bevy takes the loader that came last.
            .register_asset_loader(VdbGridLoader::new(progress.clone()))
            .register_asset_loader(VdbVectorGridLoader::new(progress.clone()))
            .register_asset_loader(VdbLoader::new(progress.clone(), loaded.clone()))
            .insert_resource(progress)
            .insert_resource(loaded)
            .register_type::<VdbVolume>()
            .register_type::<VdbVolumeState>()
            .register_type::<VdbMaterial>()
            .register_type::<VdbColorGrid>()
            .register_type::<VdbEmission>()
            .register_type::<VdbCamera>()
            .register_type::<VdbQuality>()
            .register_type::<VdbVolumeQuality>()
            .register_type::<VdbSun>()
            .register_type::<VdbDial>()
            .register_type::<VdbMeasureFeatures>()
            .init_resource::<VdbDiagnostics>()
            .add_systems(Update, tell_of_lost_grids)
            .add_systems(PreUpdate, update_states.after(AssetTrackingSystems))
            .add_systems(Last, (measure_features, turn_dials).chain())
            .init_resource::<PendingLevels>()
            .add_systems(
                PostUpdate,
                (
                    make_levels.before(bevy::asset::AssetEventSystems),
                    update_bounds
                        .in_set(VisibilitySystems::CalculateBounds)
                        .after(bevy::asset::AssetEventSystems),
                ),
            );
        // So that every camera shows its settings. Bevy refuses once a camera has been spawned; one
        // without the component is treated as if it had the default.
        app.try_register_required_components::<Camera3d, VdbCamera>().ok();
        app.try_register_required_components::<Camera3d, VdbQuality>().ok();
        if app.get_sub_app(bevy::render::RenderApp).is_none() {
            return;
        }
        if app.is_plugin_added::<bevy::pbr::PbrPlugin>() {
            app.add_plugins((
                ExtractComponentPlugin::<VdbCamera>::default(),
                ExtractComponentPlugin::<VdbQuality>::default(),
                ExtractComponentPlugin::<LeftOut>::default(),
            ));
            app.add_plugins(render::RenderVolumesPlugin);
        } else {
            error!(
                "volumes are not shown: VdbRenderPlugin takes lights from Bevy's PbrPlugin; add that, or \
                 DefaultPlugins, before it"
            );
        }
    }
}
