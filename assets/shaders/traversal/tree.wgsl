// Look-ups in a packed grid. `crates/vdb_core/src/pack/layout.rs` describes the layout and the reasons for
// it. Twin: `crates/vdb_core/src/pack/cells.rs`.
//
// Every index is in range by construction: words come from the packer only, and rays only look up cells of
// the grid's box, which the top-level tree covers.
#define_import_path bevy_vdb::traversal::tree

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::gpu::bindings::word_at

const CHILD: u32 = 0x80000000u;
const OCCUPIED: u32 = 0x40000000u;
const BOUNDARY: u32 = 0x20000000u;
const FILLED: u32 = 0x10000000u;
const PAYLOAD: u32 = 0x0fffffffu;

const LEAF_BITS: u32 = 3u;
const LOWER_BITS: u32 = 7u;
const LEAF_NUMBER_BITS: u32 = 12u;
const LEAF_NUMBER: u32 = 0xfffu;

// A uniform region around a cell: a cube of 2^log_dim cells per edge, and `skip` more such cubes ahead.
struct Span {
    log_dim: u32,
    skip: u32,
    // The word of the tile or leaf; 0 if the region is empty.
    word: u32,
    // In leaves: the leaf's number. In boundary tiles: a bit mask of the axes on which the cell is the
    // tile's last, 4, 2 and 1 for x, y and z.
    leaf: u32,
}

// The span of an empty cell.
fn empty_cell() -> Span {
    return Span(0u, 0u, 0u, 0u);
}

fn span_occupied(span: Span) -> bool {
    return span.word != 0u;
}

// Whether a single value fills the whole cube.
fn span_constant(span: Span) -> bool {
    return (span.word & (CHILD | BOUNDARY)) == 0u;
}

fn top_slot(lower_node: vec3<i32>, level: u32) -> u32 {
    let part = vec3<u32>(lower_node >> vec3(2u * level)) & vec3(3u);
    return (part.x << 4u) | (part.y << 2u) | part.z;
}

fn lower_slot(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell >> vec3(LEAF_BITS)) & vec3(15u);
    return (c.x << 8u) | (c.y << 4u) | c.z;
}

// The place of a local cell's lower node in the top-level tree.
fn top_place(grid: Grid, cell: vec3<i32>) -> vec3<i32> {
    return (cell >> vec3(LOWER_BITS)) - grid.top_origin;
}

// Whether the top-level tree covers a local cell, so that it can be looked up. Rays do not ask, because their box is
// covered.
fn covers(grid: Grid, cell: vec3<i32>) -> bool {
    let at = top_place(grid, cell);
    return ((at.x | at.y | at.z) >> (2u * grid.top_levels)) == 0;
}

// The word of the top-level tree that covers a local cell, and its level.
fn find_top(grid: Grid, cell: vec3<i32>) -> vec2<u32> {
    let at = top_place(grid, cell);
    var level = grid.top_levels - 1u;
    var found = word_at(grid.top + top_slot(at, level));
    while (found & CHILD) != 0u && level > 0u {
        level -= 1u;
        found = word_at(grid.top + ((found & PAYLOAD) << 6u) + top_slot(at, level));
    }
    return vec2(found, level);
}

// Caches the path to the last cell that was looked up, like OpenVDB's `ValueAccessor`.
struct Accessor {
    cell: vec3<i32>,
    // The word of the smallest slot that covers the cell, and log₂ of that slot's edge.
    word: u32,
    log_dim: u32,
    // The first word of the lower node, and the number of its first leaf.
    lower_node: u32,
    head: u32,
}

// An accessor that caches nothing. `cell` must be the first that is looked up: the cell of the accessor differs from it
// in every bit.
fn new_accessor(cell: vec3<i32>) -> Accessor {
    return Accessor(~cell, 0u, 0u, 0u, 0u);
}

// An accessor that caches nothing, for `slot_at`, whose first cell may be any.
fn empty_accessor() -> Accessor {
    return Accessor();
}

// Number of further slots that a ray of an octant can skip from an empty slot.
fn skip_of(word: u32, octant: u32) -> u32 {
    let code = (word >> (3u * octant)) & 7u;
    // One nibble per code: 0, 1, 2, 3, 5, 7, 11, 15.
    return (0xfb753210u >> (4u * code)) & 15u;
}

// The span of an empty cube. `VDB_DDA` ignores cubes and `VDB_HDDA` ignores skips, for comparison.
fn empty_span(log_dim: u32, skip: u32) -> Span {
#ifdef VDB_DDA
    return empty_cell();
#else ifdef VDB_HDDA
    return Span(select(0u, log_dim, log_dim >= LEAF_BITS), 0u, 0u, 0u);
#else
    return Span(log_dim, skip, 0u, 0u);
#endif
}

