// The samples at the corners of occupied cells. How they are stored, and why so, is told in
// `crates/vdb_core/src/pack/layout.rs`; twin: `corners` in `pack/traverse.rs`.
//
// Every index is in range: leaves, records and places in the palette come from the packer, and so does
// the bit of each sample asked for, because a cell that is occupied has all its corners kept. The word
// after the last sample, which is read for nothing now and then, is the palette's first.
#define_import_path bevy_vdb::traversal::samples

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::gpu::bindings::word_at
#import bevy_vdb::traversal::tree::{CHILD, LEAF_NUMBER_BITS, PAYLOAD, Span, block_of}

const FLOATS: u32 = 0u;
const HALVES: u32 = 1u;

// The samples at the corners of a trilinear cell: at the lower x (y0 z0, y0 z1, y1 z0,
// y1 z1), and the same at the higher.
struct Corners {
    low: vec4<f32>,
    high: vec4<f32>,
}

// How a grid's samples are kept; known beforehand where all grids of a view have the same.
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

// Two samples that stand side by side, in the units in which they are kept.
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

// Two halves, of which the first is the upper one of its word if it is odd.
fn load_halves(at: u32, odd: bool) -> vec2<f32> {
    let low = word_at(at);
    let high = word_at(at + 1u);
    return unpack2x16float(select(low, (low >> 16u) | (high << 16u), odd));
}

// The corners of a cell on the high sides of a boundary tile, on some axes: 4, 2 and 1 for x, y and z.
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

// Where a leaf's brick of densities is, and what they are: offset + scale · what is kept.
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

// What is kept at the corners of a cell of a brick, by the place of its lowest sample.
fn brick_corners(grid: Grid, brick: Brick, slot: u32) -> Corners {
    if format_of(grid) == HALVES {
        // Rows are even, so that all four pairs are odd or none is.
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

// The densities in an occupied cell that is no constant tile's: offset + scale · what is at its corners.
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

// The values above the iso-value at the corners of a cell that a smooth surface passes through, in units of
// the grid's scale.
fn surface_corners(grid: Grid, span: Span, cell: vec3<i32>) -> Corners {
    if (span.word & CHILD) == 0u {
        return tile_corners(grid, span.word, span.leaf);
    }
    let blocks = (span.word >> LEAF_NUMBER_BITS) & ((1u << block_of(cell)) - 1u);
    let number = word_at(grid.leaf_records + span.leaf) + countOneBits(blocks);
    let record = grid.records + 6u * number;
    let c = vec3<u32>(cell) & vec3(3u);
    let low = word_at(record + c.x);
    let high = word_at(record + c.x + 1u);
    let first = word_at(record + 5u);
    // The samples before those of the cell, in its plane: at the lower y, and at the higher.
    let row_mask = (1u << (5u * c.y + c.z)) - 1u;
    let next_row_mask = (row_mask << 5u) | 31u;
    // Bytes are steps from below zero on.
    let zero = select(0.0, 127.5, format_of(grid) > HALVES);
    let low_first = first + (low >> 25u);
    let high_first = first + (high >> 25u);
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

// The trilinear interpolant at `u`, 0 to 1 on each axis.
fn trilinear(c: Corners, u: vec3<f32>) -> f32 {
    let yz = mix(c.low, c.high, u.x);
    let z = mix(yz.xy, yz.zw, u.y);
    return mix(z.x, z.y, u.z);
}

// Its gradient, in value per voxel.
fn trilinear_gradient(c: Corners, u: vec3<f32>) -> vec3<f32> {
    let dx = c.high - c.low;
    let dx_z = mix(dx.xy, dx.zw, u.y);
    let yz = mix(c.low, c.high, u.x);
    let dy = yz.zw - yz.xy;
    let z = mix(yz.xy, yz.zw, u.y);
    return vec3(mix(dx_z.x, dx_z.y, u.z), mix(dy.x, dy.y, u.z), z.y - z.x);
}
