// The samples at the corners of occupied cells. How they are stored, and why so, is told in
// `crates/vdb_core/src/pack/layout.rs`; twin: `corners` in `pack/walk.rs`.
//
// Every index is in range: leaves, records and places in the palette come from the packer, and so does
// the bit of each sample asked for, because a cell that is occupied has all its corners kept. The word
// after the last sample, which is read for nothing now and then, is the palette's first.
#define_import_path bevy_vdb::samples

#import bevy_vdb::types::Grid
#import bevy_vdb::bindings::word_at
#import bevy_vdb::tree::{CHILD, LEAF_NUMBER_BITS, PAYLOAD, WIDE, Span, block_of}

const FLOATS: u32 = 0u;
const HALVES: u32 = 1u;

// The samples at the corners of a trilinear cell: at the lower x (y0 z0, y0 z1, y1 z0,
// y1 z1), and the same at the higher.
struct Corners {
    low: vec4<f32>,
    high: vec4<f32>,
}

// The value of a tile.
fn tile_value(grid: Grid, tile: u32) -> f32 {
    return bitcast<f32>(word_at(grid.palette + (tile & PAYLOAD)));
}

// Two samples that stand side by side. Bytes are steps: x is what 0 stands for, y the size of one.
fn pair(grid: Grid, first: u32, index: u32, steps: vec2<f32>) -> vec2<f32> {
    if grid.format == FLOATS {
        let at = first + index;
        return vec2(bitcast<f32>(word_at(at)), bitcast<f32>(word_at(at + 1u)));
    }
    if grid.format == HALVES {
        let at = first + (index >> 1u);
        let low = word_at(at);
        let high = word_at(at + 1u);
        let halves = select(low, (low >> 16u) | (high << 16u), (index & 1u) == 1u);
        return grid.scale * unpack2x16float(halves);
    }
    let at = first + (index >> 2u);
    let low = word_at(at);
    let high = word_at(at + 1u);
    let shift = 8u * (index & 3u);
    let bytes = (low >> shift) | select(0u, high << 8u, shift == 24u);
    return steps.x + steps.y * vec2(f32(bytes & 255u), f32((bytes >> 8u) & 255u));
}

// The corners of a cell of a mixed tile.
fn tile_corners(grid: Grid, tile: u32, cell: vec3<i32>) -> Corners {
    let last = vec3(select(7, 127, (tile & WIDE) != 0u));
    // What is beyond the tile on each axis.
    let beyond = select(vec3(0u), vec3(4u, 2u, 1u), (cell & last) == last);
    let yz = vec4(0u, beyond.z, beyond.y, beyond.y + beyond.z);
    return Corners(
        vec4(
            tile_value(grid, tile + yz.x),
            tile_value(grid, tile + yz.y),
            tile_value(grid, tile + yz.z),
            tile_value(grid, tile + yz.w),
        ),
        vec4(
            tile_value(grid, tile + beyond.x + yz.x),
            tile_value(grid, tile + beyond.x + yz.y),
            tile_value(grid, tile + beyond.x + yz.z),
            tile_value(grid, tile + beyond.x + yz.w),
        ),
    );
}

// Where a leaf's brick of densities is, and its steps.
struct Brick {
    first: u32,
    steps: vec2<f32>,
}

fn brick_of(grid: Grid, leaf: u32) -> Brick {
    let first = grid.samples + leaf * grid.brick_words;
    if grid.format > HALVES {
        return Brick(first + 2u, vec2(bitcast<f32>(word_at(first)), bitcast<f32>(word_at(first + 1u))));
    }
    return Brick(first, vec2(0.0));
}

// The corners of a cell of a brick, by the place of its lowest sample.
fn brick_corners(grid: Grid, brick: Brick, slot: u32) -> Corners {
    return Corners(
        vec4(
            pair(grid, brick.first, slot, brick.steps),
            pair(grid, brick.first, slot + 9u, brick.steps),
        ),
        vec4(
            pair(grid, brick.first, slot + 81u, brick.steps),
            pair(grid, brick.first, slot + 90u, brick.steps),
        ),
    );
}

// The densities at the corners of an occupied cell that is no constant tile's.
fn fog_corners(grid: Grid, span: Span, cell: vec3<i32>) -> Corners {
    if (span.word & CHILD) == 0u {
        return tile_corners(grid, span.word, cell);
    }
    let c = vec3<u32>(cell) & vec3(7u);
    return brick_corners(grid, brick_of(grid, span.leaf), c.x * 81u + c.y * 9u + c.z);
}

// The values above the iso-value at the corners of a cell that a smooth surface passes through.
fn surface_corners(grid: Grid, span: Span, cell: vec3<i32>) -> Corners {
    if (span.word & CHILD) == 0u {
        return tile_corners(grid, span.word, cell);
    }
    let blocks = (span.word >> LEAF_NUMBER_BITS) & ((1u << block_of(cell)) - 1u);
    let number = word_at(grid.leaf_records + span.leaf) + countOneBits(blocks);
    let record = grid.records + 6u * number;
    let c = vec3<u32>(cell) & vec3(3u);
    let low = word_at(record + c.x);
    let high = word_at(record + c.x + 1u);
    let first = word_at(record + 5u);
    // The samples before those of the cell, in its plane: at the lower y, and at the higher.
    let here = (1u << (5u * c.y + c.z)) - 1u;
    let next = (here << 5u) | 31u;
    let steps = vec2(grid.offset, grid.scale);
    let low_first = first + (low >> 25u);
    let high_first = first + (high >> 25u);
    return Corners(
        vec4(
            pair(grid, grid.samples, low_first + countOneBits(low & here), steps),
            pair(grid, grid.samples, low_first + countOneBits(low & next), steps),
        ),
        vec4(
            pair(grid, grid.samples, high_first + countOneBits(high & here), steps),
            pair(grid, grid.samples, high_first + countOneBits(high & next), steps),
        ),
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
