// Removes the grain of fog's shadows from the picture of the meshes. One thread per pixel.
//
// The light of a pixel is that of its shadowed lights, times what they contribute, plus the rest. What they
// contribute is not known, but near the pixel it hardly changes, while the grain does: so it is the covariance of
// colour and grain, over that of light and grain (the estimator of instrumental variables; the grain is the
// instrument, since nothing else in a picture follows it, once its own trend across the window is subtracted, which
// shading has, too). Where a material ignores shadows, it is 0.

#import bevy_vdb::fog_shadows::grain::{Grain, NO_GRAIN, decoded_grain}
#import bevy_vdb::gpu::types::{MAX_HALF, Placement}

// What `find.wgsl` has found.
@group(0) @binding(0) var found: texture_2d<u32>;
// The camera's target, with opaque meshes.
@group(0) @binding(1) var picture: texture_2d<f32>;
@group(0) @binding(2) var<uniform> placement: Placement;
@group(0) @binding(3) var smoothed: texture_storage_2d<rgba16float, write>;

// Pixels from the middle of the window to its border.
const RADIUS: i32 = 3;

// How many times as bright as the pixel itself a neighbour counts at most: highlights do not follow the grain, and
// a single one would outweigh the rest of a window.
const MOST_CONTRAST: f32 = 4.0;

// The least fraction of light, and the least variance of grain, from which anything is concluded.
const LEAST_LIGHT: f32 = 0.02;
const LEAST_VARIANCE: f32 = 4e-6;

// The largest difference between the distances of a pixel and a neighbour on the same mesh: several times that
// which the pixel has to the next one, and at least a fraction of the distance.
fn depth_tolerance(pixel: vec2<i32>, distance: f32) -> f32 {
    var steps = vec2(0.0);
    for (var axis = 0; axis < 2; axis++) {
        let along = select(vec2(0, 1), vec2(1, 0), axis == 0);
        var least = 1e30;
        for (var side = -1; side <= 1; side += 2) {
            let at = pixel + side * along;
            if all(at >= vec2(0)) && all(at < vec2<i32>(placement.size)) {
                let other = textureLoad(found, at, 0).xy;
                let step = abs(decoded_grain(other).distance - distance);
                least = select(least, min(least, step), any(other != NO_GRAIN));
            }
        }
        steps[axis] = select(0.0, least, least < 1e30);
    }
    return 1.5 * f32(RADIUS) * (steps.x + steps.y) + 0.002 * distance;
}

// What is known of a neighbour in the window; its distance is 0 if it is not in it.
fn neighbour(pixel: vec2<i32>, offset: vec2<i32>, own: Grain, tolerance: f32) -> Grain {
    let at = pixel + offset;
    if any(at < vec2(0)) || any(at >= vec2<i32>(placement.size)) {
        return Grain(0.0, 0.0, 0.0);
    }
    let encoded = textureLoad(found, at, 0).xy;
    let other = decoded_grain(encoded);
    if all(encoded == NO_GRAIN) || abs(other.distance - own.distance) > tolerance {
        return Grain(0.0, 0.0, 0.0);
    }
    return other;
}

// The plane that fits the grain in the window best: at the pixel, per pixel to the right, and per pixel down.
fn grain_trend(pixel: vec2<i32>, own: Grain, tolerance: f32) -> vec3<f32> {
    var count = 0.0;
    var mean = vec3(0.0);       // x, y, grain
    var squares = vec3(0.0);    // x², y², xy
    var products = vec2(0.0);   // of grain with x and y
    for (var y = -RADIUS; y <= RADIUS; y++) {
        for (var x = -RADIUS; x <= RADIUS; x++) {
            let other = neighbour(pixel, vec2(x, y), own, tolerance);
            if other.distance > 0.0 {
                let at = vec2(f32(x), f32(y));
                count += 1.0;
                mean += vec3(at, other.excess);
                squares += vec3(at * at, at.x * at.y);
                products += other.excess * at;
            }
        }
    }
    mean /= count;
    squares = squares / count - vec3(mean.xy * mean.xy, mean.x * mean.y);
    products = products / count - mean.z * mean.xy;
    let determinant = squares.x * squares.y - squares.z * squares.z;
    let slopes = vec2(
        products.x * squares.y - products.y * squares.z,
        products.y * squares.x - products.x * squares.z,
    ) / max(determinant, 1e-6);
    let slope = select(vec2(0.0), slopes, determinant > 1e-3);
    return vec3(mean.z - dot(slope, mean.xy), slope);
}

@compute @workgroup_size(8, 8, 1)
fn remove_grain(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= placement.size) {
        return;
    }
    let encoded = textureLoad(found, id.xy, 0).xy;
    if all(encoded == NO_GRAIN) {
        return;
    }
    let own = decoded_grain(encoded);
    let pixel = vec2<i32>(id.xy);
    let color = textureLoad(picture, placement.origin + id.xy, 0);
    // Brighter pixels are infinite.
    if !all(color.rgb < vec3(MAX_HALF)) {
        textureStore(smoothed, id.xy, color);
        return;
    }
    let tolerance = depth_tolerance(pixel, own.distance);
    let trend = grain_trend(pixel, own, tolerance);
    // Sums of differences to the pixel itself, which are small.
    var count = 0.0;
    var light = 0.0;
    var colors = vec3(0.0);
    var grain_squared = 0.0;
    var grain_light = 0.0;
    var grain_colors = vec3(0.0);
    for (var y = -RADIUS; y <= RADIUS; y++) {
        for (var x = -RADIUS; x <= RADIUS; x++) {
            let other = neighbour(pixel, vec2(x, y), own, tolerance);
            if other.distance > 0.0 {
                let at = vec2<u32>(pixel + vec2(x, y));
                let neighbour_color = textureLoad(picture, placement.origin + at, 0).rgb;
                let more = min(neighbour_color, MOST_CONTRAST * color.rgb) - color.rgb;
                let lighter = other.light - own.light;
                let grain = other.excess - trend.x - dot(trend.yz, vec2(f32(x), f32(y)));
                count += 1.0;
                light += lighter;
                colors += more;
                grain_squared += grain * grain;
                grain_light += grain * lighter;
                grain_colors += grain * more;
            }
        }
    }
    // The lights contribute no more than the whole colour. Where there is hardly any grain, or where light does not
    // follow it because none arrives, nothing is known of them.
    let mean = max(color.rgb + colors / count, vec3(0.0));
    let most = mean / max(own.light + light / count, LEAST_LIGHT);
    let covariance = max(grain_light, grain_squared) + LEAST_VARIANCE * count;
    let gain = clamp(grain_colors / covariance, vec3(0.0), most);
    textureStore(smoothed, id.xy, vec4(max(color.rgb - gain * own.excess, vec3(0.0)), color.a));
}
