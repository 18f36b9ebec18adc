// The mean of the frames of a picture, while nothing changes in it: what a ray has seen goes into the pixel
// that it went through. One thread a pixel.

#import bevy_vdb::gpu::types::View
#import bevy_vdb::view::picture::{depth_of_meshes, pixel_of}

@group(0) @binding(0) var<uniform> view: View;
#ifdef MULTISAMPLED
@group(0) @binding(1) var scene_depth: texture_depth_multisampled_2d;
#else
@group(0) @binding(1) var scene_depth: texture_depth_2d;
#endif
// What the trace has written; `trace.wgsl` says how.
@group(0) @binding(2) var traced_color: texture_2d<f32>;
@group(0) @binding(3) var traced_depth: texture_2d<f32>;
@group(0) @binding(4) var<storage, read_write> means: array<Mean>;
// What is shown.
@group(0) @binding(5) var out_color: texture_storage_2d<rgba16float, write>;
@group(0) @binding(6) var out_depth: texture_storage_2d<r32float, write>;
#ifdef VDB_SCALED
// The same of all pixels, by rays nearby.
@group(0) @binding(7) var upscaled_color: texture_2d<f32>;
@group(0) @binding(8) var upscaled_depth: texture_2d<f32>;
#endif

// What rays have seen in a pixel.
struct Mean {
    color: vec4<f32>,
    depth: f32,         // as the trace has it: of the first surface; without any, where fog is nearest
    surface_fraction: f32,      // the part of the rays that have met one
    sample_count: u32,       // rays, up to `View::max_frames`
    mesh_depth: f32,    // of the opaque meshes before which that is
}

const NO_DEPTH: f32 = -3.0;

// The ray that goes through a pixel, if one does.
struct PixelRay {
    ray: vec2<u32>,
    exists: bool,
}

fn ray_through_pixel(pixel: vec2<u32>) -> PixelRay {
#ifdef VDB_SCALED
    let low = vec2<u32>(vec2<f32>(pixel) * vec2<f32>(view.size) / vec2<f32>(view.picture));
    let is_low = pixel_of(low, view.size, view.picture, view.jitter) == pixel;
    let ray = select(low + 1u, low, is_low);
    let is_own = all(pixel_of(ray, view.size, view.picture, view.jitter) == pixel);
    return PixelRay(ray, is_own && all(ray < view.size));
#else
    return PixelRay(pixel, true);
#endif
}

// A depth of the same pixel as two rays tell it.
fn merged_depth(before: f32, latest: f32) -> f32 {
    if before >= 0.0 {
        return before;
    }
    if latest >= 0.0 || before < -2.5 {
        return latest;
    }
    // The nearer fog begins, the less this is.
    return select(min(before, latest), before, latest < -2.5);
}

fn with_sample(before: Mean, color: vec4<f32>, depth: f32) -> Mean {
    var mean = before;
    mean.sample_count = min(before.sample_count + 1u, max(view.max_frames, 1u));
    let weight = 1.0 / f32(mean.sample_count);
    mean.color = mix(before.color, color, weight);
    mean.surface_fraction = mix(before.surface_fraction, select(0.0, 1.0, depth >= 0.0), weight);
    mean.depth = merged_depth(before.depth, depth);
    return mean;
}

@compute @workgroup_size(8, 8, 1)
fn accumulate(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.picture) {
        return;
    }
    let i = pixel.y * view.picture.x + pixel.x;
    let mesh_depth = depth_of_meshes(scene_depth, pixel + view.origin);
    var mean = means[i];
    if view.frame <= 1u || mean.sample_count == 0u || mean.mesh_depth != mesh_depth {
        mean = Mean(vec4(0.0), NO_DEPTH, 0.0, 0u, mesh_depth);
    }
    let pixel_ray = ray_through_pixel(pixel);
    if pixel_ray.exists {
        let color = textureLoad(traced_color, pixel_ray.ray, 0);
        mean = with_sample(mean, color, textureLoad(traced_depth, pixel_ray.ray, 0).x);
    }
    means[i] = mean;
    // A surface that covers less than half of a pixel is shown, but hides nothing that comes later.
    let is_opaque = mean.surface_fraction >= 0.5;
    var color = mean.color;
    var depth = select(mean.depth, -1.0 - mean.depth, mean.depth >= 0.0 && !is_opaque);
#ifdef VDB_SCALED
    if mean.sample_count == 0u {
        color = textureLoad(upscaled_color, pixel, 0);
        depth = textureLoad(upscaled_depth, pixel, 0).x;
    }
#endif
    textureStore(out_color, pixel, color);
    textureStore(out_depth, pixel, vec4(depth, 0.0, 0.0, 0.0));
}
