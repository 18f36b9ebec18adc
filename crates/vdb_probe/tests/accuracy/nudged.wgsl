// The traversal of the thesis, for comparison, from its description: an f32 position in the space of the
// grid; at each step the size of the empty node at that position, the nearest of its planes ahead,
// and the position moved there and a little further, so that it lies in the next node. A thousand
// steps at most.
//
// In its favour: a ray from outside begins where it enters the grid's box, however far away its eye
// is, and the look-ups are this project's.

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::tree::{locate, new_accessor, span_occupied}
#import vdb_probe::single_rays::{ProbeHit, ProbeRay}

@group(2) @binding(4) var<storage, read> given: array<ProbeRay>;
@group(2) @binding(5) var<storage, read_write> hits: array<ProbeHit>;
// Index space → the cells that the look-ups count in.
@group(2) @binding(6) var<uniform> base: vec4<i32>;

const NUDGE: f32 = 4e-4;
const MAX_STEPS: u32 = 1000u;
const FAR: f32 = 1e30;

// The distance along the ray to a plane on each axis; far away where the ray does not move.
fn distances(at: vec3<f32>, dir: vec3<f32>, plane: vec3<f32>) -> vec3<f32> {
    let still = dir == vec3(0.0);
    return select((plane - at) / select(dir, vec3(1.0), still), vec3(FAR), still);
}

fn axis_of(x: vec3<f32>, value: f32) -> u32 {
    return select(select(2u, 1u, x.y == value), 0u, x.x == value);
}

@compute @workgroup_size(64)
fn nudged(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.y * 2097152u + id.x;
    if i >= arrayLength(&given) {
        return;
    }
    let grid = grids[0];
    let low = vec3<f32>(grid.occupied_min + base.xyz);
    let high = vec3<f32>(grid.occupied_max + base.xyz + 1);
    let dir = normalize(given[i].dir);
    var at = vec3<f32>(given[i].cell + base.xyz) + given[i].frac;
    var axis = 3u;
    var hit = 0u;
    var steps = 0u;
    // To the box, as any engine does it.
    let near = distances(at, dir, select(high, low, dir > vec3(0.0)));
    let far = distances(at, dir, select(low, high, dir > vec3(0.0)));
    let outside = (at < low) | (at >= high);
    let entries = select(vec3(-FAR), near, outside);
    let entry = max(max(entries.x, entries.y), entries.z);
    let exits = select(far, vec3(FAR), dir == vec3(0.0));
    let exit = min(min(exits.x, exits.y), exits.z);
    let is_missed = entry >= FAR || entry > exit || any(outside & (near < vec3(0.0)));
    if entry > 0.0 {
        axis = axis_of(entries, entry);
        at += dir * (entry + NUDGE);
    }
    var stuck = 0u;
    var place = new_accessor(vec3(0));
    if !is_missed {
        stuck = 1u;
        place = new_accessor(vec3<i32>(floor(at)) - base.xyz);
        for (; steps < MAX_STEPS; steps++) {
            let cell = vec3<i32>(floor(at)) - base.xyz;
            if any(cell < grid.occupied_min) || any(cell > grid.occupied_max) {
                stuck = 0u;
                break;
            }
            let span = locate(grid, cell, 0u, &place);
            if span_occupied(span) {
                hit = 1u;
                stuck = 0u;
                break;
            }
            let size = 1i << span.log_dim;
            let corner = vec3<f32>((cell & vec3(-size)) + base.xyz);
            let planes = select(corner, corner + f32(size), dir > vec3(0.0));
            let ahead = distances(at, dir, planes);
            let step = min(min(ahead.x, ahead.y), ahead.z);
            axis = axis_of(ahead, step);
            at += dir * (step + NUDGE);
        }
    }
    let t = select(0.0, -1.0, stuck == 1u);
    hits[i] = ProbeHit(vec3<i32>(floor(at)) - base.xyz, axis, vec3(0.0), hit, t, 0.0, steps);
}
