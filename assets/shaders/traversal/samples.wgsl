// Samples at the corners of occupied cells. `crates/vdb_core/src/pack/layout.rs` describes how they are
// stored and why. Twin: `corners` in `crates/vdb_core/src/pack/cells.rs`.
//
// Every index is in range. Leaves, records and palette indices come from the packer. So do the bits of the
// requested samples: all corners of an occupied cell are stored, and `stored_pair` tests the bit. The word
// after the last sample, which is sometimes read but not used, is the first word of the palette.
#define_import_path bevy_vdb::traversal::samples

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::gpu::bindings::word_at
#import bevy_vdb::traversal::tree::{CHILD, LEAF_NUMBER_BITS, PAYLOAD, Span, block_of}

const FLOATS: u32 = 0u;
const HALVES: u32 = 1u;

// Samples at the corners of a trilinear cell: at the lower x (y0 z0, y0 z1, y1 z0, y1 z1), then the same at
// the higher x.
struct Corners {
    low: vec4<f32>,
    high: vec4<f32>,
}

// The sample format of a grid; a constant if all grids of a view share one format.
fn format_of(grid: Grid) -> u32 {
#ifdef VDB_FORMAT
    return #{VDB_FORMAT}u;
#else
    return grid.format;
#endif
}

// The value of a tile.
fn tile_value(grid: Grid, tile: u32) -> f32 {
    return bitcast<f32>(word_at(grid.palette + (tile & PAYLOAD)));
}

// Two consecutive samples, in stored units.
fn load_pair(grid: Grid, first: u32, index: u32) -> vec2<f32> {
    if format_of(grid) == FLOATS {
        let at = first + index;
        return vec2(bitcast<f32>(word_at(at)), bitcast<f32>(word_at(at + 1u)));
    }
    if format_of(grid) == HALVES {
        let at = first + (index >> 1u);
        return load_halves(at, (index & 1u) == 1u);
    }
    let at = first + (index >> 2u);
    let low = word_at(at);
    let high = word_at(at + 1u);
    let shift = 8u * (index & 3u);
    let bytes = (low >> shift) | select(0u, high << 8u, shift == 24u);
    return vec2(f32(bytes & 255u), f32((bytes >> 8u) & 255u));
}

// Two consecutive 16-bit floats. If `odd`, the first is the upper half of its word.
fn load_halves(at: u32, odd: bool) -> vec2<f32> {
    let low = word_at(at);
    let high = word_at(at + 1u);
    return unpack2x16float(select(low, (low >> 16u) | (high << 16u), odd));
}

// Corners of a cell on the high sides of a boundary tile. `sides` is a bit mask: 4, 2 and 1 for x, y and z.
fn tile_corners(grid: Grid, tile: u32, sides: u32) -> Corners {
    let yz = vec4(0u, 1u, 2u, 3u) & vec4(sides);
    let x = sides & 4u;
    return Corners(
        vec4(
            tile_value(grid, tile + yz.x),
            tile_value(grid, tile + yz.y),
            tile_value(grid, tile + yz.z),
            tile_value(grid, tile + yz.w),
        ),
        vec4(
            tile_value(grid, tile + x + yz.x),
            tile_value(grid, tile + x + yz.y),
            tile_value(grid, tile + x + yz.z),
            tile_value(grid, tile + x + yz.w),
        ),
    );
}

// A leaf's brick of densities. A density is offset + scale · stored value.
struct Brick {
    first: u32,
    offset: f32,
    scale: f32,
}

fn brick_of(grid: Grid, leaf: u32) -> Brick {
    let first = grid.samples + leaf * grid.brick_words;
    if format_of(grid) == FLOATS {
        return Brick(first, 0.0, 1.0);
    }
    if format_of(grid) == HALVES {
        return Brick(first, 0.0, grid.scale);
    }
    return Brick(first + 2u, bitcast<f32>(word_at(first)), bitcast<f32>(word_at(first + 1u)));
}

fn brick_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell) & vec3(7u);
    return c.x * 90u + c.y * 10u + c.z;
}

// Stored values at the corners of a cell in a brick. `slot` is the index of its lowest sample.
fn brick_corners(grid: Grid, brick: Brick, slot: u32) -> Corners {
    if format_of(grid) == HALVES {
        // Rows have even lengths, so either all four pairs are odd or none is.
        let at = brick.first + (slot >> 1u);
        let odd = (slot & 1u) == 1u;
        return Corners(
            vec4(load_halves(at, odd), load_halves(at + 5u, odd)),
            vec4(load_halves(at + 45u, odd), load_halves(at + 50u, odd)),
        );
    }
    return Corners(
        vec4(load_pair(grid, brick.first, slot), load_pair(grid, brick.first, slot + 10u)),
        vec4(load_pair(grid, brick.first, slot + 90u), load_pair(grid, brick.first, slot + 100u)),
    );
}

// Densities at the corners of an occupied cell outside constant tiles: offset + scale · corner value.
struct FogCell {
    corners: Corners,
    offset: f32,
    scale: f32,
}

fn fog_cell(grid: Grid, span: Span, cell: vec3<i32>) -> FogCell {
    if (span.word & CHILD) == 0u {
        return FogCell(tile_corners(grid, span.word, span.leaf), 0.0, 1.0);
    }
    let brick = brick_of(grid, span.leaf);
    return FogCell(brick_corners(grid, brick, brick_slot(cell)), brick.offset, brick.scale);
}

