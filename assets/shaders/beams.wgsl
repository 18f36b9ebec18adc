// A thread for every tile of 8×8 pixels that shows a volume: whether the tile's rays can meet it, and
// where those to it can begin.

#import bevy_vdb::bindings::grids
#import bevy_vdb::scene::{view, volumes}
#import bevy_vdb::beam::{beam_of, beam_start}
#import bevy_vdb::hdda::FAR

// Bits, tile by tile, all zero before; then starts: rows of tiles, volume by volume. Bits are only ever
// set, so that no order of threads shows.
@group(2) @binding(9) var<storage, read_write> tiles: array<atomic<u32>>;

const THREADS: u32 = 64u;

fn column_and_row(tile: u32) -> vec2<u32> {
    return vec2(tile & 0xffffu, tile >> 16u);
}

// Workgroups of a column share a volume.
@compute @workgroup_size(64, 1, 1)
fn beams(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    for (var i = group.x; i < view.volume_count; i += groups.x) {
        let first = column_and_row(volumes[view.volume_first + i].tiles_first);
        let end = column_and_row(volumes[view.volume_first + i].tiles_last) + 1u;
        if any(end <= first) {
            continue;
        }
        let shown = end - first;
        let count = shown.x * shown.y;
        for (var j = group.y * THREADS + thread; j < count; j += groups.y * THREADS) {
            look(i, first + vec2(j % shown.x, j / shown.x));
        }
    }
}

fn look(i: u32, tile: vec2<u32>) {
    let size = (view.size + 7u) / 8u;
    if any(tile >= size) {
        return;
    }
    let volume = volumes[view.volume_first + i];
    let beam = beam_of(grids[volume.grid], volume.rays, tile, view.size, view.t_near);
    let start = beam_start(grids[volume.grid], beam);
    if start >= FAR {
        return;
    }
    let bit = i >> view.group_bits;
    let at = tile.y * size.x + tile.x;
    atomicOr(&tiles[at * view.tile_words + (bit >> 5u)], 1u << (bit & 31u));
    if view.keeps_starts != 0u {
        let starts = size.x * size.y * (view.tile_words + i);
        atomicStore(&tiles[starts + at], bitcast<u32>(start));
    }
}
