// Puts the traced picture into the camera's target. Two draws share it: surfaces, which also write
// their depth, and fog on its own, which is tested against the depth of the meshes but writes none.

#import bevy_core_pipeline::fullscreen_vertex_shader::FullscreenVertexOutput
#ifdef TONEMAP_IN_SHADER
#import bevy_render::view::View
#import bevy_core_pipeline::tonemapping::tone_mapping
#endif

@group(0) @binding(0) var traced_color: texture_2d<f32>;
@group(0) @binding(1) var traced_depth: texture_2d<f32>;
struct Placement {
    origin: vec2<u32>,
    size: vec2<u32>,
}
@group(0) @binding(2) var<uniform> placement: Placement;
#ifdef TONEMAP_IN_SHADER
@group(0) @binding(3) var<uniform> view: View;
#endif

struct Output {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn composite(in: FullscreenVertexOutput) -> Output {
    let pixel = min(vec2<u32>(in.position.xy) - placement.origin, placement.size - 1u);
    let depth = textureLoad(traced_depth, pixel, 0).x;
    var color = textureLoad(traced_color, pixel, 0);
#ifdef FOG_ALONE
    if depth >= 0.0 || depth < -2.5 {
        discard;
    }
    let at = -1.0 - depth;
#else
    if depth < 0.0 {
        discard;
    }
    let at = depth;
#endif
#ifdef TONEMAP_IN_SHADER
    // Without HDR, Bevy tonemaps what it draws, not the finished picture. The curve bends colour,
    // not coverage, so coverage is taken out for it.
    let straight = vec4(color.rgb / max(color.a, 1e-4), 1.0);
    color = vec4(tone_mapping(straight, view.color_grading).rgb * color.a, color.a);
#endif
    return Output(color, at);
}
