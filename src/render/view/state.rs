//! The per-frame state of a view, which all passes read.

use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy::render::render_resource::Buffer;
use bevy::render::texture::CachedTexture;
use vdb_core::view::ViewRays;

use super::key::ViewKey;
use super::list::{Entry, ViewList};
use super::queue::{AskedPipelines, PipelineQueue};
use super::settings::ResolvedSettings;
use super::tiles::TileLayout;
use crate::render::gpu::types;

/// The state of a view that sees at least one volume.
#[derive(Component, Default)]
pub(crate) struct ViewState {
    /// The resolved settings of this frame, until they are prepared.
    pub(super) resolved: Option<ResolvedView>,
    /// The data that the passes use.
    pub prepared: Option<PreparedView>,
    pub(super) pipelines: PipelineQueue,
}

/// A resolved view: what its settings require.
pub(crate) struct ResolvedView {
    pub settings: ResolvedSettings,
    pub rays: ViewRays,
    pub world_from_view: DAffine3,
    /// The projection, with jitter.
    pub clip_from_view: Mat4,
    pub list: ViewList,
    /// The key of the pipelines that it needs.
    pub key: ViewKey,
    pub asked: AskedPipelines,
}

/// A prepared view: the key of its pipelines, and the data of its shaders.
pub(crate) struct PreparedView {
    pub key: ViewKey,
    /// Whether all pipelines of the key have been compiled.
    pub is_ready: bool,
    /// Whether these pipelines draw in place of others that are being compiled.
    pub is_fallback: bool,
    pub data: types::View,
    /// The volume list.
    pub volumes: Vec<types::Volume>,
    /// The origin of the rays in world space.
    pub eye: DVec3,
    /// The entries that rays can meet, in the order of the list.
    pub entries: Vec<Entry>,
    pub layout: TileLayout,
    /// The largest number of tiles that show one volume.
    pub most_tiles: u32,
    /// The projection, with jitter.
    pub clip_from_view: Mat4,
    /// Whether surfaces may be in view.
    pub has_surfaces: bool,
    /// Whether pixels without a surface may be covered.
    pub has_fog: bool,
    /// The uniform buffer of `data`, once all passes have adjusted it.
    pub uniform: Option<Buffer>,
}

impl PreparedView {
    /// The number of entries that are displayed; only shadows of the others are.
    pub fn displayed(&self) -> usize {
        self.key.displayed(self.data.volume_count as usize, self.entries.len())
    }

    /// The number of rays along each axis.
    pub fn size(&self) -> UVec2 {
        self.data.size.into()
    }

    /// The size of the viewport in pixels.
    pub fn picture(&self) -> UVec2 {
        self.data.picture.into()
    }
}

impl ViewState {
    /// The prepared view and its uniform buffer.
    pub fn prepared(&self) -> Option<(&PreparedView, &Buffer)> {
        let prepared = self.prepared.as_ref()?;
        Some((prepared, prepared.uniform.as_ref()?))
    }

    /// The pipelines that the view asks for: a pass whose own may still be compiling says so there.
    pub fn asked(&mut self) -> Option<&mut AskedPipelines> {
        self.resolved.as_mut().map(|resolved| &mut resolved.asked)
    }
}

/// An image that passes hand on.
#[derive(Clone)]
pub(crate) struct Picture {
    pub color: CachedTexture,
    pub depth: CachedTexture,
    /// For each pixel, the volume that it moves with and the depth of the moving point; in views
    /// with motion vectors.
    pub moving: Option<CachedTexture>,
}

/// The image of a view that sees at least one volume, handed from pass to pass.
#[derive(Component, Default)]
pub(crate) struct ViewPicture {
    /// The output of the trace, with one texel per ray.
    pub traced: Option<Picture>,
    /// The same, denoised in views with denoised reflections.
    pub rays: Option<Picture>,
    /// The output of the last pass so far.
    pub shown: Option<Picture>,
}
