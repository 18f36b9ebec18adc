//! Tiles of an image: which volumes the rays of each tile can meet, and where they can start.

use bevy::math::{DMat4, DVec2, DVec3};
use bevy::prelude::*;
use bevy::render::render_resource::{Buffer, BufferDescriptor, BufferUsages};
use bevy::render::renderer::RenderDevice;

use crate::asset::corners;
use crate::render::gpu::{TILE, tiles};

/// The largest tile buffer of a view, in words: 16 MiB.
const MAX_WORDS: u64 = 1 << 22;

/// The range of tiles that show a box: the first and the last column and row. Empty if `first` is
/// beyond `last`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TileRange {
    pub first: UVec2,
    pub last: UVec2,
}

impl TileRange {
    pub const NONE: Self = Self { first: UVec2::ONE, last: UVec2::ZERO };

    /// The tiles that show a box, given the matrix from its space to clip space: no tiles if the
    /// whole box is behind the eye, and all tiles if part of it is.
    pub fn of_box(clip_from_box: DMat4, min: DVec3, max: DVec3, size: UVec2) -> Self {
        let whole = Self { first: UVec2::ZERO, last: tiles(size).saturating_sub(UVec2::ONE) };
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let corners = corners((min, max)).map(|at| clip_from_box * at.extend(1.0));
        if corners.clone().all(|clip| clip.w <= 0.0) {
            return Self::NONE;
        }
        for clip in corners {
            let ndc = clip.xy() / clip.w;
            if !(clip.w > 0.0 && ndc.is_finite()) {
                return whole;
            }
            low = low.min(ndc);
            high = high.max(ndc);
        }
        // Rows go downwards. One more pixel on each side covers the rounding of rays to f32.
        let at = |ndc: DVec2| (0.5 + 0.5 * ndc * DVec2::new(1.0, -1.0)) * size.as_dvec2();
        let (first, last) =
            (at(DVec2::new(low.x, high.y)) - 1.0, at(DVec2::new(high.x, low.y)) + 1.0);
        if first.cmpge(size.as_dvec2()).any() || last.cmplt(DVec2::ZERO).any() {
            return Self::NONE;
        }
        Self {
            first: first.max(DVec2::ZERO).as_uvec2() / TILE,
            last: (last.as_uvec2() / TILE).min(whole.last),
        }
    }

    /// The range as the shader reads it: 16 bits each for column and row.
    pub fn words(self) -> [u32; 2] {
        [self.first, self.last].map(|tile| tile.x | tile.y << 16)
    }

    /// The number of tiles.
    pub fn count(self) -> u32 {
        (self.last + 1).saturating_sub(self.first).element_product()
    }
}

/// The layout of the tile buffer: for each tile, a bit for each volume of the view, or for each
/// group of volumes if there are very many; then, if there is room, a ray start for each volume and
/// tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TileLayout {
    tiles: u64,
    volumes: u64,
    /// The number of words of bits per tile.
    pub tile_words: u32,
    /// log₂ of the number of volumes that share a bit.
    pub group_bits: u32,
    pub has_starts: bool,
}

impl TileLayout {
    pub fn new(size: UVec2, volumes: u32) -> Self {
        let tiles = tiles(size).as_u64vec2().element_product();
        let volumes = u64::from(volumes);
        let words = |group_bits: u32| volumes.div_ceil(1 << group_bits).div_ceil(32).max(1);
        let fits = |group_bits: &u32| words(*group_bits) * tiles <= MAX_WORDS;
        // With 31, every tile has one word.
        let group_bits = (0..32).find(fits).unwrap_or(31);
        let tile_words = words(group_bits);
        let has_starts = group_bits == 0 && tiles * (tile_words + volumes) <= MAX_WORDS;
        Self { tiles, volumes, tile_words: tile_words as u32, group_bits, has_starts }
    }

    /// The size of the bits, which come first, in bytes.
    pub fn bits_size(&self) -> u64 {
        4 * self.tiles * u64::from(self.tile_words)
    }

    fn size(&self) -> u64 {
        self.bits_size() + if self.has_starts { 4 * self.tiles * self.volumes } else { 0 }
    }

    /// A buffer of this layout: the previous one if it has the same size.
    pub fn buffer(&self, before: Option<&Buffer>, device: &RenderDevice) -> Buffer {
        let kept = before.filter(|buffer| buffer.size() == self.size()).cloned();
        kept.unwrap_or_else(|| {
            device.create_buffer(&BufferDescriptor {
                label: Some("vdb_tiles"),
                size: self.size(),
                // `COPY_DST`, because the bits are cleared every frame.
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_volume_has_a_bit_and_memory_is_bounded() {
        let sizes = [UVec2::ONE, UVec2::new(1920, 1080), UVec2::new(3840, 2160)];
        for size in sizes.into_iter().chain([UVec2::splat(16_384)]) {
            for volumes in [1, 32, 33, 64, 129, 1000, 5000, 100_000, u32::MAX] {
                let layout = TileLayout::new(size, volumes);
                let bits = u64::from(layout.tile_words) * 32;
                assert!(bits << layout.group_bits >= u64::from(volumes), "{layout:?}");
                assert!(layout.size() <= 4 * MAX_WORDS, "{layout:?}");
            }
        }
    }

    #[test]
    fn tiles_that_show_a_box_are_found() {
        let size = UVec2::new(160, 80);
        let clip = DMat4::perspective_infinite_reverse_rh(90_f64.to_radians(), 2.0, 0.1);
        let cube = |center: DVec3| TileRange::of_box(clip, center - 0.5, center + 0.5, size);
        // The front of the cube is at distance 9, so it covers ±0.5 / 9 · 40 pixels.
        let middle = cube(DVec3::new(0.0, 0.0, -9.5));
        assert_eq!((middle.first, middle.last), (UVec2::new(9, 4), UVec2::new(10, 5)));
        assert_eq!(middle.count(), 4);
        let up_left = cube(DVec3::new(-18.0, 9.0, -10.0));
        // The cube ends at row 7.6, and one more pixel is in the next tile.
        assert_eq!((up_left.first, up_left.last), (UVec2::ZERO, UVec2::ONE));
        for beside in [DVec3::new(30.0, 0.0, -10.0), DVec3::new(0.0, -20.0, -10.0)] {
            assert_eq!(cube(beside).count(), 0, "{beside}");
        }
        assert_eq!(cube(DVec3::ZERO).count(), 200, "the eye is in it");
        assert_eq!(cube(DVec3::Z).count(), 0, "behind the eye");
        assert_eq!(cube(DVec3::NAN).count(), 200);
    }

    #[test]
    fn what_fits_is_kept() {
        let hd = |volumes| TileLayout::new(UVec2::new(1920, 1080), volumes);
        assert!(hd(1).has_starts && hd(100).has_starts);
        assert!(!hd(1000).has_starts);
        assert_eq!((hd(1000).tile_words, hd(1000).group_bits), (32, 0));
        assert!(hd(10_000).group_bits > 0);
    }
}
