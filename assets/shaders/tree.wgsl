// Looking things up in a packed grid. The layout, and why it is so, is told in
// `crates/vdb_core/src/pack/layout.rs`; the twin of this file is `pack/walk.rs` beside it.
//
// Every index is in range by construction: words come from the packer alone; a ray looks at cells of
// the grid's box only, which the crown covers; and values beyond the crown are answered before
// anything is read.
#define_import_path bevy_vdb::tree

#import bevy_vdb::types::Grid
#import bevy_vdb::bindings::{nodes, masks, values}

const CHILD: u32 = 0x80000000u;
const OCCUPIED: u32 = 0x40000000u;
const MIXED: u32 = 0x20000000u;
const PAYLOAD: u32 = 0x1fffffffu;

const LEAF_BITS: u32 = 3u;
const REGION_BITS: u32 = 7u;
const LEAF_NUMBER_BITS: u32 = 12u;
const LEAF_NUMBER: u32 = 0xfffu;

// What covers a cell: everything alike over a cube of 2^log_dim cells per edge, and over `reach` more
// such cubes ahead.
struct Span {
    log_dim: u32,
    reach: u32,
    // The word of a tile or a leaf that a ray meets; 0 where nothing is.
    word: u32,
}

fn span_occupied(span: Span) -> bool {
    return span.word != 0u;
}

// Whether the cube is occupied all over with one value.
fn span_constant(span: Span) -> bool {
    return (span.word & (CHILD | MIXED)) == 0u;
}

fn crown_slot(region: vec3<i32>, level: u32) -> u32 {
    let part = vec3<u32>(region >> vec3(2u * level)) & vec3(3u);
    return (part.x << 4u) | (part.y << 2u) | part.z;
}

fn region_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell >> vec3(LEAF_BITS)) & vec3(15u);
    return (c.x << 8u) | (c.y << 4u) | c.z;
}

fn leaf_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell) & vec3(7u);
    return (c.x << 6u) | (c.y << 3u) | c.z;
}

// The word of a crown over a local cell, and its level.
fn find_crown(grid: Grid, crown: u32, cell: vec3<i32>) -> vec2<u32> {
    let at = (cell >> vec3(REGION_BITS)) - grid.crown_origin;
    var level = grid.crown_levels - 1u;
    var word = nodes[crown + crown_slot(at, level)];
    while (word & CHILD) != 0u && level > 0u {
        level -= 1u;
        word = nodes[crown + ((word & PAYLOAD) << 6u) + crown_slot(at, level)];
    }
    return vec2(word, level);
}

// What has been found where a ray is; kept while the ray stays near.
struct Place {
    cell: vec3<i32>,
    // The word of the smallest slot that covers the cell, and log₂ of that slot's edge.
    word: u32,
    log_dim: u32,
    // Of a region: its first word, and the number of its first leaf.
    region: u32,
    head: u32,
}

// Nowhere near the cell.
fn nowhere(cell: vec3<i32>) -> Place {
    return Place(~cell, 0u, 0u, 0u, 0u);
}

// Slots beyond its own that a ray of an octant can leap over from an empty one.
fn reach_of(word: u32, octant: u32) -> u32 {
    let code = (word >> (3u * octant)) & 7u;
    // Nibbles of the reach by code: 0, 1, 2, 3, 5, 7, 11, 15.
    return (0xfb753210u >> (4u * code)) & 15u;
}

// The span of an empty cube. Without leaps, or without the tree's cubes, for comparison.
fn empty_span(log_dim: u32, reach: u32) -> Span {
#ifdef DDA
    return Span(0u, 0u, 0u);
#else ifdef HDDA
    return Span(select(0u, log_dim, log_dim >= LEAF_BITS), 0u, 0u);
#else
    return Span(log_dim, reach, 0u);
#endif
}

// The span of a tile of the traversal tree.
fn tile_span(word: u32, log_dim: u32, octant: u32) -> Span {
    if (word & OCCUPIED) == 0u {
        return empty_span(log_dim, reach_of(word, octant));
    }
    return Span(select(log_dim, 0u, (word & MIXED) != 0u), 0u, word);
}

// The word of the smallest slot over a local cell of the grid's box.
fn locate_slot(grid: Grid, cell: vec3<i32>, place: ptr<function, Place>) -> u32 {
    let apart = cell ^ (*place).cell;
    let moved = bitcast<u32>(apart.x | apart.y | apart.z);
    (*place).cell = cell;
    if (moved >> REGION_BITS) != 0u {
        let found = find_crown(grid, grid.crown, cell);
        (*place).word = found.x;
        (*place).log_dim = REGION_BITS + 2u * found.y;
        if (found.x & CHILD) != 0u {
            let number = found.x & PAYLOAD;
            (*place).log_dim = LEAF_BITS;
            (*place).region = grid.regions + (number << 12u);
            (*place).head = nodes[grid.heads + number];
        }
    }
    if (*place).log_dim == LEAF_BITS && (moved >> LEAF_BITS) != 0u {
        (*place).word = nodes[(*place).region + region_slot(cell)];
    }
    return (*place).word;
}

