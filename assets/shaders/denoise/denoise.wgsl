// Denoises reflections in rough surfaces. One thread per ray: an edge-avoiding à-trous wavelet filter (Dammertz et
// al. 2010, "Edge-avoiding à-trous wavelet transform for fast global illumination filtering") over a few
// dispatches, whose taps move apart.
//
// Each pixel has followed one of the directions in which its surface reflects light, so the mean over neighbours
// with nearly the same directions and nearly the same hits is what the pixel itself should show. The weights of
// neighbours therefore fall with the blur of the surface itself: over the screen, as the reflected image is blurred,
// and over directions. A mirror, or a reflected point close to the surface, is hardly blurred, and keeps its detail.
//
// With `VDB_REFLECTION_HISTORY`, the last dispatch then averages what the first rough surface along each ray reflects
// over frames.

#import bevy_vdb::gpu::types::View
#import bevy_vdb::view::picture::{MAX_COLOR, t_of_depth}
#import bevy_vdb::view::reflection::{Reflection, decoded_reflection}
#ifdef VDB_REFLECTION_HISTORY
#import bevy_vdb::traversal::rays::ndc_of
#import bevy_vdb::view::depths::is_surface_depth
#import bevy_vdb::view::reflection::{FirstReflection, ReflectionMean, decoded_first, decoded_mean, encoded_mean, likeness}
#endif

// The dispatch: neighbours are `spacing` pixels apart.
struct Iteration {
    spacing: u32,
    is_first: u32,
    is_last: u32,
    dispatches: f32, // the number of all iterations
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> iteration: Iteration;
// Output of the trace; see `trace.wgsl`.
@group(0) @binding(2) var traced_color: texture_2d<f32>;
@group(0) @binding(3) var reflections: texture_2d<u32>;
// Reflected radiance and its sharpness (see `Reflection`), as the previous dispatch left them. Not read by the
// first.
@group(0) @binding(4) var before: texture_2d<f32>;
// The same after this one or, in the last, colours.
@group(0) @binding(5) var out: texture_storage_2d<rgba16float, write>;
#ifdef VDB_REFLECTION_HISTORY
// Output of the trace; see `trace.wgsl`.
@group(0) @binding(6) var traced_depth: texture_2d<f32>;
@group(0) @binding(7) var first_reflections: texture_2d<u32>;
// The means up to the previous frame, and up to this one, which the last dispatch writes.
@group(0) @binding(8) var means_before: texture_2d<u32>;
@group(0) @binding(9) var out_means: texture_storage_2d<rgba32uint, write>;
#endif

// B3 splines, 0 to 2 taps from the middle.
const KERNEL: vec3<f32> = vec3(0.375, 0.25, 0.0625);

// From this sharpness on, the mean over neighbours would be the pixel itself.
const MAX_SHARPNESS: f32 = 2.5;

// Reflected radiance at a pixel, and its sharpness.
fn radiance_at(pixel: vec2<u32>, own: Reflection) -> vec4<f32> {
    if iteration.is_first != 0u {
        return vec4(own.radiance, own.sharpness);
    }
    return textureLoad(before, pixel, 0);
}

// The weighted mean of a pixel and its neighbours.
fn filtered(pixel: vec2<u32>, own: Reflection, middle: vec4<f32>, scale: f32) -> vec4<f32> {
    var kernel = KERNEL;
    // Variances of consecutive filters add up, so each takes its share. Over the screen each filter is as wide as
    // their sum should be: there, noise that is left shows more than the additional blur.
    let over_directions = -0.5 * iteration.dispatches / max(own.alpha * own.alpha, 1e-6);
    var sum = kernel[0] * kernel[0] * middle;
    var weights = kernel[0] * kernel[0];
    for (var y = -2; y <= 2; y++) {
        for (var x = -2; x <= 2; x++) {
            let offset = vec2(x, y) * i32(iteration.spacing);
            let at = vec2<i32>(pixel) + offset;
            if (x == 0 && y == 0) || any(at < vec2(0)) || any(at >= vec2<i32>(view.size)) {
                continue;
            }
            let neighbour = vec2<u32>(at);
            let other = decoded_reflection(textureLoad(reflections, neighbour, 0));
            if all(other.reflectance == vec3(0.0)) {
                continue;
            }
            let turned = other.direction - own.direction;
            let value = radiance_at(neighbour, other);
            // A path that misses what its neighbours meet must not spread it farther than they do.
            let sharpness = scale * max(middle.w, value.w);
            let over_screen = -0.5 * sharpness * sharpness;
            let exponent = over_screen * f32(dot(offset, offset)) + over_directions * dot(turned, turned);
            let weight = kernel[abs(x)] * kernel[abs(y)] * exp(exponent);
            sum += weight * value;
            weights += weight;
        }
    }
    return sum / weights;
}

#ifdef VDB_REFLECTION_HISTORY
// Two points in nearby pixels pass for one surface if their distances differ by at most this factor.
const MAX_DISTANCE_RATIO: f32 = 1.1;

// The mean over earlier frames of what a pixel reflects, where the point on its surface was in the previous frame. The
// number of frames falls with the differences in direction, so a mean is forgotten as the camera moves, sooner on
// smoother surfaces.
fn mean_before(pixel: vec2<u32>, first: FirstReflection, depth: f32) -> ReflectionMean {
    var mean = ReflectionMean();
    let then = view.then_from_now * vec4(ndc_of(pixel, view.size), depth, 1.0);
    if view.max_history_frames <= 1u || first.alpha == 0.0 || !is_surface_depth(depth) || then.w <= 0.0 {
        return mean;
    }
    let ndc = clamp(then.xyz / then.w, vec3(-2.0), vec3(2.0));
    let place = (0.5 + vec2(0.5, -0.5) * ndc.xy) * vec2<f32>(view.size) - 0.5;
    let corner = floor(place);
    let share = place - corner;
    let t = t_of_depth(view.t_from_depth, ndc.z);
    var weights = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let offset = vec2(i & 1u, i >> 1u);
        let at = vec2<i32>(corner) + vec2<i32>(offset);
        let is_inside = all(at >= vec2(0)) && all(at < vec2<i32>(view.size));
        let other = decoded_mean(textureLoad(means_before, clamp(at, vec2(0), vec2<i32>(view.size) - 1), 0));
        let t_other = t_of_depth(view.t_from_depth, other.depth);
        let is_same = max(t, t_other) <= MAX_DISTANCE_RATIO * min(t, t_other);
        let bilinear = mix(1.0 - share, share, vec2<f32>(offset));
        let weight = bilinear.x * bilinear.y * likeness(first.direction, other.direction, first.alpha);
        if is_inside && other.frames > 0.0 && is_same && weight > 0.0 {
            mean.reflected += weight * other.reflected;
            mean.direction += weight * other.direction;
            mean.frames += weight * other.frames;
            weights += weight;
        }
    }
    mean.reflected /= max(weights, 1e-30);
    mean.direction /= max(weights, 1e-30);
    mean.frames = min(mean.frames, f32(view.max_history_frames - 1u));
    return mean;
}

