// Looking things up in a packed grid. The layout, and why it is so, is told in
// `crates/vdb_core/src/pack/layout.rs`; the twin of this file is `pack/walk.rs` beside it.
//
// Every index is in range by construction: words come from the packer alone, and a cell outside
// the crown is answered before anything is read.
#define_import_path bevy_vdb::tree

#import bevy_vdb::types::Grid
#import bevy_vdb::bindings::{nodes, masks, values}

const CHILD: u32 = 0x80000000u;
const OCCUPIED: u32 = 0x40000000u;
const MIXED: u32 = 0x20000000u;
const PAYLOAD: u32 = 0x1fffffffu;

const LEAF_BITS: u32 = 3u;
const LOWER_BITS: u32 = 7u;
const UPPER_BITS: u32 = 12u;

// What covers a cell: everything alike over a cube of 2^log_dim cells per edge.
struct Span {
    log_dim: u32,
    // The cell word of a tile, the leaf's word of a cell in a leaf, 0 where nothing is.
    word: u32,
}

fn span_occupied(span: Span) -> bool {
    return (span.word & OCCUPIED) != 0u;
}

// Whether the cube is occupied all over with one value.
fn span_constant(span: Span) -> bool {
    return (span.word & (CHILD | MIXED)) == 0u;
}

fn upper_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell >> vec3(LOWER_BITS)) & vec3(31u);
    return (c.x << 10u) | (c.y << 5u) | c.z;
}

fn lower_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell >> vec3(LEAF_BITS)) & vec3(15u);
    return (c.x << 8u) | (c.y << 4u) | c.z;
}

fn leaf_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell) & vec3(7u);
    return (c.x << 6u) | (c.y << 3u) | c.z;
}

// The word over a local cell at the level of the root, and what it covers.
fn find_root(grid: Grid, cell: vec3<i32>) -> Span {
    let at = (cell >> vec3(UPPER_BITS)) - grid.crown_origin;
    if ((at.x | at.y | at.z) >> (2u * grid.crown_levels)) != 0 {
        return Span(UPPER_BITS, 0u);
    }
    var node = grid.nodes;
    for (var level = grid.crown_levels; level > 0u;) {
        level -= 1u;
        let part = vec3<u32>(at >> vec3(2u * level)) & vec3(3u);
        let bit = (part.x << 4u) | (part.y << 2u) | part.z;
        let low = nodes[node];
        let word = select(nodes[node + 1u], low, bit < 32u);
        if ((word >> (bit & 31u)) & 1u) == 0u {
            return Span(UPPER_BITS + 2u * level, 0u);
        }
        let below = countOneBits(word & ((1u << (bit & 31u)) - 1u));
        let rank = below + select(countOneBits(low), 0u, bit < 32u);
        node = grid.nodes + nodes[node + 2u] + rank * select(3u, 1u, level == 0u);
    }
    return Span(UPPER_BITS, nodes[node]);
}

// The span of a word that leads nowhere further.
fn tile_span(word: u32, log_dim: u32) -> Span {
    if (word & OCCUPIED) == 0u {
        return Span(log_dim, 0u);
    }
    return Span(select(log_dim, 0u, (word & MIXED) != 0u), word);
}

fn leads_on(word: u32) -> bool {
    return (word & (OCCUPIED | CHILD)) == (OCCUPIED | CHILD);
}

// What a ray meets at a local cell.
fn locate(grid: Grid, cell: vec3<i32>) -> Span {
    let root = find_root(grid, cell);
    if !leads_on(root.word) {
        return tile_span(root.word, root.log_dim);
    }
    let upper = nodes[grid.uppers + ((root.word & PAYLOAD) << 15u) + upper_slot(cell)];
    if !leads_on(upper) {
        return tile_span(upper, LOWER_BITS);
    }
    let lower = nodes[grid.lowers + ((upper & PAYLOAD) << 12u) + lower_slot(cell)];
    if !leads_on(lower) {
        return tile_span(lower, LEAF_BITS);
    }
    let c = vec3<u32>(cell) & vec3(7u);
    let block = ((c.x >> 2u) << 2u) | ((c.y >> 2u) << 1u) | (c.z >> 2u);
    let bit = ((c.x & 3u) << 4u) | ((c.y & 3u) << 2u) | (c.z & 3u);
    let mask = grid.masks + ((lower & PAYLOAD) << 4u) + 2u * block;
    let low = masks[mask];
    let high = masks[mask + 1u];
    if (low | high) == 0u {
        return Span(2u, 0u);
    }
    let on = (select(high, low, bit < 32u) >> (bit & 31u)) & 1u;
    return Span(0u, select(0u, lower, on == 1u));
}

// The value of a tile.
fn tile_value(grid: Grid, word: u32) -> f32 {
    return values[grid.palette + (word & PAYLOAD)];
}

// The value at a local voxel.
fn value_at(grid: Grid, voxel: vec3<i32>) -> f32 {
    var word = find_root(grid, voxel).word;
    if (word & CHILD) != 0u {
        word = nodes[grid.uppers + ((word & PAYLOAD) << 15u) + upper_slot(voxel)];
        if (word & CHILD) != 0u {
            word = nodes[grid.lowers + ((word & PAYLOAD) << 12u) + lower_slot(voxel)];
            if (word & CHILD) != 0u {
                return values[grid.values + ((word & PAYLOAD) << 9u) + leaf_slot(voxel)];
            }
        }
    }
    return tile_value(grid, word);
}

// The samples at the corners of a trilinear cell: at the lower x (y0 z0, y0 z1, y1 z0,
// y1 z1), and the same at the higher.
struct Corners {
    low: vec4<f32>,
    high: vec4<f32>,
}

fn corners(grid: Grid, cell: vec3<i32>) -> Corners {
    let inside = all((cell & vec3(7)) < vec3(7));
    if inside {
        // All eight in one leaf or one tile: one descent.
        var word = find_root(grid, cell).word;
        if (word & CHILD) != 0u {
            word = nodes[grid.uppers + ((word & PAYLOAD) << 15u) + upper_slot(cell)];
            if (word & CHILD) != 0u {
                word = nodes[grid.lowers + ((word & PAYLOAD) << 12u) + lower_slot(cell)];
                if (word & CHILD) != 0u {
                    let v = grid.values + ((word & PAYLOAD) << 9u) + leaf_slot(cell);
                    return Corners(
                        vec4(values[v], values[v + 1u], values[v + 8u], values[v + 9u]),
                        vec4(values[v + 64u], values[v + 65u], values[v + 72u], values[v + 73u]),
                    );
                }
            }
        }
        let value = vec4(tile_value(grid, word));
        return Corners(value, value);
    }
    return Corners(
        vec4(
            value_at(grid, cell),
            value_at(grid, cell + vec3(0, 0, 1)),
            value_at(grid, cell + vec3(0, 1, 0)),
            value_at(grid, cell + vec3(0, 1, 1)),
        ),
        vec4(
            value_at(grid, cell + vec3(1, 0, 0)),
            value_at(grid, cell + vec3(1, 0, 1)),
            value_at(grid, cell + vec3(1, 1, 0)),
            value_at(grid, cell + vec3(1, 1, 1)),
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