// The block of 4³ cells around a local cell, in a leaf with this word: bits x·16 + y·4 + z, low word
// first.
fn block_at(grid: Grid, cell: vec3<i32>, word: u32, head: u32) -> vec2<u32> {
    let c = vec3<u32>(cell) & vec3(4u);
    let block = c.x | (c.y >> 1u) | (c.z >> 2u);
    if ((word >> (LEAF_NUMBER_BITS + block)) & 1u) == 0u {
        return vec2(0u);
    }
    let mask = grid.masks + ((head + (word & LEAF_NUMBER)) << 4u) + 2u * block;
    return vec2(masks[mask], masks[mask + 1u]);
}

// What a ray of an octant meets at a local cell of the grid's box.
fn locate(grid: Grid, cell: vec3<i32>, octant: u32, place: ptr<function, Place>) -> Span {
    let word = locate_slot(grid, cell, place);
    if (word & CHILD) == 0u {
        return tile_span(word, (*place).log_dim, octant);
    }
    // Read anew for each cell of a block: it is close by, and two registers less to keep.
    let block = block_at(grid, cell, word, (*place).head);
    if (block.x | block.y) == 0u {
        return empty_span(2u, 0u);
    }
    let c = vec3<u32>(cell) & vec3(3u);
    let bit = ((c.x & 1u) << 4u) | (c.y << 2u) | c.z;
    let on = (select(block.y, block.x, (c.x & 2u) == 0u) >> bit) & 1u;
    return Span(0u, 0u, select(0u, word, on == 1u));
}

// The value of a tile.
fn tile_value(grid: Grid, word: u32) -> f32 {
    return values[grid.palette + (word & PAYLOAD)];
}

// The word of the value tree's crown over a local voxel.
fn value_crown_word(grid: Grid, voxel: vec3<i32>) -> u32 {
    let at = (voxel >> vec3(REGION_BITS)) - grid.crown_origin;
    if ((at.x | at.y | at.z) >> (2u * grid.crown_levels)) != 0 {
        // Beyond the crown there is the background, tile value 0.
        return 0u;
    }
    return find_crown(grid, grid.value_crown, voxel).x;
}

// The value at a local voxel under a word of the value tree's crown.
fn value_under(grid: Grid, crown_word: u32, voxel: vec3<i32>) -> f32 {
    var word = crown_word;
    if (word & CHILD) != 0u {
        word = nodes[grid.value_regions + ((word & PAYLOAD) << 12u) + region_slot(voxel)];
        if (word & CHILD) != 0u {
            return values[grid.values + ((word & PAYLOAD) << 9u) + leaf_slot(voxel)];
        }
    }
    return tile_value(grid, word);
}

// The value beside a local voxel whose own word of the crown is known: nearly always in its region.
fn value_beside(grid: Grid, crown_word: u32, voxel: vec3<i32>, step: vec3<i32>) -> f32 {
    let beside = voxel + step;
    var word = crown_word;
    if any(((voxel ^ beside) >> vec3(REGION_BITS)) != vec3(0)) {
        word = value_crown_word(grid, beside);
    }
    return value_under(grid, word, beside);
}

// The samples at the corners of a trilinear cell: at the lower x (y0 z0, y0 z1, y1 z0,
// y1 z1), and the same at the higher.
struct Corners {
    low: vec4<f32>,
    high: vec4<f32>,
}

fn corners(grid: Grid, cell: vec3<i32>) -> Corners {
    let crown_word = value_crown_word(grid, cell);
    if all((cell & vec3(7)) < vec3(7)) {
        // All eight in one leaf or one tile: one descent.
        var word = crown_word;
        if (word & CHILD) != 0u {
            word = nodes[grid.value_regions + ((word & PAYLOAD) << 12u) + region_slot(cell)];
            if (word & CHILD) != 0u {
                let v = grid.values + ((word & PAYLOAD) << 9u) + leaf_slot(cell);
                return Corners(
                    vec4(values[v], values[v + 1u], values[v + 8u], values[v + 9u]),
                    vec4(values[v + 64u], values[v + 65u], values[v + 72u], values[v + 73u]),
                );
            }
        }
        let value = vec4(tile_value(grid, word));
        return Corners(value, value);
    }
    return Corners(
        vec4(
            value_under(grid, crown_word, cell),
            value_beside(grid, crown_word, cell, vec3(0, 0, 1)),
            value_beside(grid, crown_word, cell, vec3(0, 1, 0)),
            value_beside(grid, crown_word, cell, vec3(0, 1, 1)),
        ),
        vec4(
            value_beside(grid, crown_word, cell, vec3(1, 0, 0)),
            value_beside(grid, crown_word, cell, vec3(1, 0, 1)),
            value_beside(grid, crown_word, cell, vec3(1, 1, 0)),
            value_beside(grid, crown_word, cell, vec3(1, 1, 1)),
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
