// Depths of an image of volumes. That of a surface is its value in the depth buffer, 0 to 1. That of fog
// without a surface is negative and encodes the value where the fog begins. NO_DEPTH is that of nothing.
#define_import_path bevy_vdb::view::depths

const NO_DEPTH: f32 = -3.0;

fn is_surface_depth(encoded: f32) -> bool {
    return encoded >= 0.0;
}

fn is_fog_depth(encoded: f32) -> bool {
    return encoded < 0.0 && encoded > -2.5;
}

// From a value in the depth buffer, and back.
fn encoded_fog_depth(depth: f32) -> f32 {
    return -1.0 - depth;
}

fn decoded_fog_depth(encoded: f32) -> f32 {
    return -1.0 - encoded;
}
