// What a view ray sees: the first surface, the fogs before it, and what the first rough surface reflects.
#define_import_path bevy_vdb::trace::seen

#import bevy_vdb::trace::segment::{NONE, Segment}
#import bevy_vdb::trace::surface::Surface
#import bevy_vdb::view::depths::NO_DEPTH
#import bevy_vdb::view::picture::MAX_COLOR
#import bevy_vdb::view::scene::depth_of_t
#ifdef VDB_LIT
#import bevy_vdb::view::scene::view
#ifdef DISTANCE_FOG
#import bevy_vdb::trace::distance_fog::apply_distance_fog
#import bevy_vdb::trace::lights::shading_point
#import bevy_vdb::trace::segment::point_at
#endif
#ifdef VDB_FOGS
#import bevy_vdb::trace::fog_march::Fog
#import bevy_vdb::view::depths::{encoded_fog_depth, is_surface_depth}
#endif
#ifdef VDB_DENOISE
#import bevy_vdb::trace::reflection::{FARTHEST, PathReflection, add_reflected, final_blur}
#import bevy_vdb::view::reflection::Reflection
#ifdef VDB_REFLECTION_HISTORY
#import bevy_pbr::lighting::perceptualRoughnessToRoughness
#import bevy_vdb::trace::shade::is_mirror
#import bevy_vdb::view::reflection::FirstReflection
#endif
#endif
#endif
#ifdef VDB_OVERLAYS
#import bevy_vdb::trace::show::with_overlays
#endif

// The result of tracing a view ray.
struct PathResult {
    color: vec3<f32>,       // luminance, or a colour of another render mode
    coverage: f32,
    depth: f32,
    motion_volume: u32,     // the volume that the pixel moves with, or NONE
    motion_depth: f32,
#ifdef VDB_DENOISE
    reflection: Reflection, // in the first surface, if it is rough
#endif
#ifdef VDB_REFLECTION_HISTORY
    first: FirstReflection,
#endif
}

fn nothing_met() -> PathResult {
    var result = PathResult();
    result.depth = NO_DEPTH;
    result.motion_volume = NONE;
    return result;
}

// Sets a pixel's coverage, depth and motion to those of its first surface.
fn see_surface(result: ptr<function, PathResult>, surface: Surface) {
    (*result).coverage = 1.0;
    (*result).depth = depth_of_t(surface.t);
    (*result).motion_volume = surface.volume;
    (*result).motion_depth = (*result).depth;
}

// Overlays the borders of tree nodes if the camera shows them.
fn with_borders(color: vec3<f32>, segment: Segment, surface: Surface) -> vec3<f32> {
#ifdef VDB_OVERLAYS
    if surface.found {
        return with_overlays(color, segment, surface);
    }
#endif
    return color;
}

// Replaces NaNs by 0 and infinities by the largest colour: lights may produce both.
fn finite(color: vec3<f32>) -> vec3<f32> {
    let bits = bitcast<vec3<u32>>(color);
    let is_finite = (bits & vec3(0x7f800000u)) != vec3(0x7f800000u);
    let is_infinite = bits == vec3(0x7f800000u);
    let finite_color = select(vec3(0.0), color, is_finite);
    return clamp(select(finite_color, vec3(MAX_COLOR), is_infinite), vec3(0.0), vec3(MAX_COLOR));
}

#ifdef VDB_LIT
// The fog in front of the first surface.
struct FogLayer {
    radiance: vec3<f32>,
    coverage: f32,
    t: f32,
}

#ifdef DISTANCE_FOG
// Applies distance fog at a point of a view ray.
fn with_distance_fog(
    color: vec3<f32>,
    coverage: f32,
    segment: Segment,
    t: f32,
    pixel: vec2<u32>,
) -> vec3<f32> {
    let at = shading_point(point_at(segment, t), vec3(0.0), pixel, true);
#ifdef VDB_EMITS
    // Emission has no coverage, so it must not add the distance fog's own light.
    let fog_alone = apply_distance_fog(vec3(0.0), 1.0, at);
    return apply_distance_fog(color, 1.0, at) - (1.0 - coverage) * fog_alone;
#else
    return apply_distance_fog(color, coverage, at);
#endif
}

