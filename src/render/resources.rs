//! Buffers and textures of a view.

use bevy::image::ToExtents;
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferInitDescriptor, BufferUsages, TextureDescriptor, TextureDimension, TextureFormat,
    TextureUsages,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::{CachedTexture, TextureCache};

use super::accumulate::Accumulated;
use super::gpu_data;
use super::motion::ViewMotion;
use super::pipeline::TraceKey;
use super::tiles::{self, TileLayout};
use super::upscale::Upscaled;

/// Of the texture that says what moves.
const MOVING: TextureFormat = TextureFormat::Rg32Uint;

/// A texture that one pass writes and the next reads.
pub(super) fn picture_texture(
    label: &'static str,
    format: TextureFormat,
    size: UVec2,
) -> TextureDescriptor<'static> {
    TextureDescriptor {
        label: Some(label),
        size: size.to_extents(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    }
}

/// On views that see at least one volume: what the passes need.
#[derive(Component)]
pub(super) struct ViewResources {
    pub view: Buffer,
    pub placement: Buffer,
    pub color: CachedTexture,
    pub depth: CachedTexture,
    /// What the tiles know of the volumes, and how it is laid out.
    pub tile_data: Option<(Buffer, TileLayout)>,
    pub motion: Option<ViewMotion>,
    /// The volumes that the view sees and that can be shown, in the order of their entities.
    pub listed: Vec<MainEntity>,
    pub volumes: u32,
    /// Those that shadows and reflections look at, and the view does not.
    pub volumes_beside: u32,
    /// The most tiles that show one of them.
    pub most_tiles: u32,
    /// What is shown in place of what is traced, where there are fewer rays than pixels.
    pub upscaled: Option<Upscaled>,
    /// And in place of that, where frames are put together.
    pub accumulated: Option<Accumulated>,
    /// Rays, and pixels of the viewport.
    pub size: UVec2,
    pub picture: UVec2,
}

/// What they are made from.
pub(super) struct ViewFrame<'a> {
    pub key: &'a TraceKey,
    pub data: &'a gpu_data::View,
    pub layout: TileLayout,
    pub most_tiles: u32,
    /// Of the view and its volumes, where it has motion vectors.
    pub motion: Option<Vec<Mat4>>,
    pub accumulated: Option<Accumulated>,
    pub listed: Vec<MainEntity>,
}

impl ViewResources {
    /// Buffers that stay as they are go from frame to frame.
    pub fn new(
        frame: ViewFrame,
        before: Option<&Self>,
        device: &RenderDevice,
        textures: &mut TextureCache,
    ) -> Self {
        let ViewFrame { key, data, layout, .. } = frame;
        let (size, picture) = (UVec2::from(data.size), UVec2::from(data.picture));
        let buffer = |label, contents: &[u8], usage| {
            let label = Some(label);
            device.create_buffer_with_data(&BufferInitDescriptor { label, contents, usage })
        };
        let mut texture =
            |label, format, size: UVec2| textures.get(device, picture_texture(label, format, size));
        let motion = frame.motion.map(|matrices| ViewMotion {
            moving: texture("vdb_moving", MOVING, size),
            matrices: buffer("vdb_motion", bytemuck::cast_slice(&matrices), BufferUsages::STORAGE),
        });
        let upscaled = key.scaled.then(|| Upscaled {
            color: texture("vdb_color_upscaled", TextureFormat::Rgba16Float, picture),
            depth: texture("vdb_depth_upscaled", TextureFormat::R32Float, picture),
            moving: key.motion.then(|| texture("vdb_moving_upscaled", MOVING, picture)),
        });
        let tile_data = key.beams.then(|| {
            let kept = before.and_then(|before| before.tile_data.as_ref());
            (layout.buffer(kept.map(|(buffer, _)| buffer), device), layout)
        });
        let placement = gpu_data::Placement { origin: data.origin, size: data.picture };
        let placement = bytemuck::bytes_of(&placement);
        Self {
            view: buffer("vdb_view", bytemuck::bytes_of(data), BufferUsages::UNIFORM),
            placement: buffer("vdb_placement", placement, BufferUsages::UNIFORM),
            color: texture("vdb_color", TextureFormat::Rgba16Float, size),
            depth: texture("vdb_depth", TextureFormat::R32Float, size),
            tile_data,
            motion,
            listed: frame.listed,
            volumes: data.volume_count,
            volumes_beside: data.volumes_beside,
            most_tiles: frame.most_tiles,
            upscaled,
            accumulated: frame.accumulated,
            size,
            picture,
        }
    }

    /// What the composite shows: colour, depth, and what moves.
    pub fn shown(&self) -> (&CachedTexture, &CachedTexture, Option<&CachedTexture>) {
        let own = match &self.upscaled {
            Some(upscaled) => (&upscaled.color, &upscaled.depth, upscaled.moving.as_ref()),
            None => (&self.color, &self.depth, self.motion.as_ref().map(|motion| &motion.moving)),
        };
        match self.accumulated.as_ref().and_then(Accumulated::shown) {
            Some(mean) => (&mean.color, &mean.depth, own.2),
            None => own,
        }
    }

    /// Tiles of rays.
    pub fn tiles(&self) -> UVec2 {
        tiles::tiles(self.size)
    }
}
