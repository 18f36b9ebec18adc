//! Files and grids as assets: reading, packing, cooking, editing and saving them.

pub(crate) mod background;
mod colors;
mod common;
mod cooked;
mod cooker;
mod decoded;
pub(crate) mod edits;
mod error;
mod file;
mod grid;
mod grid_loader;
mod labels;
pub(crate) mod loaded;
mod loader;
mod mesh;
mod pages;
pub(crate) mod parts;
mod points;
mod progress;
mod sequence;
mod settings;
mod vector_grid;

use bevy::prelude::*;

pub use common::VdbGridError;
pub(crate) use common::{bounds_of, corners, index_bounds};
pub use cooker::{VdbCookSettings, VdbCooker};
pub use error::VdbLoaderError;
pub use file::VdbFile;
pub use grid::VdbGrid;
pub use grid_loader::{VdbGridLoader, VdbVectorGridLoader};
pub use loader::VdbLoader;
pub use mesh::VdbMeshError;
pub use pages::{VdbPages, VdbPagesError, VdbPagesLoader};
pub use progress::{VdbFileProgress, VdbLoadProgress};
pub use sequence::{
    VdbAssetServerExt, VdbFrame, VdbRepeat, VdbSequence, VdbSequenceError, VdbSequenceLoader,
};
pub use settings::{VdbLoaderSettings, VdbPoints, VdbRenderAs, VdbValues};
pub use vector_grid::VdbVectorGrid;

use loaded::LoadedFiles;
use sequence::ListingServer;

pub(crate) use sequence::{DEFAULT_RATE, is_rate};

/// Loads `.vdb` files and sequences of them.
pub(crate) struct AssetPlugin;

impl Plugin for AssetPlugin {
    fn build(&self, app: &mut App) {
        let listing = ListingServer::new(app.world().resource::<AssetServer>());
        let (progress, loaded) = (VdbLoadProgress::default(), LoadedFiles::default());
        app.init_asset::<VdbGrid>()
            .init_asset::<VdbVectorGrid>()
            .init_asset::<VdbFile>()
            .init_asset::<VdbSequence>()
            .init_asset::<VdbPages>()
            // Where neither the load nor a `.meta` file determines the asset type, Bevy uses the
            // loader registered last.
            .register_asset_loader(VdbGridLoader::new(progress.clone()))
            .register_asset_loader(VdbVectorGridLoader::new(progress.clone()))
            .register_asset_loader(VdbLoader::new(progress.clone(), loaded.clone()))
            .register_asset_loader(listing.loader())
            .register_asset_loader(VdbPagesLoader)
            .register_asset_processor(VdbCooker)
            .insert_resource(listing)
            .insert_resource(progress)
            .insert_resource(loaded)
            .add_systems(Last, cooked::free_spare_memory);
    }
}