// The mean with this frame's reflection. `color` is the denoised colour of the pixel.
fn with_frame(old: ReflectionMean, first: FirstReflection, depth: f32, color: vec3<f32>) -> ReflectionMean {
    if first.alpha == 0.0 || !is_surface_depth(depth) {
        return ReflectionMean();
    }
    let share = old.frames / (old.frames + 1.0);
    let reflected = mix(color - first.direct, old.reflected, share);
    let direction = normalize(mix(first.direction, old.direction, share));
    return ReflectionMean(reflected, old.frames + 1.0, direction, depth);
}
#endif

@compute @workgroup_size(8, 8, 1)
fn denoise(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.size) {
        return;
    }
    let own = decoded_reflection(textureLoad(reflections, pixel, 0));
    var mean = radiance_at(pixel, own);
    // Makes the filter narrower: the mean of many frames needs less smoothing.
    var scale = 1.0;
#ifdef VDB_ACCUMULATED
    scale = sqrt(1.0 + f32(min(view.frame, view.max_frames)));
#endif
#ifdef VDB_REFLECTION_HISTORY
    let first = decoded_first(textureLoad(first_reflections, pixel, 0).xy);
    let depth = textureLoad(traced_depth, pixel, 0).x;
    var old = ReflectionMean();
    if iteration.is_last != 0u || any(own.reflectance > vec3(0.0)) {
        old = mean_before(pixel, first, depth);
    }
    scale = sqrt(1.0 + old.frames);
#endif
    if any(own.reflectance > vec3(0.0)) && scale * mean.w < MAX_SHARPNESS {
        mean = filtered(pixel, own, mean, scale);
    }
    if iteration.is_last != 0u {
        let color = textureLoad(traced_color, pixel, 0);
        // The rest of the colour stays as it is.
        let changed = color.rgb + own.reflectance * (mean.rgb - own.radiance);
        mean = vec4(clamp(changed, vec3(0.0), vec3(MAX_COLOR)), color.a);
#ifdef VDB_REFLECTION_HISTORY
        let reflected = with_frame(old, first, depth, mean.rgb);
        textureStore(out_means, pixel, encoded_mean(reflected));
        if reflected.frames > 1.0 {
            mean = vec4(clamp(first.direct + reflected.reflected, vec3(0.0), vec3(MAX_COLOR)), color.a);
        }
#endif
    }
    textureStore(out, pixel, mean);
}
