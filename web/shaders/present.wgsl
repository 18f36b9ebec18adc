// Shows the traced image on the canvas: enlarged if it has fewer rays than pixels, tone-mapped, and dithered.

struct Shown {
    traced: vec2<u32>,      // size of the traced image, in rays
    canvas: vec2<u32>,      // size of the canvas, in pixels
    frames: u32,            // in the sum; 0 if there is only the first
    shows_data: u32,
    exposure: f32,
}

@group(0) @binding(0) var<uniform> shown: Shown;
@group(0) @binding(1) var<storage, read> first_frame: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> frame_sum: array<vec4<f32>>;

// Frames after which the first, which has no shadows of the sky, is no longer seen.
const FADE: f32 = 16.0;

@vertex
fn corners(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    // A triangle around the canvas.
    return vec4(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn light_at(pixel: vec2<i32>) -> vec3<f32> {
    let at = vec2<u32>(clamp(pixel, vec2(0), vec2<i32>(shown.traced) - 1));
    let place = at.y * shown.traced.x + at.x;
    let first = first_frame[place].rgb;
    if shown.frames == 0u {
        return first;
    }
    let mean = frame_sum[place].rgb / f32(shown.frames);
    return mix(first, mean, min(f32(shown.frames) / FADE, 1.0));
}

// A fit to the curve of the Academy Color Encoding System (Narkowicz 2016).
fn tone_mapped(light: vec3<f32>) -> vec3<f32> {
    return saturate(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14));
}

fn srgb(linear: vec3<f32>) -> vec3<f32> {
    let curve = 1.055 * pow(max(linear, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055;
    return select(curve, 12.92 * linear, linear <= vec3(0.0031308));
}

@fragment
fn present(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let at = position.xy / vec2<f32>(shown.canvas) * vec2<f32>(shown.traced);
    if shown.shows_data == 1u {
        return vec4(light_at(vec2<i32>(at)), 1.0);
    }
    let corner = floor(at - 0.5);
    let part = at - 0.5 - corner;
    let low = vec2<i32>(corner);
    let upper = mix(light_at(low), light_at(low + vec2(1, 0)), part.x);
    let lower = mix(light_at(low + vec2(0, 1)), light_at(low + vec2(1, 1)), part.x);
    let color = srgb(tone_mapped(shown.exposure * mix(upper, lower, part.y)));
    // Jimenez's interleaved gradient noise, 2014, of one step of 8 bits: no bands in the sky.
    let noise = fract(52.9829189 * fract(dot(floor(position.xy), vec2(0.06711056, 0.00583715))));
    return vec4(color + (noise - 0.5) / 255.0, 1.0);
}
