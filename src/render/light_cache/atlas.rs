//! The texture of the light cache, and which rows of bricks are in use. `light_cache/bricks.wgsl` has the same
//! layout.

use std::ops::Range;

use bevy::render::render_resource::{
    Extent3d, Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
    TextureView,
};
use bevy::render::renderer::RenderDevice;

use crate::render::view::BRICK_INTERVALS;

/// Samples along an edge of a brick, which shares those on its faces with its neighbours.
pub(super) const BRICK_SAMPLES: u32 = BRICK_INTERVALS + 1;
/// Texels of a brick along x.
const BRICK_WIDTH: u32 = 10;
/// Bricks in a row, which is the unit of allocation.
pub(super) const ROW_BRICKS: u32 = 64;
/// Rows in a layer of the texture.
const LAYER_ROWS: u32 = 64;
/// Texels along x: lines are a multiple of the 256 bytes that copies require.
pub(super) const WIDTH: u32 = ROW_BRICKS * BRICK_WIDTH;
/// Bytes of a texel.
const TEXEL_BYTES: u32 = 2;
pub(super) const LINE_BYTES: u32 = WIDTH * TEXEL_BYTES;
/// Bytes of a row of bricks.
pub(super) const ROW_BYTES: u64 = (LINE_BYTES * BRICK_SAMPLES * BRICK_SAMPLES) as u64;

/// Bytes of a row of bricks of scattered light, whose texels are four 16-bit floats.
pub(super) const SCATTERED_ROW_BYTES: u64 = 4 * ROW_BYTES;

/// The texture of 16-bit floats, and the rows in use.
pub(super) struct Atlas {
    pub texture: Texture,
    pub view: TextureView,
    rows: Rows,
}

impl Atlas {
    /// A texture with this many rows; with none, a single texel, for shaders that read nothing.
    pub fn new(rows: u32, device: &RenderDevice) -> Self {
        let size = texture_size(rows);
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("vdb_light_atlas"),
            size: if rows > 0 { size } else { Extent3d::default() },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D3,
            format: TextureFormat::R16Float,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        Self { texture, view, rows: Rows::new(rows) }
    }

    /// The rows of bricks in the texture.
    pub fn len(&self) -> u32 {
        self.rows.len
    }

    pub fn allocate(&mut self, count: u32) -> Option<Range<u32>> {
        self.rows.allocate(count)
    }

    pub fn free(&mut self, rows: Range<u32>) {
        self.rows.free(rows);
    }

    /// 1 / size of the texture in texels.
    pub fn texel(&self) -> [f32; 3] {
        let size = self.texture.size();
        [size.width, size.height, size.depth_or_array_layers].map(|texels| 1.0 / texels as f32)
    }

    pub fn bytes(&self) -> u64 {
        let size = self.texture.size();
        u64::from(size.width * size.height) * u64::from(size.depth_or_array_layers * TEXEL_BYTES)
    }
}

/// The size of a texture with this many rows.
pub(crate) fn texture_size(rows: u32) -> Extent3d {
    Extent3d {
        width: WIDTH,
        height: rows.min(LAYER_ROWS) * BRICK_SAMPLES,
        depth_or_array_layers: rows.div_ceil(LAYER_ROWS) * BRICK_SAMPLES,
    }
}

/// The most rows that a texture can have.
pub(super) fn max_rows(device: &RenderDevice) -> u32 {
    let edge = device.limits().max_texture_dimension_3d;
    if edge < WIDTH.max(LAYER_ROWS * BRICK_SAMPLES) {
        return 0;
    }
    edge / BRICK_SAMPLES * LAYER_ROWS
}

/// The first texel of a row.
pub(super) fn row_origin(row: u32) -> [u32; 2] {
    [row % LAYER_ROWS * BRICK_SAMPLES, row / LAYER_ROWS * BRICK_SAMPLES]
}

/// The parts of a range of rows that are in the same layer.
pub(super) fn rows_by_layer(rows: Range<u32>) -> impl Iterator<Item = Range<u32>> {
    let layers = rows.start / LAYER_ROWS..rows.end.div_ceil(LAYER_ROWS);
    layers.map(move |layer| {
        rows.start.max(layer * LAYER_ROWS)..rows.end.min((layer + 1) * LAYER_ROWS)
    })
}

/// A first-fit allocator.
struct Rows {
    len: u32,
    /// Disjoint, in order, and never adjacent.
    free: Vec<Range<u32>>,
}

impl Rows {
    fn new(len: u32) -> Self {
        let mut rows = Self { len, free: Vec::new() };
        rows.free(0..len);
        rows
    }

    fn allocate(&mut self, count: u32) -> Option<Range<u32>> {
        let i = self.free.iter().position(|gap| gap.end - gap.start >= count)?;
        let gap = &mut self.free[i];
        let found = gap.start..gap.start + count;
        gap.start = found.end;
        if gap.start == gap.end {
            self.free.remove(i);
        }
        Some(found)
    }

    fn free(&mut self, rows: Range<u32>) {
        if rows.is_empty() {
            return;
        }
        let i = self.free.partition_point(|gap| gap.start < rows.start);
        self.free.insert(i, rows);
        if self.free.get(i + 1).is_some_and(|next| next.start == self.free[i].end) {
            self.free[i].end = self.free.remove(i + 1).end;
        }
        if i > 0 && self.free[i - 1].end == self.free[i].start {
            self.free[i - 1].end = self.free.remove(i).end;
        }
    }
}

#[cfg(test)]
mod tests {
    use vdb_core::synth::Random;

    use super::*;

    #[test]
    fn rows_are_divided_at_the_ends_of_layers() {
        let parts = |rows| rows_by_layer(rows).collect::<Vec<_>>();
        assert_eq!(parts(63..65), [63..64, 64..65]);
        assert_eq!(parts(0..128), [0..64, 64..128]);
        assert_eq!(parts(60..200), [60..64, 64..128, 128..192, 192..200]);
    }

    #[test]
    fn rows_are_used_once_and_joined_when_they_are_free() {
        let mut rows = Rows::new(100);
        let mut used: Vec<Range<u32>> = Vec::new();
        let mut random = Random::new(1);
        for _ in 0..10_000 {
            if random.below(2) == 0 {
                if let Some(new) = rows.allocate(1 + random.below(20) as u32) {
                    let apart = |old: &Range<u32>| old.end <= new.start || new.end <= old.start;
                    assert!(used.iter().all(apart) && new.end <= 100, "{new:?} {used:?}");
                    used.push(new);
                }
            } else if !used.is_empty() {
                rows.free(used.swap_remove(random.below(used.len() as u64) as usize));
            }
        }
        used.drain(..).for_each(|own| rows.free(own));
        assert!(rows.free.len() == 1 && rows.free[0] == (0..100), "{:?}", rows.free);
        assert_eq!(rows.allocate(101), None);
    }
}
