// The reflection in a rough surface: the trace writes a texel per ray, for the denoising.
#define_import_path bevy_vdb::view::reflection

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
