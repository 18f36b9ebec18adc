// Beam optimisation and tile culling, after Laine and Karras 2010, "Efficient sparse voxel octrees". One
// thread for each tile of 8×8 pixels that shows a volume: finds whether the tile's rays can hit the volume
// before opaque meshes end them, and where those rays can start.

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::{KIND_SMOOTH, Rays}
#import bevy_vdb::view::picture::{depth_of_meshes, t_of_depth}
#import bevy_vdb::view::scene::{target_pixel, view, volumes}
#import bevy_vdb::traversal::beam::{beam_of, beam_start_t, beam_box_t}
#import bevy_vdb::traversal::hdda::FAR

#ifdef MULTISAMPLED
@group(2) @binding(6) var scene_depth: texture_depth_multisampled_2d;
#else
@group(2) @binding(6) var scene_depth: texture_depth_2d;
#endif
// Bits for each tile, zeroed beforehand; then starts, as rows of tiles for each volume. Bits are only ever
// set, so the result does not depend on the order of threads.
@group(2) @binding(9) var<storage, read_write> tiles: array<atomic<u32>>;

const THREADS: u32 = 64u;

fn column_and_row(tile: u32) -> vec2<u32> {
    return vec2(tile & 0xffffu, tile >> 16u);
}

// The workgroups of a column share a volume.
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
            cull_tile(i, first + vec2(j % shown.x, j / shown.x));
        }
    }
}

// Whether opaque meshes end all rays of a tile before `t`. One ray is nearly always enough to tell.
fn is_occluded(tile: vec2<u32>, t: f32) -> bool {
    for (var i = 0u; i < 64u; i++) {
        let ray = 8u * tile + vec2(i & 7u, i >> 3u);
        if any(ray >= view.size) {
            continue;
        }
        let depth = depth_of_meshes(scene_depth, target_pixel(ray));
        if t_of_depth(view.t_from_depth, depth) >= t {
            return false;
        }
    }
    return true;
}

// The jittered rays of a view under temporal accumulation.
fn jittered_rays(rays: Rays) -> Rays {
    var jittered = rays;
    let ndc = view.jitter * vec2(2.0, -2.0) / vec2<f32>(view.size);
    jittered.eye_frac += ndc.x * rays.eye_x + ndc.y * rays.eye_y;
    jittered.dir_rest += ndc.x * rays.dir_x + ndc.y * rays.dir_y;
    return jittered;
}

fn cull_tile(i: u32, tile: vec2<u32>) {
    let size = (view.size + 7u) / 8u;
    if any(tile >= size) {
        return;
    }
    let volume = volumes[view.volume_first + i];
#ifdef VDB_ACCUMULATED
    let rays = jittered_rays(volume.rays);
#else
    let rays = volume.rays;
#endif
#ifdef VDB_LEVELS
    let t_near = max(view.t_near, volume.t_first);
    let t_end = volume.t_end;
#else
    let t_near = view.t_near;
    let t_end = FAR;
#endif
    let beam = beam_of(grids[volume.grid], rays, tile, view.size, t_near);
    // Test the box alone before descending into the tree.
    let t_box = beam_box_t(grids[volume.grid], beam);
    if t_box > t_end || is_occluded(tile, t_box) {
        return;
    }
    var start = t_box;
#ifdef VDB_CLIP
    // A solid is as empty to beams as the space around it, but a cap may be in front of all of its surface.
    let has_caps = volume.clip_planes != 0u && volume.kind == KIND_SMOOTH;
#else
    let has_caps = false;
#endif
    if !has_caps {
        start = beam_start_t(grids[volume.grid], beam);
    }
    if start >= FAR || start > t_end || (start > t_box && is_occluded(tile, start)) {
        return;
    }
    let bit = i >> view.group_bits;
    let at = tile.y * size.x + tile.x;
    atomicOr(&tiles[at * view.tile_words + (bit >> 5u)], 1u << (bit & 31u));
    if view.has_tile_starts != 0u {
        let starts = size.x * size.y * (view.tile_words + i);
        atomicStore(&tiles[starts + at], bitcast<u32>(start));
    }
}
