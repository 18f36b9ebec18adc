// What is known of the grain at a pixel.
#define_import_path bevy_vdb::fog_shadows::grain

// Light is relative to what would arrive without shadows from all lights that cast them.
struct Grain {
    excess: f32,    // light that arrives in the picture, beyond that which should
    light: f32,     // light that arrives in the picture
    distance: f32,  // along the camera's axis, more than 0
}

// Where fog takes no light.
const NO_GRAIN: vec2<u32> = vec2(0u);

fn encoded_grain(grain: Grain) -> vec2<u32> {
    return vec2(pack2x16float(vec2(grain.excess, grain.light)), bitcast<u32>(grain.distance));
}

fn decoded_grain(encoded: vec2<u32>) -> Grain {
    let light = unpack2x16float(encoded.x);
    return Grain(light.x, light.y, bitcast<f32>(encoded.y));
}
