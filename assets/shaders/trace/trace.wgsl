// One thread per pixel. Writes radiance times exposure, premultiplied by coverage, and a depth for the composite.

#import bevy_vdb::trace::path::{mesh_t, trace_path}
#import bevy_vdb::trace::seen::{PathResult, finite, nothing_met}
#import bevy_vdb::trace::segment::{NONE, Segment, view_segment}
#import bevy_vdb::traversal::rays::ndc_of
#import bevy_vdb::view::scene::view
#ifdef VDB_EDGES
#import bevy_vdb::trace::edge_list::{EDGE_COUNT, EDGE_WORDS, FIRST_EDGE, MAX_GROUPS, REFINEMENT_LAYERS}
#import bevy_vdb::view::depths::{NO_DEPTH, decoded_fog_depth, encoded_fog_depth, is_fog_depth, is_surface_depth}
#endif
#ifdef VDB_DENOISE
#import bevy_vdb::view::reflection::encoded_reflection
#endif
#ifdef VDB_REFLECTION_HISTORY
#import bevy_vdb::view::reflection::encoded_first
#endif

@group(2) @binding(7) var out_color: texture_storage_2d<rgba16float, write>;
@group(2) @binding(8) var out_depth: texture_storage_2d<r32float, write>;

#ifdef VDB_MOTION_VECTORS
// The volume that a pixel moves with, as an index into the view's list, or NONE; and the bits of the depth
// of the point that moves.
@group(2) @binding(10) var out_moving: texture_storage_2d<rg32uint, write>;
#endif

#ifdef VDB_DENOISE
@group(2) @binding(19) var out_reflection: texture_storage_2d<rgba32uint, write>;
#endif
#ifdef VDB_REFLECTION_HISTORY
@group(2) @binding(24) var out_first: texture_storage_2d<rg32uint, write>;
#endif

// The ray through a point of the picture: through the middle of a pixel, plus an offset in pixels.
fn view_ray(pixel: vec2<u32>, offset: vec2<f32>) -> Segment {
    return view_segment(ndc_of(pixel, view.size) + offset * vec2(2.0, -2.0) / vec2<f32>(view.size));
}

fn store(pixel: vec2<u32>, result: PathResult) {
    textureStore(out_color, pixel, vec4(finite(result.color), result.coverage));
    textureStore(out_depth, pixel, vec4(result.depth, 0.0, 0.0, 0.0));
#ifdef VDB_DENOISE
    textureStore(out_reflection, pixel, encoded_reflection(result.reflection));
#endif
#ifdef VDB_REFLECTION_HISTORY
    textureStore(out_first, pixel, vec4(encoded_first(result.first), 0u, 0u));
#endif
#ifdef VDB_MOTION_VECTORS
    let motion_volume = select(result.motion_volume - view.volume_first, NONE, result.motion_volume == NONE);
    textureStore(out_moving, pixel, vec4(motion_volume, bitcast<u32>(result.motion_depth), 0u, 0u));
#endif
}

// In both entry points, two tiles per workgroup, which halves the number of workgroups to launch.

#ifndef VDB_EDGES
@compute @workgroup_size(8, 16, 1)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if all(pixel < view.size) {
#ifdef VDB_ACCUMULATED
        let ray = view_ray(pixel, view.jitter);
#else
        let ray = view_ray(pixel, vec2(0.0));
#endif
        store(pixel, trace_path(ray, pixel, 0u, min(mesh_t(pixel), view.t_far)));
    }
}
#else
@group(2) @binding(17) var<storage, read> edges: array<u32>;

const GROUP_THREADS: u32 = 128u;

var<workgroup> traced: array<vec4<f32>, GROUP_THREADS>;
var<workgroup> traced_depths: array<f32, GROUP_THREADS>;

// The position of a sample in its pixel, 0 to 1: each of `count` columns and rows, which are powers of two, has
// one. For four samples, a rotated grid.
fn sample_position(i: u32, count: u32) -> vec2<f32> {
    let row = (reverseBits(i) >> (32u - firstTrailingBit(count))) ^ 1u;
    return (vec2(f32(i), f32(row)) + 0.5) / f32(count);
}

// The mean of the additional rays through a pixel and of the ray through its middle replaces the colour of the
// latter. `entry` is the pixel's place in the list, or 0 if this thread repeats another pixel.
fn store_mean(pixel: vec2<u32>, result: PathResult, entry: u32, thread: u32) {
    let samples = view.edge_samples;
    traced[thread] = vec4(finite(result.color), result.coverage);
    traced_depths[thread] = result.depth;
    workgroupBarrier();
    if entry > 0u && thread % samples == 0u {
        var sum = vec4(unpack2x16float(edges[entry + 1u]), unpack2x16float(edges[entry + 2u]));
        var nearest = -1.0;
        for (var i = thread; i < thread + samples; i++) {
            sum += traced[i];
            let depth = traced_depths[i];
            if is_surface_depth(depth) {
                nearest = max(nearest, depth);
            } else if is_fog_depth(depth) {
                nearest = max(nearest, decoded_fog_depth(depth));
            }
        }
        textureStore(out_color, pixel, sum / f32(samples + 1u));
        // Where the middle shows no surface, the pixel is composited as fog is, without its depth.
        if (edges[entry] >> 31u) == 0u {
            let depth = select(NO_DEPTH, encoded_fog_depth(nearest), nearest >= 0.0);
            textureStore(out_depth, pixel, vec4(depth, 0.0, 0.0, 0.0));
        }
    }
}

// One thread per pixel or, in a dispatch of several layers, per additional ray through a pixel on an edge. One
// entry point serves both, because drivers take long to compile the code that traces a path.
@compute @workgroup_size(8, 16, 1)
fn trace(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let refines = groups.z == REFINEMENT_LAYERS;
    var pixel = id.xy;
    var offset = vec2(0.0);
    var entry = 0u;
    var ray = 0u;
    if refines {
        let samples = view.edge_samples;
        let row = group.y * MAX_GROUPS + group.x;
        let place = (REFINEMENT_LAYERS * row + group.z) * (GROUP_THREADS / samples) + thread / samples;
        let count = min(edges[EDGE_COUNT], (arrayLength(&edges) - FIRST_EDGE) / EDGE_WORDS);
        // The last groups may have threads to spare: they repeat the last pixel, and store nothing.
        let listed = FIRST_EDGE + EDGE_WORDS * min(place, max(count, 1u) - 1u);
        let word = edges[listed];
        pixel = vec2(word & 0x7fffu, (word >> 15u) & 0xffffu);
        ray = 1u + thread % samples;
        offset = sample_position(thread % samples, samples) - 0.5;
        entry = select(0u, listed, place < count);
    }
    let is_inside = all(pixel < view.size);
    var result = nothing_met();
    if is_inside {
        result = trace_path(view_ray(pixel, offset), pixel, ray, min(mesh_t(pixel), view.t_far));
    }
    if refines {
        store_mean(pixel, result, entry, thread);
    } else if is_inside {
        store(pixel, result);
    }
}
#endif
