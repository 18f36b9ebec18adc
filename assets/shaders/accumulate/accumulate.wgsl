// Averages the frames of a view while nothing in it changes. One thread per pixel: adds the result of the
// ray that passes through the pixel.

#import bevy_vdb::gpu::types::View
#import bevy_vdb::view::depths::{NO_DEPTH, encoded_fog_depth, is_fog_depth, is_surface_depth}
#import bevy_vdb::view::picture::{depth_of_meshes, pixel_of}

@group(0) @binding(0) var<uniform> view: View;
#ifdef MULTISAMPLED
@group(0) @binding(1) var scene_depth: texture_depth_multisampled_2d;
#else
@group(0) @binding(1) var scene_depth: texture_depth_2d;
#endif
// Output of the trace; see `trace.wgsl`.
@group(0) @binding(2) var traced_color: texture_2d<f32>;
@group(0) @binding(3) var traced_depth: texture_2d<f32>;
@group(0) @binding(4) var<storage, read_write> means: array<Mean>;
// The accumulated image.
@group(0) @binding(5) var out_color: texture_storage_2d<rgba16float, write>;
@group(0) @binding(6) var out_depth: texture_storage_2d<r32float, write>;
#ifdef VDB_SCALED
// The upscaled image, for pixels without a ray so far.
@group(0) @binding(7) var upscaled_color: texture_2d<f32>;
@group(0) @binding(8) var upscaled_depth: texture_2d<f32>;
#endif

// Mean of the rays through a pixel.
struct Mean {
    color: vec4<f32>,
    depth: f32,             // of the first surface, else of the nearest fog; encoded
    surface_fraction: f32,  // fraction of the rays that hit a surface
    sample_count: u32,      // number of rays, up to `View::max_frames`
    mesh_depth: f32,        // depth of the opaque meshes that the mean is valid for
}

// The ray that passes through a pixel, if there is one.
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

// Combines the depths that two rays found for the same pixel.
fn merged_depth(before: f32, latest: f32) -> f32 {
    if is_surface_depth(before) {
        return before;
    }
    if is_surface_depth(latest) || !is_fog_depth(before) {
        return latest;
    }
    // Encoded depths of fog: the smaller one is nearer.
    return select(before, min(before, latest), is_fog_depth(latest));
}

fn with_sample(before: Mean, color: vec4<f32>, depth: f32) -> Mean {
    var mean = before;
    mean.sample_count = min(before.sample_count + 1u, max(view.max_frames, 1u));
    let weight = 1.0 / f32(mean.sample_count);
    mean.color = mix(before.color, color, weight);
    mean.surface_fraction = mix(before.surface_fraction, select(0.0, 1.0, is_surface_depth(depth)), weight);
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
    // A surface that covers less than half of a pixel is visible, but does not write depth.
    let is_opaque = mean.surface_fraction >= 0.5;
    var color = mean.color;
    var depth = select(mean.depth, encoded_fog_depth(mean.depth), is_surface_depth(mean.depth) && !is_opaque);
#ifdef VDB_SCALED
    if mean.sample_count == 0u {
        color = textureLoad(upscaled_color, pixel, 0);
        depth = textureLoad(upscaled_depth, pixel, 0).x;
    }
#endif
    textureStore(out_color, pixel, color);
    textureStore(out_depth, pixel, vec4(depth, 0.0, 0.0, 0.0));
}
