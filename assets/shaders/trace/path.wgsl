// Radiance along a view ray: the nearest surface of all volumes, then all fogs in front of it, and again for
// reflections.
#define_import_path bevy_vdb::trace::path

#import bevy_vdb::gpu::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE}
#import bevy_vdb::trace::candidates::{next_candidate, start_t, volume_end}
#import bevy_vdb::trace::segment::{NONE, Segment, lattice_ray, point_at}
#import bevy_vdb::trace::surface::{Surface, nearer, no_surface}
#import bevy_vdb::view::depths::{NO_DEPTH, encoded_fog_depth, is_surface_depth}
#import bevy_vdb::view::picture::{MAX_COLOR, depth_of_meshes, t_of_depth}
#import bevy_vdb::view::scene::{depth_of_t, target_pixel, view, volumes}
#ifdef VDB_REFLECTIONS
#import bevy_vdb::view::scene::{interleaved_gradient_noise, random_pair}
#endif
#ifdef VDB_SURFACES
#import bevy_vdb::trace::surface::intersect_voxels
#endif
#ifdef VDB_SMOOTH
#import bevy_vdb::trace::surface::intersect_smooth
#endif
#ifdef VDB_FOGS
#import bevy_vdb::trace::fogs::trace_fogs
#ifdef VDB_LIT
#import bevy_vdb::trace::fog_march::Fog
#endif
#endif
#ifdef VDB_LIT
#ifdef DISTANCE_FOG
#import bevy_vdb::trace::distance_fog::apply_distance_fog
#endif
#import bevy_vdb::trace::lights::shading_point
#ifdef VDB_DENOISE
#import bevy_vdb::trace::reflection::{FARTHEST, PathReflection, add_reflected, begin_reflection, continue_reflection}
#import bevy_vdb::trace::reflection::{final_blur, is_sharp}
#import bevy_vdb::view::reflection::Reflection
#ifdef VDB_REFLECTION_HISTORY
#import bevy_pbr::lighting::perceptualRoughnessToRoughness
#import bevy_vdb::trace::shade::is_mirror
#import bevy_vdb::view::reflection::FirstReflection
#endif
#endif
#ifdef VDB_MESH_REFLECTIONS
#import bevy_vdb::trace::mesh_reflections::reflected_mesh
#import bevy_vdb::trace::segment::world_position
#endif
#import bevy_vdb::trace::material::material_at
#import bevy_vdb::trace::shade::{sample_reflection, shade}
#import bevy_vdb::trace::surface::offset_origin
#else
#import bevy_vdb::trace::surface::shading_normal
#import bevy_vdb::trace::show::{axis_weights, gray, voxel_color}
#endif
#ifdef VDB_OVERLAYS
#import bevy_vdb::trace::show::with_overlays
#endif
#ifdef VDB_COUNT_STEPS
#import bevy_vdb::traversal::hdda::steps
#endif
#ifdef VDB_SHOW_MAXIMUM
#import bevy_vdb::trace::maximum::brightest
#endif

#ifdef MULTISAMPLED
@group(2) @binding(6) var scene_depth: texture_depth_multisampled_2d;
#else
@group(2) @binding(6) var scene_depth: texture_depth_2d;
#endif

// The t of the opaque meshes at a pixel.
fn mesh_t(pixel: vec2<u32>) -> f32 {
    return t_of_depth(view.t_from_depth, depth_of_meshes(scene_depth, target_pixel(pixel)));
}

// The nearest surface before `t_max`.
fn nearest_surface(segment: Segment, pixel: vec2<u32>, t_max: f32) -> Surface {
    var nearest = no_surface();
    var t_end = t_max;
    let end = volume_end(segment);
    var i = next_candidate(segment, pixel, view.volume_first, t_end);
    for (; i < end; i = next_candidate(segment, pixel, i + 1u, t_end)) {
        let start = start_t(segment, i, pixel);
        if volumes[i].kind == KIND_FOG || start >= t_end {
            continue;
        }
        let ray = lattice_ray(segment, i, t_end);
#ifdef VDB_SURFACES
        if volumes[i].kind == KIND_SURFACE {
            nearest = nearer(nearest, intersect_voxels(segment, i, ray, start));
        }
#endif
#ifdef VDB_SMOOTH
        if volumes[i].kind == KIND_SMOOTH {
            nearest = nearer(nearest, intersect_smooth(segment, i, ray, start));
        }
#endif
        t_end = select(t_end, nearest.t, nearest.found);
    }
    return nearest;
}

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

