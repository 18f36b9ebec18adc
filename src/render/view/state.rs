//! What is worked out for a view each frame, from which all passes take what they need.

use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy::render::render_resource::Buffer;
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::CachedTexture;
use vdb_core::view::ViewRays;

use super::key::ViewKey;
use super::list::ViewList;
use super::settings::ResolvedSettings;
use super::tiles::TileLayout;
use crate::render::gpu::types;

/// On views that see at least one volume.
#[derive(Component, Default)]
pub(crate) struct ViewState {
    /// What the view asks for, this frame.
    pub(super) resolved: Option<ResolvedView>,
    /// What it gets.
    pub prepared: Option<PreparedView>,
}

/// What a view asks for.
pub(crate) struct ResolvedView {
    pub settings: ResolvedSettings,
    pub rays: ViewRays,
    pub world_from_view: DAffine3,
    /// With jitter.
    pub clip_from_view: Mat4,
    pub list: ViewList,
    pub key: ViewKey,
    /// Whether all pipelines of the key have been compiled.
    pub is_ready: bool,
}

/// What a view gets: the pipelines' key, and all that shaders are told.
pub(crate) struct PreparedView {
    pub key: ViewKey,
    /// Whether all pipelines of the key have been compiled.
    pub is_ready: bool,
    /// Whether these pipelines draw in place of others that are being compiled.
    pub is_fallback: bool,
    pub data: types::View,
    /// Its list of volumes.
    pub volumes: Vec<types::Volume>,
    /// Whose the entries are that rays look at, in the order of the list.
    pub owners: Vec<MainEntity>,
    pub layout: TileLayout,
    /// The most tiles that show one volume.
    pub most_tiles: u32,
    /// With jitter.
    pub clip_from_view: Mat4,
    /// Whether surfaces may be in the picture.
    pub has_surfaces: bool,
    /// Whether pixels may be covered that show no surface.
    pub has_fog: bool,
    /// Made of `data`, once every pass has had its say.
    pub uniform: Option<Buffer>,
}

impl PreparedView {
    /// Rays along each axis.
    pub fn size(&self) -> UVec2 {
        self.data.size.into()
    }

    /// Pixels of the viewport.
    pub fn picture(&self) -> UVec2 {
        self.data.picture.into()
    }
}

impl ViewState {
    /// What the passes prepare in this frame.
    pub fn prepared(&self) -> Option<(&PreparedView, &Buffer)> {
        let prepared = self.prepared.as_ref()?;
        Some((prepared, prepared.uniform.as_ref()?))
    }

    /// What this view asks for has pipelines that are not compiled yet.
    pub fn wait_unless(&mut self, is_ready: impl FnOnce(&ViewKey) -> bool) {
        if let Some(resolved) = &mut self.resolved {
            resolved.is_ready &= is_ready(&resolved.key);
        }
    }
}

/// A picture that passes hand on.
#[derive(Clone)]
pub(crate) struct Picture {
    pub color: CachedTexture,
    pub depth: CachedTexture,
    /// Which volume each pixel moves with, and the depth of the place that moves; of views with motion
    /// vectors.
    pub moving: Option<CachedTexture>,
}

/// On views that see at least one volume: their picture, as it is handed from pass to pass.
#[derive(Component, Default)]
pub(crate) struct ViewPicture {
    /// One texel a ray.
    pub traced: Option<Picture>,
    /// What the last pass has made of it.
    pub shown: Option<Picture>,
}
