//! Where the lattices of point and spot lights are, for the shaders of one view.

use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TexelCopyBufferLayout, Texture, TextureFormat, TextureView,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};

use crate::render::gpu::{table_texture, types};

/// The most rows: WebGPU's default limit of textures.
pub(super) const MAX_ROWS: usize = 8192;
/// Lamps per texel.
const TEXEL: usize = 4;

/// Where the lattice of a fog for each lamp in the cache is, then that of its scattered light: packed positions.
type Row = [u32; types::MAX_CACHED_LAMPS + TEXEL];

/// The entry of a lamp that has no lattice.
const NOT_CACHED: u32 = u32::MAX;

/// A row for each volume that the view displays.
#[derive(Default)]
pub(super) struct LampTable {
    rows: Vec<Row>,
    uploaded: Option<Uploaded>,
}

struct Uploaded {
    rows: Vec<Row>,
    texture: Texture,
    view: TextureView,
}

impl LampTable {
    /// Clears the table, keeping at least one row. Volumes beyond the last row have no lattices.
    pub fn clear(&mut self, volumes: usize) {
        self.rows.clear();
        self.rows.resize(volumes.clamp(1, MAX_ROWS), [NOT_CACHED; _]);
    }

    /// Sets the packed position of a lattice; `volume` is less than [`MAX_ROWS`].
    pub fn set(&mut self, volume: usize, slot: usize, origin: u32) {
        self.rows[volume][slot] = origin;
    }

    /// Sets the packed position of a fog's scattered light, and the distances from a point light and from the eye
    /// at which light begins to be interpolated; `volume` is less than [`MAX_ROWS`].
    pub fn set_scattered(&mut self, volume: usize, origin: u32, [lamp, eye]: [f32; 2]) {
        let texel = [origin, lamp.to_bits(), eye.to_bits(), 0];
        self.rows[volume][types::MAX_CACHED_LAMPS..].copy_from_slice(&texel);
    }

    /// Uploads the table if it has changed.
    pub fn upload(&mut self, device: &RenderDevice, queue: &RenderQueue) {
        let bytes: &[u8] = bytemuck::cast_slice(&self.rows);
        let size = Extent3d {
            width: (size_of::<Row>() / size_of::<u32>() / TEXEL) as u32,
            height: self.rows.len() as u32,
            depth_or_array_layers: 1,
        };
        match &mut self.uploaded {
            Some(uploaded) if uploaded.rows.len() == self.rows.len() => {
                if uploaded.rows != self.rows {
                    uploaded.rows.clone_from(&self.rows);
                    let bytes_per_row = Some(size_of::<Row>() as u32);
                    let layout = TexelCopyBufferLayout { bytes_per_row, ..default() };
                    queue.write_texture(uploaded.texture.as_image_copy(), bytes, layout, size);
                }
            }
            uploaded => {
                let (label, format) = ("vdb_lamp_lattices", TextureFormat::Rgba32Uint);
                let size = UVec2::new(size.width, size.height);
                let texture = table_texture(device, queue, label, format, size, bytes);
                let view = texture.create_view(&default());
                *uploaded = Some(Uploaded { rows: self.rows.clone(), texture, view });
            }
        }
    }

    pub fn view(&self) -> Option<&TextureView> {
        self.uploaded.as_ref().map(|uploaded| &uploaded.view)
    }

    /// Bytes of the texture.
    pub fn bytes(&self) -> u64 {
        self.uploaded.as_ref().map_or(0, |uploaded| size_of_val(&*uploaded.rows) as u64)
    }
}
