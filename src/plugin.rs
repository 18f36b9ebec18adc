//! The main plugin, and the group of all plugins.

use bevy::app::PluginGroupBuilder;
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponentPlugin;

use crate::asset::AssetPlugin;
use crate::pages::PagesPlugin;
use crate::quality::{LeftOut, QualityPlugin};
use crate::render::RenderVolumesPlugin;
use crate::scene::ScenePlugin;
use crate::{VdbCamera, VdbQuality};

/// Loads `.vdb` files and displays [`VdbVolume`](crate::VdbVolume)s in every `Camera3d`.
///
/// Add it after `DefaultPlugins`: it panics without Bevy's `AssetPlugin`. Without a renderer (on a
/// server, or in a test with `MinimalPlugins` and `AssetPlugin`) it still loads files, keeps bounds
/// up to date and answers ray casts.
#[derive(Clone, Copy, Debug, Default)]
pub struct VdbRenderPlugin;

impl Plugin for VdbRenderPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins((AssetPlugin, ScenePlugin, QualityPlugin, PagesPlugin));
        if app.get_sub_app(bevy::render::RenderApp).is_none() {
            return;
        }
        if app.is_plugin_added::<bevy::pbr::PbrPlugin>() {
            app.add_plugins((
                ExtractComponentPlugin::<VdbCamera>::default(),
                ExtractComponentPlugin::<VdbQuality>::default(),
                ExtractComponentPlugin::<LeftOut>::default(),
                RenderVolumesPlugin,
            ));
        } else {
            error!(
                "volumes are not shown: VdbRenderPlugin needs Bevy's PbrPlugin for lights; add it, \
                 or DefaultPlugins, before VdbRenderPlugin"
            );
        }
    }
}

/// [`VdbRenderPlugin`], and the plugins of all enabled cargo features: picking and recording.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// App::new().add_plugins((DefaultPlugins, VdbPlugins)).run();
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct VdbPlugins;

impl PluginGroup for VdbPlugins {
    fn build(self) -> PluginGroupBuilder {
        let group = PluginGroupBuilder::start::<Self>().add(VdbRenderPlugin);
        #[cfg(feature = "picking")]
        let group = group.add(crate::VdbPickingPlugin);
        #[cfg(feature = "record")]
        let group = group.add(crate::VdbRecordPlugin);
        group
    }
}
