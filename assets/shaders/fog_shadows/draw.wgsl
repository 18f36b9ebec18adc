// Draws the smoothed pixels into the camera's target.

#import bevy_vdb::fog_shadows::grain::NO_GRAIN
#import bevy_vdb::gpu::types::Placement

@group(0) @binding(0) var found: texture_2d<u32>;
@group(0) @binding(1) var smoothed: texture_2d<f32>;
@group(0) @binding(2) var<uniform> placement: Placement;

@fragment
fn draw(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(position.xy) - placement.origin;
    if all(textureLoad(found, pixel, 0).xy == NO_GRAIN) {
        discard;
    }
    return textureLoad(smoothed, pixel, 0);
}