#ifdef VDB_LIT
#ifdef VDB_REFLECTIONS
// More than the bounces of a path: `VdbQuality::reflections` is at most 16.
const MAX_BOUNCES: u32 = 17u;

// The number of the frame for the random directions of reflections. Only the first ray of a pixel is averaged over
// frames; the others keep their noise unless frames are accumulated or jittered.
fn frame_of(ray: u32) -> u32 {
#ifdef VDB_REFLECTION_HISTORY
    return select(view.frame, view.reflection_frame, ray == 0u);
#else
    return view.frame;
#endif
}

// A number in [0, 1) that is evenly distributed among neighbouring pixels, another one for each bounce.
fn bounce_noise(pixel: vec2<u32>, bounce: u32) -> f32 {
    return interleaved_gradient_noise(vec2<f32>(pixel) + 5.588238 * f32(bounce));
}
#endif

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

// Radiance along a view ray and its reflections. `ray` tells apart the rays of a pixel, which have random numbers of
// their own.
fn trace_path(primary: Segment, pixel: vec2<u32>, ray: u32, t_end: f32) -> PathResult {
    var result = nothing_met();
    var segment = primary;
    var t_max = t_end;
    // Throughput of the path so far, and the radiance to add if the next segment hits nothing.
    var throughput = vec3(1.0);
    var miss_radiance = vec3(0.0);
    var first_surface = no_surface();
    // The contribution of the fog before the first surface.
    var fog_layer = FogLayer(vec3(0.0), 0.0, 0.0);
    var roughness = 0.0;
#ifdef VDB_DENOISE
    var reflection = PathReflection();
#endif
    for (var bounce = 0u; bounce <= view.reflections; bounce++) {
        let surface = nearest_surface(segment, pixel, t_max);
        t_max = select(t_max, surface.t, surface.found);
#ifdef VDB_DENOISE
        if bounce > 0u {
            continue_reflection(&reflection, t_max);
        }
#endif
        if surface.found && bounce == 0u {
            first_surface = surface;
            result.coverage = 1.0;
            result.depth = depth_of_t(surface.t);
            result.motion_volume = surface.volume;
            result.motion_depth = result.depth;
        }
#ifdef VDB_FOGS
        let fog = trace_fogs(segment, pixel, t_max);
        let transmittance = exp(-fog.optical_depth);
#ifndef VDB_GLOSSY_ONLY
        result.color += throughput * fog.radiance;
#endif
        throughput *= transmittance;
        miss_radiance *= transmittance;
        if bounce == 0u {
            fog_layer = see_fog(&result, fog, transmittance);
        }
#endif
        if !surface.found {
            result.color += miss_radiance;
            break;
        }
        let point = offset_origin(segment, surface);
        let to_viewer = -normalize(segment.dir);
        let material = material_at(segment, surface, to_viewer);
        let normal = material.normal;
        let at = shading_point(point_at(segment, surface.t), normal, pixel, segment.is_view);
        // At least that of the surfaces hit before. A path scattered by a rough surface would otherwise find a
        // sharp highlight in a few pixels only, instead of a little of it in all.
        roughness = max(material.perceptual_roughness, roughness);
        let shaded = shade(material, at, point, to_viewer, roughness, bounce < view.reflections);
        result.color += throughput * shaded.radiance;
#ifdef VDB_DENOISE
        if bounce > 0u {
            add_reflected(&reflection, throughput * shaded.radiance, reflection.length);
        }
#endif
        miss_radiance = throughput * shaded.ambient_specular;
        throughput *= shaded.specular_weight;
#ifdef VDB_REFLECTIONS
        // Less than the step of 16-bit floats near 1.
        if bounce < view.reflections && max(max(throughput.x, throughput.y), throughput.z) > 1.0 / 4096.0 {
            let pair = random_pair(pixel, ray * MAX_BOUNCES + bounce, frame_of(ray));
            let direction = sample_reflection(roughness, normal, to_viewer, pair);
#ifdef VDB_DENOISE
            let mirrored = reflect(-to_viewer, normal);
            if is_sharp(reflection, primary, first_surface.t) {
                begin_reflection(&reflection, result.color, roughness, mirrored, throughput);
            }
#endif
#ifdef VDB_REFLECTION_HISTORY
            if result.first.alpha == 0.0 && !is_mirror(roughness) {
                let alpha = perceptualRoughnessToRoughness(roughness);
                result.first = FirstReflection(result.color, mirrored, alpha);
            }
#endif
            segment = Segment(point, direction, false, 0.0);
            t_max = view.reflection_range;
#ifdef VDB_MESH_REFLECTIONS
            let origin = world_position(point);
            let mesh = reflected_mesh(scene_depth, origin, direction, t_max, bounce_noise(pixel, bounce));
            miss_radiance = mix(miss_radiance, throughput * mesh.radiance, mesh.share);
            t_max = select(t_max, mesh.t, mesh.share > 0.5);
#endif
            continue;
        }
#endif
        result.color += miss_radiance;
        break;
    }
#ifdef VDB_DENOISE
    // What remains, such as an environment map's light, comes from far away.
    result.reflection = ended_reflection(reflection, result.color, miss_radiance, primary, first_surface.t);
#endif
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
#else ifdef VDB_SHOW_MAXIMUM
// The largest value of fog along a view ray.
fn trace_path(primary: Segment, pixel: vec2<u32>, ray: u32, t_end: f32) -> PathResult {
    var result = nothing_met();
#ifdef VDB_FOGS
    let found = brightest(primary, pixel, t_end);
    if found.volume != NONE {
        result.color = vec3(min(found.value, view.mode_scale) / view.mode_scale);
        result.coverage = 1.0;
        result.depth = encoded_fog_depth(depth_of_t(found.t));
        result.motion_volume = found.volume;
        result.motion_depth = depth_of_t(found.t);
    }
#endif
    return result;
}
#else
// The surface that a view ray hits, in the colours of the render mode.
fn trace_path(primary: Segment, pixel: vec2<u32>, ray: u32, t_end: f32) -> PathResult {
    var result = nothing_met();
    let surface = nearest_surface(primary, pixel, t_end);
    if surface.found {
        result.coverage = 1.0;
        result.depth = depth_of_t(surface.t);
        result.motion_volume = surface.volume;
        result.motion_depth = result.depth;
#ifdef VDB_SHOW_NORMALS
        result.color = 0.5 + 0.5 * shading_normal(surface);
#endif
#ifdef VDB_SHOW_DEPTH
        result.color = vec3(result.depth);
#endif
#ifdef VDB_SHOW_GRAY
        result.color = vec3(gray(surface));
#endif
#ifdef VDB_SHOW_AXES
        result.color = axis_weights(surface);
#endif
#ifdef VDB_SHOW_VOXELS
        result.color = voxel_color(surface);
#endif
        result.color = with_borders(result.color, primary, surface);
    }
#ifdef VDB_COUNT_STEPS
#ifdef VDB_FOGS
    let t_max = select(t_end, surface.t, surface.found);
    let fog = trace_fogs(primary, pixel, t_max);
#endif
    if steps > 0u {
        result.color = with_borders(heat_map(f32(steps) / view.mode_scale), primary, surface);
        result.coverage = 1.0;
        let fog_depth = encoded_fog_depth(depth_of_t(view.t_near));
        result.depth = select(fog_depth, result.depth, is_surface_depth(result.depth));
    }
#endif
    return result;
}

#ifdef VDB_COUNT_STEPS
// Light blue to red.
fn heat_map(x: f32) -> vec3<f32> {
    return mix(vec3(0.55, 0.8, 1.0), vec3(1.0, 0.0, 0.0), saturate(x));
}
#endif
#endif

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