// The span of a tile around a local cell.
fn tile_span(tile: u32, log_dim: u32, octant: u32, cell: vec3<i32>) -> Span {
    if (tile & OCCUPIED) == 0u {
        return empty_span(log_dim, skip_of(tile, octant));
    }
    if (tile & BOUNDARY) == 0u {
        return Span(log_dim, 0u, tile, 0u);
    }
    // Cells of the tile beyond this one on each axis.
    let after = ~bitcast<vec3<u32>>(cell) & vec3((1u << log_dim) - 1u);
    let sides = dot(vec3<u32>(after == vec3(0u)), vec3(4u, 2u, 1u));
    if sides != 0u {
        return Span(0u, 0u, tile, sides);
    }
    // The largest cube around the cell that contains none of the cells on the high sides.
    let log_inner = firstLeadingBit(min(min(after.x, after.y), after.z));
    if (tile & FILLED) == 0u {
        return empty_span(log_inner, 0u);
    }
    return Span(log_inner, 0u, tile & ~BOUNDARY, 0u);
}

// The word of the smallest slot that covers a local cell of the grid's box.
fn locate_slot(grid: Grid, cell: vec3<i32>, accessor: ptr<function, Accessor>) -> u32 {
    let changed = cell ^ (*accessor).cell;
    return locate_moved(grid, cell, bitcast<u32>(changed.x | changed.y | changed.z), accessor);
}

// The same, with the bits in which any coordinate may differ from the last cell's.
fn locate_moved(grid: Grid, cell: vec3<i32>, moved: u32, accessor: ptr<function, Accessor>) -> u32 {
    (*accessor).cell = cell;
    if (moved >> LOWER_BITS) != 0u {
        let found = find_top(grid, cell);
        (*accessor).word = found.x;
        (*accessor).log_dim = LOWER_BITS + 2u * found.y;
        if (found.x & CHILD) != 0u {
            let number = found.x & PAYLOAD;
            (*accessor).log_dim = LEAF_BITS;
            (*accessor).lower_node = grid.lower_nodes + (number << 12u);
            (*accessor).head = word_at(grid.heads + number);
        }
    }
    if (*accessor).log_dim == LEAF_BITS && (moved >> LEAF_BITS) != 0u {
        (*accessor).word = word_at((*accessor).lower_node + lower_slot(cell));
    }
    return (*accessor).word;
}

// Whether the block of 4³ cells around a local cell is not empty, in a leaf with this word.
fn has_block(leaf_word: u32, cell: vec3<i32>) -> bool {
    return ((leaf_word >> (LEAF_NUMBER_BITS + block_of(cell))) & 1u) != 0u;
}

// Occupancy of the block of 4³ cells around a local cell, in a leaf with this word and number: bit x·16 +
// y·4 + z, low word first.
fn block_at(grid: Grid, cell: vec3<i32>, leaf_word: u32, leaf: u32) -> vec2<u32> {
    if !has_block(leaf_word, cell) {
        return vec2(0u);
    }
    let mask = grid.masks + (leaf << 4u) + 2u * block_of(cell);
    return vec2(word_at(mask), word_at(mask + 1u));
}

// Index of a cell's block in its leaf.
fn block_of(cell: vec3<i32>) -> u32 {
    let c = vec3<u32>(cell) & vec3(4u);
    return c.x | (c.y >> 1u) | (c.z >> 2u);
}

// The span around a local cell of the grid's box for a ray of an octant.
fn locate(grid: Grid, cell: vec3<i32>, octant: u32, accessor: ptr<function, Accessor>) -> Span {
    let slot = locate_slot(grid, cell, accessor);
    if (slot & CHILD) == 0u {
        return tile_span(slot, (*accessor).log_dim, octant, cell);
    }
    // Read again for every cell of a block: the words are in cache, and keeping them would take two
    // registers.
    let leaf = (*accessor).head + (slot & LEAF_NUMBER);
    let block = block_at(grid, cell, slot, leaf);
    if (block.x | block.y) == 0u {
        return empty_span(2u, 0u);
    }
    let c = vec3<u32>(cell) & vec3(3u);
    let bit = ((c.x & 1u) << 4u) | (c.y << 2u) | c.z;
    let on = (select(block.y, block.x, (c.x & 2u) == 0u) >> bit) & 1u;
    return Span(0u, 0u, select(0u, slot, on == 1u), leaf);
}
