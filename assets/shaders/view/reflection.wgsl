// The reflection in a rough surface: the trace writes a texel per ray, for the denoising.
#define_import_path bevy_vdb::view::reflection

#import bevy_vdb::view::picture::MAX_COLOR

struct Reflection {
    radiance: vec3<f32>,    // times the exposure, before the surface's reflectance
    sharpness: f32,         // inverse of the standard deviation of the smoothing, per pixel of the traced image
    direction: vec3<f32>,   // in which a mirror in its place would reflect
    reflectance: vec3<f32>, // of the surface, times what is in front of it; 0 where nothing is to be denoised
    alpha: f32,             // of the distribution of microfacet normals: perceptual roughness squared
}

fn encoded_reflection(own: Reflection) -> vec4<u32> {
    return vec4(
        pack2x16float(own.radiance.rg),
        pack2x16float(vec2(own.radiance.b, min(own.sharpness, MAX_SHARPNESS))),
        pack2x16snorm(octahedral(own.direction)),
        pack4x8unorm(vec4(own.reflectance, own.alpha)),
    );
}

fn decoded_reflection(words: vec4<u32>) -> Reflection {
    let rest = unpack2x16float(words.y);
    let surface = unpack4x8unorm(words.w);
    return Reflection(
        vec3(unpack2x16float(words.x), rest.x),
        rest.y,
        from_octahedral(unpack2x16snorm(words.z)),
        surface.rgb,
        surface.a,
    );
}

// The first reflection along a ray in a surface that is no mirror, for its mean over frames. What is denoised may be a
// later one.
struct FirstReflection {
    direct: vec3<f32>,      // the ray's colour without that reflection and all that follows
    direction: vec3<f32>,   // in which a mirror in the surface's place would reflect
    alpha: f32,             // of the surface, as in `Reflection`; 0 if there is no such reflection
}

fn encoded_first(first: FirstReflection) -> vec2<u32> {
    let direction = vec2<u32>(round(4095.0 * (0.5 + 0.5 * octahedral(first.direction))));
    let alpha = u32(round(255.0 * saturate(first.alpha)));
    let surface = direction.x | (direction.y << 12u) | (alpha << 24u);
    return vec2(shared_exponent(first.direct), select(surface, 0u, alpha == 0u));
}

fn decoded_first(words: vec2<u32>) -> FirstReflection {
    let direction = vec2<f32>(vec2(words.y, words.y >> 12u) & vec2(4095u)) / 2047.5 - 1.0;
    return FirstReflection(from_shared_exponent(words.x), from_octahedral(direction), f32(words.y >> 24u) / 255.0);
}

// A colour in 32 bits: three numbers of 9 bits, rounded down, and an exponent, as in the texture format rgb9e5ufloat.
fn shared_exponent(color: vec3<f32>) -> u32 {
    let own = clamp(color, vec3(0.0), vec3(MAX_COLOR));
    let largest = max(max(own.r, own.g), max(own.b, 1.0 / 65536.0));
    let exponent = (bitcast<u32>(largest) >> 23u) - 111u;
    let parts = min(vec3<u32>(own * exp2(24.0 - f32(exponent))), vec3(511u));
    return parts.r | (parts.g << 9u) | (parts.b << 18u) | (exponent << 27u);
}

fn from_shared_exponent(word: u32) -> vec3<f32> {
    return vec3<f32>(vec3(word, word >> 9u, word >> 18u) & vec3(511u)) * exp2(f32(word >> 27u) - 24.0);
}

// The mean over frames of what a pixel's first reflection adds to its colour.
struct ReflectionMean {
    reflected: vec3<f32>,
    frames: f32,            // 0 where there is none
    direction: vec3<f32>,   // mean of `FirstReflection::direction`
    depth: f32,             // of the first surface, as in the depth buffer
}

fn encoded_mean(mean: ReflectionMean) -> vec4<u32> {
    // An infinity would never leave the mean.
    let reflected = clamp(mean.reflected, vec3(-MAX_COLOR), vec3(MAX_COLOR));
    return vec4(
        pack2x16float(reflected.rg),
        pack2x16float(vec2(reflected.b, mean.frames)),
        pack2x16snorm(octahedral(mean.direction)),
        bitcast<u32>(mean.depth),
    );
}

fn decoded_mean(words: vec4<u32>) -> ReflectionMean {
    let rest = unpack2x16float(words.y);
    return ReflectionMean(
        vec3(unpack2x16float(words.x), rest.x),
        rest.y,
        from_octahedral(unpack2x16snorm(words.z)),
        bitcast<f32>(words.w),
    );
}

// The weight of a reflection in one direction for that in another, in a surface whose distribution of microfacet
// normals has this `alpha`. The variance is alpha² / 12, a quarter of that between neighbours in `denoise.wgsl`, so that
// reflections do not lag behind a moving camera.
fn likeness(a: vec3<f32>, b: vec3<f32>, alpha: f32) -> f32 {
    let turned = a - b;
    return exp(-6.0 * dot(turned, turned) / max(alpha * alpha, 1e-6));
}

// Fits in a 16-bit float. A deviation of a thousandth of a pixel smooths nothing.
const MAX_SHARPNESS: f32 = 1000.0;

// A unit vector as a point of a square (Meyer et al. 2010, "On floating-point normal vectors"), and back.
fn octahedral(v: vec3<f32>) -> vec2<f32> {
    let p = v.xy / (abs(v.x) + abs(v.y) + abs(v.z));
    let folded = (1.0 - abs(p.yx)) * select(vec2(-1.0), vec2(1.0), p >= vec2(0.0));
    return select(folded, p, v.z >= 0.0);
}

fn from_octahedral(p: vec2<f32>) -> vec3<f32> {
    let z = 1.0 - abs(p.x) - abs(p.y);
    let folded = (1.0 - abs(p.yx)) * select(vec2(-1.0), vec2(1.0), p >= vec2(0.0));
    return normalize(vec3(select(folded, p, z >= 0.0), z));
}
