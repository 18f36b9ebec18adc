// Denoises reflections in rough surfaces. One thread per ray: an edge-avoiding à-trous wavelet filter (Dammertz et
// al. 2010, "Edge-avoiding à-trous wavelet transform for fast global illumination filtering") over a few
// dispatches, whose taps move apart.
//
// Each pixel has followed one of the directions in which its surface reflects light, so the mean over neighbours
// with nearly the same directions and nearly the same hits is what the pixel itself should show. The weights of
// neighbours therefore fall with the blur of the surface itself: over the screen, as the reflected image is blurred,
// and over directions. A mirror, or a reflected point close to the surface, is hardly blurred, and keeps its detail.

#import bevy_vdb::gpu::types::View
#import bevy_vdb::view::reflection::{Reflection, decoded_reflection}

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

@compute @workgroup_size(8, 8, 1)
fn denoise(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.size) {
        return;
    }
    let own = decoded_reflection(textureLoad(reflections, pixel, 0));
    var mean = radiance_at(pixel, own);
    var scale = 1.0;
#ifdef VDB_ACCUMULATED
    // The mean of many frames needs less smoothing.
    scale = sqrt(1.0 + f32(min(view.frame, view.max_frames)));
#endif
    if any(own.reflectance > vec3(0.0)) && scale * mean.w < MAX_SHARPNESS {
        mean = filtered(pixel, own, mean, scale);
    }
    if iteration.is_last != 0u {
        let color = textureLoad(traced_color, pixel, 0);
        // The rest of the colour stays as it is.
        let changed = color.rgb + own.reflectance * (mean.rgb - own.radiance);
        mean = vec4(max(changed, vec3(0.0)), color.a);
    }
    textureStore(out, pixel, mean);
}