// In a record of a block: where the number of its first sample is, and the lowest bit of the count in the
// word of a plane.
const RECORD_FIRST: u32 = 5u;
const RECORD_COUNT: u32 = 25u;

// The record of the block around a cell, which is not empty, in a leaf with this word and number.
fn record_of(grid: Grid, leaf_word: u32, leaf: u32, cell: vec3<i32>) -> u32 {
    let blocks_before = (leaf_word >> LEAF_NUMBER_BITS) & ((1u << block_of(cell)) - 1u);
    let number = word_at(grid.leaf_records + leaf) + countOneBits(blocks_before);
    return grid.records + 6u * number;
}

// The iso-value among the stored samples of a smooth surface: bytes are unsigned.
fn stored_zero(grid: Grid) -> f32 {
    return select(0.0, 127.5, format_of(grid) > HALVES);
}

// Values relative to the iso-value at the corners of a cell that a smooth surface passes through, in units
// of the grid's scale.
fn surface_corners(grid: Grid, span: Span, cell: vec3<i32>) -> Corners {
    if (span.word & CHILD) == 0u {
        return tile_corners(grid, span.word, span.leaf);
    }
    let record = record_of(grid, span.word, span.leaf, cell);
    let c = vec3<u32>(cell) & vec3(3u);
    let low = word_at(record + c.x);
    let high = word_at(record + c.x + 1u);
    let first = word_at(record + RECORD_FIRST);
    // Samples in the cell's plane that precede those of the cell, at the lower y and at the higher y.
    let row_mask = (1u << (5u * c.y + c.z)) - 1u;
    let next_row_mask = (row_mask << 5u) | 31u;
    let zero = stored_zero(grid);
    let low_first = first + (low >> RECORD_COUNT);
    let high_first = first + (high >> RECORD_COUNT);
    return Corners(
        vec4(
            load_pair(grid, grid.samples, low_first + countOneBits(low & row_mask)),
            load_pair(grid, grid.samples, low_first + countOneBits(low & next_row_mask)),
        ) - zero,
        vec4(
            load_pair(grid, grid.samples, high_first + countOneBits(high & row_mask)),
            load_pair(grid, grid.samples, high_first + countOneBits(high & next_row_mask)),
        ) - zero,
    );
}

// The sample of a record at a place in its block, 0 to 4 on each axis, and the next one along z, relative to
// the iso-value; two other samples if the first is not stored.
fn stored_pair(grid: Grid, record: u32, at: vec3<u32>) -> vec2<f32> {
    let plane = word_at(record + at.x);
    let bit = 5u * at.y + at.z;
    let before = (plane >> RECORD_COUNT) + countOneBits(plane & ((1u << bit) - 1u));
    let index = select(0u, before, ((plane >> bit) & 1u) != 0u);
    return load_pair(grid, grid.samples, word_at(record + RECORD_FIRST) + index) - stored_zero(grid);
}

// The trilinear interpolant at `u`, 0 to 1 on each axis.
fn trilinear(c: Corners, u: vec3<f32>) -> f32 {
    let yz = mix(c.low, c.high, u.x);
    let z = mix(yz.xy, yz.zw, u.y);
    return mix(z.x, z.y, u.z);
}

// The Bézier control points of the cubic that the interpolant is from `start` to `end`, both 0 to 1 on each axis. The
// interpolant is linear in each coordinate, so they are the means of its values at the points that have none, one, two
// or all three coordinates of `end` (its blossom: Ramshaw, "Blossoms are polar forms", 1989).
fn control_points(c: Corners, start: vec3<f32>, end: vec3<f32>) -> vec4<f32> {
    // `s` and `e` stand for coordinates of `start` and `end`. `mix` is exact at 0 and 1, where cells must agree on signs.
    let s = mix(c.low, c.high, start.x);
    let e = mix(c.low, c.high, end.x);
    let ss = mix(s.xy, s.zw, start.y);
    let se = mix(s.xy, s.zw, end.y);
    let es = mix(e.xy, e.zw, start.y);
    let ee = mix(e.xy, e.zw, end.y);
    let low = vec4(ss.x, se.x, es.x, ee.x);
    let high = vec4(ss.y, se.y, es.y, ee.y);
    let at_start = mix(low, high, start.z);
    let at_end = mix(low, high, end.z);
    return vec4(
        at_start.x,
        (at_end.x + at_start.y + at_start.z) * (1.0 / 3.0),
        (at_end.y + at_end.z + at_start.w) * (1.0 / 3.0),
        at_end.w,
    );
}

// Gradient of the trilinear interpolant, in values per voxel.
fn trilinear_gradient(c: Corners, u: vec3<f32>) -> vec3<f32> {
    let dx = c.high - c.low;
    let dx_z = mix(dx.xy, dx.zw, u.y);
    let yz = mix(c.low, c.high, u.x);
    let dy = yz.zw - yz.xy;
    let z = mix(yz.xy, yz.zw, u.y);
    return vec3(mix(dx_z.x, dx_z.y, u.z), mix(dy.x, dy.y, u.z), z.y - z.x);
}
