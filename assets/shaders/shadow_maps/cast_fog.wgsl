// Renders fogs into one of Bevy's shadow maps: the fragments of a quad (`quad.wgsl`) look up in the opacity map of its
// fog where the light of their texel is stopped.

#import bevy_vdb::view::scene::{depth_of_t, view}
#import bevy_vdb::shadow_maps::opacity::{SLICES, SLICE_LAYERS, opacity_maps}

@group(0) @binding(1) var opacity: texture_2d_array<f32>;
@group(0) @binding(2) var linear_sampler: sampler;

// The lowest of the 256 thresholds, which an offset does not undercut.
const LEAST_THRESHOLD: f32 = 0.001953125;  // 1/512

// The transmittance at which a texel stops its light. Fog attenuates light gradually, but a texel has a single
// depth. Each texel therefore has a threshold of its own: 256 thresholds in squares of 16×16 texels, after
// Bayer 1973, "An optimum method for two-level rendition of continuous-tone pictures", whose patterns are so
// fine that shadow map filtering smooths them. The first three digits of further fogs are rotated, so that up to
// three fogs in front of each other hardly share thresholds. The last digit, that of the coarsest squares, stays
// the last, or the pattern would be as coarse as these. In views with temporal jitter, the thresholds change every
// frame.
fn dither_threshold(texel: vec2<u32>, fog: u32) -> f32 {
    var digits = 0u;
    for (var i = 0u; i < 4u; i++) {
        let bit = (texel >> vec2(i)) & vec2(1u);
        let place = select(1u + (2u - i + fog % 3u) % 3u, 0u, i == 3u);
        digits |= (2u * (bit.x ^ bit.y) + bit.y) << (2u * place);
    }
    return max(fract((f32(digits) + 0.5) / 256.0 + view.random_offset), LEAST_THRESHOLD);
}

@fragment
fn stop(
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) volume: u32,
) -> @builtin(frag_depth) f32 {
    let map = opacity_maps[volume];
    if any(map.size == vec2(0u)) {
        discard;
    }
    // The ray of a sample is at its middle. Beyond the first and the last, no texel is shown, or no light is stopped.
    let sample = (position.xy - map.first_texel) / map.spacing;
    let place = clamp(sample, vec2(0.0), vec2<f32>(map.size) - 1.0) + 0.5;
    let uv = (vec2<f32>(map.origin) + place) / vec2<f32>(textureDimensions(opacity));
    let optical_depth = -log(dither_threshold(vec2<u32>(position.xy), volume - view.volume_first));
    // How many layers end before it, and with which optical depth the last of them does.
    var layers = 0u;
    var before = 0.0;
    for (var step = SLICE_LAYERS / 2u; step > 0u; step /= 2u) {
        let last = textureSampleLevel(opacity, linear_sampler, uv, layers + step, 0.0).w;
        if last < optical_depth {
            layers += step;
            before = last;
        }
    }
    let after = textureSampleLevel(opacity, linear_sampler, uv, layers + 1u, 0.0);
    if after.w < optical_depth {
        discard;
    }
    let first = vec4(before, after.xyz);
    let i = dot(vec3<u32>(after.xyz < vec3(optical_depth)), vec3(1u));
    let part = (optical_depth - first[i]) / max(after[i] - first[i], 1e-30);
    let slices = f32(4u * layers + i) + saturate(part);
    let halves = textureSampleLevel(opacity, linear_sampler, uv, 0u, 0.0);
    let ends = halves.xy + halves.zw;
    return depth_of_t(mix(map.t_first, map.t_last, mix(ends.x, ends.y, slices / f32(SLICES))));
}
