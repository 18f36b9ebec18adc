//! What a packed grid has at a cell: the twin of `assets/shaders/traversal/tree.wgsl` and
//! `samples.wgsl`.

use glam::{IVec3, Vec3};

use super::grid::PackedGrid;
use super::kind::PackKind;
use super::layout::*;

/// A region around a cell in which all cells are equal: a cube of `2^log_dim` cells per edge, and
/// `skip` more such cubes ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// log₂ of the edge, in cells.
    pub log_dim: u32,
    /// The number of further cubes ahead on each axis that are also empty.
    pub skip: u32,
    /// The word of the tile or leaf that a ray meets; 0 if there is none.
    pub word: u32,
    /// The number of the leaf. For a cell of a boundary tile, the axes on which it is the tile's
    /// last cell: 4, 2 and 1 for x, y and z.
    pub leaf: u32,
}

impl Span {
    pub(super) const fn empty(log_dim: u32, skip: u32) -> Self {
        Self { log_dim, skip, word: 0, leaf: 0 }
    }

    /// Whether a ray meets something here.
    pub fn occupied(&self) -> bool {
        self.word != 0
    }

    /// Whether all of the cube is occupied with one value.
    pub fn constant(&self) -> bool {
        self.word & (CHILD | BOUNDARY) == 0
    }
}

/// The span of a tile around a local cell.
fn tile_span(word: u32, log_dim: u32, octant: u32, cell: IVec3) -> Span {
    if word & OCCUPIED == 0 {
        return Span::empty(log_dim, skip(word, octant));
    }
    if word & BOUNDARY == 0 {
        return Span { log_dim, skip: 0, word, leaf: 0 };
    }
    // The number of further cells of the tile on each axis.
    let after = !cell & ((1 << log_dim) - 1);
    let sides = after.cmpeq(IVec3::ZERO);
    if sides.any() {
        let sides = u32::from(sides.x) << 2 | u32::from(sides.y) << 1 | u32::from(sides.z);
        return Span { log_dim: 0, skip: 0, word, leaf: sides };
    }
    // The largest cube around the cell without cells on the high sides.
    let log_dim = after.min_element().ilog2();
    if word & FILLED == 0 {
        return Span::empty(log_dim, 0);
    }
    Span { log_dim, skip: 0, word: word & !BOUNDARY, leaf: 0 }
}

/// The span at a local cell. (The shader caches the last result.)
pub fn locate(grid: &PackedGrid, cell: IVec3, octant: u32) -> Span {
    let header = grid.header(0);
    // Traversal only visits cells of the grid's box, which the top-level tree covers.
    let top = grid.top_place(cell);
    let top =
        top.and_then(|at| find_top(&grid.words[header.top as usize..], header.top_levels, at));
    let Some((word, level)) = top else { return Span::empty(0, 0) };
    if word & CHILD == 0 {
        return tile_span(word, LOWER_BITS + 2 * level, octant, cell);
    }
    let lower_node = (word & PAYLOAD) as usize;
    let word =
        grid.words[header.lower_nodes as usize + lower_node * LOWER_WORDS + lower_slot(cell)];
    if word & CHILD == 0 {
        return tile_span(word, LEAF_BITS, octant, cell);
    }
    let number = word & ((1 << LEAF_NUMBER_BITS) - 1);
    let leaf = grid.words[header.heads as usize + lower_node] + number;
    let (index, bit) = mask_bit(cell);
    if word >> (LEAF_NUMBER_BITS + index as u32 / 2) & 1 == 0 {
        return Span::empty(2, 0);
    }
    let mask = header.masks as usize + leaf as usize * LEAF_MASK_WORDS;
    let on = grid.words[mask + index] >> bit & 1 == 1;
    if on { Span { log_dim: 0, skip: 0, word, leaf } } else { Span::empty(0, 0) }
}

/// A value of the palette.
pub(super) fn palette(grid: &PackedGrid, index: u32) -> f32 {
    f32::from_bits(grid.words[(grid.header(0).palette + index) as usize])
}

fn half(bits: u32) -> f32 {
    half::f16::from_bits(bits as u16).to_f32()
}

/// Decodes a value stored in 32 bits, in 16, or in a byte.
fn sample(grid: &PackedGrid, first: u32, index: u32, steps: (f32, f32)) -> f32 {
    let word = |per_word: u32| grid.words[(first + index / per_word) as usize];
    match grid.header.format {
        0 => f32::from_bits(word(1)),
        1 => half(word(2) >> (16 * (index & 1))) * grid.header.scale,
        _ => steps.0 + (word(4) >> (8 * (index & 3)) & 0xff) as f32 * steps.1,
    }
}

/// The first word of the samples of a leaf of fog, and the offset and the scale of samples in bytes.
fn brick_samples(grid: &PackedGrid, leaf: u32) -> (u32, (f32, f32)) {
    let first = grid.header.samples + leaf * grid.header.brick_words;
    if grid.header.format != 2 {
        return (first, (0.0, 0.0));
    }
    let step = |i: u32| f32::from_bits(grid.words[(first + i) as usize]);
    (first + 2, (step(0), step(1)))
}

/// All densities of a leaf of fog and those next to it on the high sides.
pub(super) fn brick(grid: &PackedGrid, leaf: u32) -> [f32; BRICK_VALUES] {
    let (first, steps) = brick_samples(grid, leaf);
    std::array::from_fn(|i| sample(grid, first, i as u32, steps))
}

/// The samples at the corners of an occupied cell outside constant tiles, `x·4 + y·2 + z`:
/// densities for fog, and values relative to the iso-value for a smooth surface.
pub fn corners(grid: &PackedGrid, span: Span, cell: IVec3) -> [f32; 8] {
    let header = grid.header(0);
    let corner = |i: usize| IVec3::new(i as i32 >> 2, i as i32 >> 1 & 1, i as i32 & 1);
    if span.word & CHILD == 0 {
        return std::array::from_fn(|i| {
            let value = palette(grid, (span.word & PAYLOAD) + (i as u32 & span.leaf));
            if grid.kind == PackKind::Fog { value } else { value * header.scale }
        });
    }
    if grid.kind == PackKind::Fog {
        let (first, steps) = brick_samples(grid, span.leaf);
        let slot = brick_slot(cell) as u32;
        return std::array::from_fn(|i| {
            let at = corner(i);
            sample(grid, first, slot + (at.x * 90 + at.y * 10 + at.z) as u32, steps)
        });
    }
    let block = mask_bit(cell).0 / 2;
    let before = (span.word >> LEAF_NUMBER_BITS & ((1 << block) - 1)).count_ones();
    let number = grid.words[(header.leaf_records + span.leaf) as usize] + before;
    let record = header.records as usize + number as usize * RECORD_WORDS;
    let record = &grid.words[record..record + RECORD_WORDS];
    let low = cell & 3;
    std::array::from_fn(|i| {
        let at = low + corner(i);
        let plane = record[at.x as usize];
        let below = plane & ((1 << (at.y * 5 + at.z)) - 1);
        let index = record[RECORD_WORDS - 1] + (plane >> RECORD_COUNT) + below.count_ones();
        sample(grid, header.samples, index, (-127.5 * header.scale, header.scale))
    })
}

/// The trilinear interpolant of the samples at a cell's corners.
pub(super) fn trilinear(corners: &[f32; 8], u: Vec3) -> f32 {
    let mix = |a: f32, b: f32, u: f32| a + (b - a) * u;
    let z = |i: usize| mix(corners[i], corners[i + 1], u.z);
    let y = |i: usize| mix(z(i), z(i + 2), u.y);
    mix(y(0), y(4), u.x)
}