// Applies distance fog to what a view ray sees: to the fogs at their mean distance, and to the first surface and all
// that it reflects at its own.
fn through_distance_fog(
    seen: PathResult,
    fog_layer: FogLayer,
    first_surface: Surface,
    primary: Segment,
    pixel: vec2<u32>,
) -> PathResult {
    var result = seen;
    let fog_color = view.exposure * fog_layer.radiance;
    result.color = with_distance_fog(fog_color, fog_layer.coverage, primary, fog_layer.t, pixel);
    if first_surface.found {
        let surface_color = seen.color - fog_color;
        let coverage = seen.coverage - fog_layer.coverage;
#ifdef VDB_REFLECTION_HISTORY
        let direct = seen.first.direct - fog_color;
        result.first.direct = result.color + with_distance_fog(direct, coverage, primary, first_surface.t, pixel);
#endif
        result.color += with_distance_fog(surface_color, coverage, primary, first_surface.t, pixel);
#ifdef VDB_DENOISE
        let reflectance = seen.reflection.reflectance;
        result.reflection.reflectance = with_distance_fog(reflectance, 0.0, primary, first_surface.t, pixel);
#endif
    }
    return result;
}
#endif

#ifdef VDB_FOGS
// Adds the fogs before the first surface to what a view ray sees, except for their radiance.
fn see_fog(result: ptr<function, PathResult>, fog: Fog, transmittance: f32) -> FogLayer {
#ifdef VDB_EMITS
    let is_seen = fog.optical_depth > 0.0 || any(fog.radiance > vec3(0.0));
#else
    let is_seen = fog.optical_depth > 0.0;
#endif
    if !is_seen {
        return FogLayer(vec3(0.0), 0.0, 0.0);
    }
    (*result).coverage = 1.0 - transmittance * (1.0 - (*result).coverage);
    let fog_depth = encoded_fog_depth(depth_of_t(fog.t_first));
    (*result).depth = select(fog_depth, (*result).depth, is_surface_depth((*result).depth));
    // A pixel moves with the volume that contributes most of its light.
    if transmittance < 0.5 {
        (*result).motion_volume = fog.motion_volume;
        (*result).motion_depth = depth_of_t(fog.t_mean);
    }
    return FogLayer(fog.radiance, 1.0 - transmittance, fog.t_mean);
}
#endif

#ifdef VDB_DENOISE
// The reflection of a path that ends with the luminance `color`, of which `rest` comes from far away.
fn ended_reflection(
    path: PathReflection,
    color: vec3<f32>,
    rest: vec3<f32>,
    primary: Segment,
    t: f32,
) -> Reflection {
    var reflection = path;
    if any(path.own.reflectance > vec3(0.0)) {
        add_reflected(&reflection, max(rest, vec3(0.0)), FARTHEST);
        let reflected = view.exposure * (color - path.direct);
        reflection.own.radiance = finite(reflected / max(path.own.reflectance, vec3(1e-30)));
        reflection.own.sharpness = 1.0 / max(final_blur(reflection, primary, t), 1e-30);
    }
    return reflection.own;
}
#endif

#ifdef VDB_REFLECTION_HISTORY
// At the first rough surface: keeps the colour without its reflection, the direction that a mirror would reflect, and
// the roughness.
fn remember_reflection(result: ptr<function, PathResult>, roughness: f32, mirrored: vec3<f32>) {
    if (*result).first.alpha == 0.0 && !is_mirror(roughness) {
        let alpha = perceptualRoughnessToRoughness(roughness);
        (*result).first = FirstReflection((*result).color, mirrored, alpha);
    }
}
#endif

// The result of a path as it is displayed: times the exposure, through distance fog, and with the borders of tree
// nodes.
fn displayed(
    seen: PathResult,
    fog_layer: FogLayer,
    first_surface: Surface,
    primary: Segment,
    pixel: vec2<u32>,
) -> PathResult {
    var result = seen;
    result.color *= view.exposure;
#ifdef VDB_REFLECTION_HISTORY
    result.first.direct *= view.exposure;
#endif
#ifdef DISTANCE_FOG
    result = through_distance_fog(result, fog_layer, first_surface, primary, pixel);
#endif
    result.color = with_borders(result.color, primary, first_surface);
#ifdef VDB_REFLECTION_HISTORY
    result.first.direct = with_borders(result.first.direct, primary, first_surface);
#endif
    return result;
}
#endif
