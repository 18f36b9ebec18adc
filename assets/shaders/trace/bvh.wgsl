// Finds the volumes that a ray may hit where a scene has many. The list is ordered so that volumes close in
// space are close in the list, so the bounding boxes of runs of 4, 16, 64… volumes form an implicit BVH.
// Traversal goes through the list from left to right and skips whole runs whose box the ray misses. The
// boxes are written by `src/render/view/bvh.rs`.
#define_import_path bevy_vdb::trace::bvh

#import bevy_vdb::view::scene::{scene_end, view, volumes}
#import bevy_vdb::trace::segment::{Segment, position_from_eye}

// Nodes contain at most 4^10 volumes.
const MAX_LEVEL: u32 = 10u;

// The level of the largest node that begins at `k`.
fn level_at(k: u32) -> u32 {
    return firstTrailingBit(k | (1u << (2u * MAX_LEVEL))) / 2u;
}

// Whether a ray hits a box before `t_max`. The origin and the box are relative to the view's eye.
fn meets_box(origin: vec3<f32>, dir: vec3<f32>, low: vec3<f32>, high: vec3<f32>, t_max: f32) -> bool {
    let safe_dir = select(dir, select(vec3(-1e-30), vec3(1e-30), dir >= vec3(0.0)), abs(dir) < vec3(1e-30));
    let a = (low - origin) / safe_dir;
    let b = (high - origin) / safe_dir;
    let near = min(a, b);
    let far = max(a, b);
    let t_in = max(max(near.x, near.y), near.z);
    let t_out = min(min(far.x, far.y), far.z);
    return t_in <= t_out && t_out >= 0.0 && t_in <= t_max;
}

// Index of the box of the node with 4^level volumes that begins at `k`. No two nodes share an index.
fn node_slot(k: u32, level: u32) -> u32 {
    return k + select(level, 4u * (level - 3u), level > 3u);
}

// The first volume, from index `first`, whose box a secondary ray hits; past the last index if there is
// none. Every iteration moves forward in the list or down one level.
fn next_intersected(segment: Segment, first: u32, t_max: f32) -> u32 {
    let count = scene_end() - view.volume_first;
    let origin = position_from_eye(segment.start);
    var k = first - view.volume_first;
    var level = level_at(k);
    while k < count {
        if level == 0u {
            let i = view.volume_first + k;
            if meets_box(origin, segment.dir, volumes[i].box_min, volumes[i].box_max, t_max) {
                return i;
            }
            k += 1u;
            level = level_at(k);
            continue;
        }
        let slot = node_slot(k, level);
        // A short node at the end of the list may have no slot for its box.
        if slot < count {
            let at = view.volume_first + slot;
            if !meets_box(origin, segment.dir, volumes[at].node_min, volumes[at].node_max, t_max) {
                k += 1u << (2u * level);
                level = level_at(k);
                continue;
            }
        }
        level -= 1u;
    }
    return scene_end();
}
