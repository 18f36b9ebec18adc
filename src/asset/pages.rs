//! The index of a paged surface as an asset.

use std::sync::Arc;

use bevy::asset::io::Reader;
use bevy::asset::{Asset, AssetLoader, AssetPath, LoadContext};
use bevy::math::DVec3;
use bevy::prelude::*;
use thiserror::Error;
use vdb_core::pages::{EXTENSION, PageId, PageIndex, PageIndexError};

use super::common::{bounds_of, corners, read_at_most, within};
use crate::VdbLimits;

/// A surface cut into pages, of which only those that cameras need are in memory: what a `.vdbpages`
/// file lists, for a [`VdbPagedVolume`](crate::VdbPagedVolume).
///
/// `vdb cook --pages` makes the file and a folder of pages for each level of detail beside it. Each
/// page is a file of its own, loaded as a [`VdbGrid`](crate::VdbGrid) from the same asset source, so
/// a web server that serves files is enough.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbPages {
    index: Arc<PageIndex>,
    folder: AssetPath<'static>,
}

impl VdbPages {
    /// The pages of an index, whose files are in a folder.
    pub fn new(index: PageIndex, folder: impl Into<AssetPath<'static>>) -> Self {
        Self { index: Arc::new(index), folder: folder.into() }
    }

    /// What pages there are, and their sizes.
    pub fn index(&self) -> &Arc<PageIndex> {
        &self.index
    }

    /// The low and the high corner of the box around all pages in the space of the entity that shows
    /// them; `None` if there is nothing to show. It reaches beyond the surface by up to a page.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        // The finest pages are closest to the surface.
        let pages = self.index.pages.keys().filter(|id| id.level == 0 && self.index.has_grid(**id));
        let corners = pages.flat_map(|id| corners(self.index.index_bounds(*id)));
        let (low, high) =
            bounds_of(corners.map(|at| self.index.world_from_index.transform_point3(at)));
        low.cmple(high).all().then_some((low, high))
    }

    /// The file of a page.
    pub fn path(&self, page: PageId) -> AssetPath<'static> {
        within(&self.folder, &page.file())
    }
}

/// Why a `.vdbpages` file could not be loaded. Bevy logs it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VdbPagesError {
    /// The file could not be read.
    #[error("the index of pages cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// The file is damaged, foreign, or of another version.
    #[error(transparent)]
    Index(#[from] PageIndexError),
}

/// Loads `.vdbpages` files as [`VdbPages`]. Registered by
/// [`VdbRenderPlugin`](crate::VdbRenderPlugin). In `.meta` files it is `"bevy_vdb::VdbPagesLoader"`.
#[derive(Clone, Copy, Debug, Default, TypePath)]
#[type_path = "bevy_vdb"]
pub struct VdbPagesLoader;

impl AssetLoader for VdbPagesLoader {
    type Asset = VdbPages;
    type Settings = ();
    type Error = VdbPagesError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _: &(),
        load_context: &mut LoadContext<'_>,
    ) -> Result<VdbPages, VdbPagesError> {
        let limits = VdbLimits::default();
        // What exceeds the limit is refused, and need not be read.
        let bytes = read_at_most(reader, limits.file_bytes).await?;
        let index = PageIndex::read(&bytes, &limits)?;
        let path = load_context.path();
        let parent = path.path().parent().unwrap_or(path.path()).to_owned();
        let folder = AssetPath::from_path_buf(parent).with_source(path.source().clone_owned());
        Ok(VdbPages::new(index, folder))
    }

    fn extensions(&self) -> &[&str] {
        &[EXTENSION]
    }
}
