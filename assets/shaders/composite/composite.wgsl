// Draws the traced image into the camera's target, in two draws: surfaces, which also write depth, and fog
// alone, which is tested against the depth of the meshes but writes none.

#import bevy_core_pipeline::fullscreen_vertex_shader::FullscreenVertexOutput
#import bevy_vdb::gpu::types::Placement
#import bevy_vdb::view::depths::{decoded_fog_depth, is_fog_depth, is_surface_depth}
#ifdef TONEMAP_IN_SHADER
#import bevy_render::view::View
#import bevy_core_pipeline::tonemapping::tone_mapping
#endif

@group(0) @binding(0) var traced_color: texture_2d<f32>;
@group(0) @binding(1) var traced_depth: texture_2d<f32>;
@group(0) @binding(2) var<uniform> placement: Placement;
#ifdef TONEMAP_IN_SHADER
@group(0) @binding(3) var<uniform> view: View;
#endif

#ifdef VDB_VELOCITIES
#import bevy_vdb::gpu::types::Velocities
#endif

#ifdef VDB_MOTION_VECTORS
// The volume that each pixel moves with, as an index into the view's list, or an index outside it for none;
// and the bits of the depth of the point that moves.
@group(0) @binding(6) var moving: texture_2d<u32>;
// From the clip space of the view's rays to that of this frame without jitter; then, for each volume, to
// that of the previous frame.
@group(0) @binding(7) var<storage, read> clips: array<mat4x4<f32>>;

#ifdef VDB_VELOCITIES
// For each volume.
@group(0) @binding(8) var<storage, read> velocities: array<Velocities>;
// Means of velocities, as 16-bit floats: x, y, z, and 1, or 0 for cubes without any.
@group(0) @binding(9) var<storage, read> means: array<vec2<u32>>;

// The displacement within a volume since the previous frame, in the clip space of that frame, at a position
// in the clip space of the view's rays.
fn displacement_before(volume: u32, position: vec4<f32>) -> vec4<f32> {
    let own = velocities[volume];
    let place = own.lattice_from_clip * position;
    // Points at infinity have no place.
    if any(own.size == vec3(0u)) || !(place.w > 0.0) {
        return vec4(0.0);
    }
    let last = own.size - 1u;
    let at = clamp(place.xyz / place.w, vec3(0.0), vec3<f32>(last));
    let low = min(vec3<u32>(at), last);
    let high = min(low + 1u, last);
    let part = at - vec3<f32>(low);
    var sum = vec4(0.0);
    for (var i = 0u; i < 8u; i++) {
        let is_high = (vec3(i) & vec3(1u, 2u, 4u)) != vec3(0u);
        let corner = select(low, high, is_high);
        let weights = select(1.0 - part, part, is_high);
        let mean = means[own.first + (corner.z * own.size.y + corner.y) * own.size.x + corner.x];
        let value = vec4(unpack2x16float(mean.x), unpack2x16float(mean.y));
        sum += weights.x * weights.y * weights.z * value;
    }
    if sum.w <= 0.0 {
        return vec4(0.0);
    }
    return place.w * (own.clip_from_mean * (sum.xyz / sum.w));
}
#endif

// Motion vector in Bevy's convention: in viewport widths and heights, y downwards. The fourth component is 1
// where the motion is known.
fn motion_vector(pixel: vec2<u32>) -> vec4<f32> {
    let motion_source = textureLoad(moving, pixel, 0).xy;
    if motion_source.x >= arrayLength(&clips) - 1u {
        return vec4(0.0);
    }
    let uv = (vec2<f32>(pixel) + 0.5) / vec2<f32>(placement.size);
    let position = vec4(2.0 * uv.x - 1.0, 1.0 - 2.0 * uv.y, bitcast<f32>(motion_source.y), 1.0);
    let now = clips[0] * position;
    var before = clips[motion_source.x + 1u] * position;
#ifdef VDB_VELOCITIES
    before -= displacement_before(motion_source.x, position);
#endif
    // Points that were behind the camera came from outside the image.
    let displacement = now.xy / now.w - before.xy / max(before.w, 1e-6 * now.w);
    return vec4(clamp(displacement * vec2(0.5, -0.5), vec2(-100.0), vec2(100.0)), 0.0, 1.0);
}
#endif

struct Output {
    @location(0) color: vec4<f32>,
#ifdef VDB_MOTION_VECTORS
    @location(1) motion: vec4<f32>,
#endif
    @builtin(frag_depth) depth: f32,
}

@fragment
fn composite(in: FullscreenVertexOutput) -> Output {
    let pixel = min(vec2<u32>(in.position.xy) - placement.origin, placement.size - 1u);
    let depth = textureLoad(traced_depth, pixel, 0).x;
    var color = textureLoad(traced_color, pixel, 0);
#ifdef VDB_FOG_ALONE
    if !is_fog_depth(depth) {
        discard;
    }
    let out_depth = decoded_fog_depth(depth);
#else
    if !is_surface_depth(depth) {
        discard;
    }
    let out_depth = depth;
#endif
#ifdef TONEMAP_IN_SHADER
    // Without HDR, Bevy tonemaps each draw instead of the final image. The curve applies to colour, not to
    // coverage, so divide by coverage first.
#ifdef VDB_EMISSION
    // Emission has no coverage: the brighter the colour relative to its coverage, the less it is divided.
    let brightest = max(max(color.r, color.g), color.b);
    let alpha = mix(color.a, 1.0, saturate(1.0 - color.a / max(brightest, 1e-4)));
#else
    let alpha = color.a;
#endif
    let straight = vec4(color.rgb / max(alpha, 1e-4), 1.0);
    color = vec4(tone_mapping(straight, view.color_grading).rgb * alpha, color.a);
#endif
#ifdef VDB_MOTION_VECTORS
    return Output(color, motion_vector(pixel), out_depth);
#else
    return Output(color, out_depth);
#endif
}
