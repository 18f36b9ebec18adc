// Upscales the traced image to full resolution. One thread per pixel: blends those of the four nearest rays
// that hit the surface the pixel shows.

#import bevy_vdb::gpu::types::View
#import bevy_vdb::view::depths::{NO_DEPTH, decoded_fog_depth, encoded_fog_depth, is_fog_depth}
#import bevy_vdb::view::depths::is_surface_depth
#import bevy_vdb::view::picture::{depth_of_meshes, pixel_of, t_of_depth}

@group(0) @binding(0) var<uniform> view: View;
#ifdef MULTISAMPLED
@group(0) @binding(1) var scene_depth: texture_depth_multisampled_2d;
#else
@group(0) @binding(1) var scene_depth: texture_depth_2d;
#endif
// Output of the trace; see `trace.wgsl`.
@group(0) @binding(2) var traced_color: texture_2d<f32>;
@group(0) @binding(3) var traced_depth: texture_2d<f32>;
// The same at full resolution.
@group(0) @binding(4) var out_color: texture_storage_2d<rgba16float, write>;
@group(0) @binding(5) var out_depth: texture_storage_2d<r32float, write>;
#ifdef VDB_MOTION_VECTORS
@group(0) @binding(6) var traced_moving: texture_2d<u32>;
@group(0) @binding(7) var out_moving: texture_storage_2d<rg32uint, write>;
#endif

// Largest relative difference in depth between neighbouring rays on one surface.
const SAME_SURFACE: f32 = 0.05;

// The result of one ray.
struct Sample {
    ray: vec2<u32>,
    color: vec4<f32>,
    depth: f32,
    t: f32,     // of a surface
    weight: f32,
}

// The t of the opaque meshes at a pixel of the viewport.
fn mesh_t(pixel: vec2<u32>) -> f32 {
    return t_of_depth(view.t_from_depth, depth_of_meshes(scene_depth, pixel + view.origin));
}

// From 0 to 1.
fn similarity(a: f32, b: f32) -> f32 {
    return saturate(1.0 - abs(a - b) / max(max(abs(a), abs(b)), 1e-30));
}

// `bilinear_weight` is from 0 to 1.
fn load_sample(ray: vec2<u32>, bilinear_weight: f32, own_t: f32) -> Sample {
    let depth = textureLoad(traced_depth, ray, 0).x;
    let color = textureLoad(traced_color, ray, 0);
    let t = t_of_depth(view.t_from_depth, depth);
    var weight = bilinear_weight + 1e-3;
    // A ray ended by a different mesh only knows what is in front of that mesh.
    if !is_surface_depth(depth) || t > own_t {
        let mesh_similarity = similarity(mesh_t(pixel_of(ray, view.size, view.picture, view.jitter)), own_t);
        weight *= max(mesh_similarity * mesh_similarity * mesh_similarity, 1e-4);
    }
    return Sample(ray, color, depth, t, weight);
}

@compute @workgroup_size(8, 8, 1)
fn upscale(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.picture) {
        return;
    }
    let own_t = mesh_t(pixel);
    let scale = vec2<f32>(view.size) / vec2<f32>(view.picture);
    let position = (vec2<f32>(pixel) + 0.5) * scale - 0.5 - view.jitter;
    let low = floor(position);
    let fraction = position - low;
    var samples: array<Sample, 4>;
    var best = 0u;
    for (var i = 0u; i < 4u; i++) {
        let corner = vec2(i & 1u, i >> 1u);
        let ray = clamp(vec2<i32>(low) + vec2<i32>(corner), vec2(0), vec2<i32>(view.size) - 1);
        let weights = select(1.0 - fraction, fraction, corner == vec2(1u));
        samples[i] = load_sample(vec2<u32>(ray), weights.x * weights.y, own_t);
        if samples[i].weight > samples[best].weight {
            best = i;
        }
    }
    // Blend only what matches the best sample, to preserve edges.
    let best_sample = samples[best];
    let is_surface = is_surface_depth(best_sample.depth);
    var color = vec4(0.0);
    var depth = 0.0;
    var weight = 0.0;
    var fog_depth = -1.0;
    for (var i = 0u; i < 4u; i++) {
        let other = samples[i];
        if is_surface_depth(other.depth) != is_surface {
            continue;
        }
        if is_surface && similarity(other.t, best_sample.t) < 1.0 - SAME_SURFACE {
            continue;
        }
        color += other.weight * other.color;
        depth += other.weight * other.depth;
        weight += other.weight;
        if is_fog_depth(other.depth) {
            fog_depth = max(fog_depth, decoded_fog_depth(other.depth));
        }
    }
    let encoded = select(NO_DEPTH, encoded_fog_depth(fog_depth), fog_depth >= 0.0);
    depth = select(encoded, depth / weight, is_surface);
    textureStore(out_color, pixel, color / weight);
    textureStore(out_depth, pixel, vec4(depth, 0.0, 0.0, 0.0));
#ifdef VDB_MOTION_VECTORS
    textureStore(out_moving, pixel, textureLoad(traced_moving, best_sample.ray, 0));
#endif
}
