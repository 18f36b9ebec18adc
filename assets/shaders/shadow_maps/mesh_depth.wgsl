// Copies the depths of a layer of a shadow map, before volumes or fogs are drawn over them.

@group(0) @binding(0) var layer: texture_depth_2d;

@fragment
fn mesh_depth(@builtin(position) position: vec4<f32>) -> @builtin(frag_depth) f32 {
    return textureLoad(layer, vec2<u32>(position.xy), 0);
}
