// Radiance along a view ray: the nearest surface of all volumes, then all fogs in front of it, and again for
// reflections.
#define_import_path bevy_vdb::trace::path

#import bevy_vdb::gpu::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE}
#import bevy_vdb::trace::candidates::{next_candidate, start_t, volume_end}
#import bevy_vdb::trace::seen::{PathResult, nothing_met, see_surface, with_borders}
#import bevy_vdb::trace::segment::{NONE, Segment, lattice_ray, point_at}
#import bevy_vdb::trace::surface::{Surface, nearer, no_surface}
#import bevy_vdb::view::depths::{encoded_fog_depth, is_surface_depth}
#import bevy_vdb::view::picture::{depth_of_meshes, t_of_depth}
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
#endif
#ifdef VDB_LIT
#import bevy_vdb::trace::lights::shading_point
#import bevy_vdb::trace::seen::{FogLayer, displayed}
#ifdef VDB_FOGS
#import bevy_vdb::trace::seen::see_fog
#endif
#ifdef VDB_DENOISE
#import bevy_vdb::trace::reflection::{PathReflection, add_reflected, begin_reflection, continue_reflection, is_sharp}
#import bevy_vdb::trace::seen::ended_reflection
#ifdef VDB_REFLECTION_HISTORY
#import bevy_vdb::trace::seen::remember_reflection
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
            see_surface(&result, surface);
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
            remember_reflection(&result, roughness, mirrored);
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
    return displayed(result, fog_layer, first_surface, primary, pixel);
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
        see_surface(&result, surface);
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
