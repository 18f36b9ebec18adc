// One thread a pixel: the nearest surface of all volumes, then all fogs in front of it; and the same
// again for what the surface reflects.
// Writes radiance times exposure, premultiplied with coverage, and a depth for the composite.

#import bevy_vdb::gpu::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE}
#import bevy_vdb::traversal::rays::ndc_of
#import bevy_vdb::view::picture::{depth_of_meshes, t_of_depth}
#import bevy_vdb::trace::candidates::{end_of, next_volume, start_of}
#import bevy_vdb::view::scene::{target_pixel, view, volumes}
#ifdef VDB_REFLECTIONS
#import bevy_vdb::view::scene::chance_of_frame
#endif
#import bevy_vdb::trace::segment::{NONE, Segment, along, ray_of, view_segment, world_position}
#import bevy_vdb::trace::surface::{Surface, leave, nearer, no_surface, normal_of}
#ifdef VDB_SURFACES
#import bevy_vdb::trace::surface::meet_voxels
#endif
#ifdef VDB_SMOOTH
#import bevy_vdb::trace::surface::meet_smooth
#endif
#ifdef VDB_FOGS
#import bevy_vdb::trace::fogs::trace_fogs
#endif
#ifdef VDB_LIT
#ifdef DISTANCE_FOG
#import bevy_vdb::trace::lights::through_distance_fog
#endif
#import bevy_vdb::trace::lights::{Lit, reflected, roughness_seen, shade}
#else
#import bevy_vdb::trace::show::{axis_shares, gray, voxel_color}
#endif
#ifdef VDB_COLORS
#import bevy_vdb::trace::color::color_along
#endif
#ifdef VDB_OVERLAYS
#import bevy_vdb::trace::show::overlaid
#endif
#ifdef VDB_COUNT_STEPS
#import bevy_vdb::traversal::hdda::steps
#endif

#ifdef MULTISAMPLED
@group(2) @binding(6) var scene_depth: texture_depth_multisampled_2d;
#else
@group(2) @binding(6) var scene_depth: texture_depth_2d;
#endif
@group(2) @binding(7) var out_color: texture_storage_2d<rgba16float, write>;
// A surface: its depth, 0 to 1. Fog alone: -1 - the depth where it begins. Nothing: -3.
@group(2) @binding(8) var out_depth: texture_storage_2d<r32float, write>;

const NOTHING: f32 = -3.0;

#ifdef VDB_MOTION_VECTORS
// The volume that a pixel moves with, in the view's list, or NONE; and the bits of the depth of the
// place that moves.
@group(2) @binding(10) var out_moving: texture_storage_2d<rg32uint, write>;
#endif

// What a 16-bit float can hold.
const MAX_COLOR: f32 = 65000.0;

// The t of whatever opaque meshes show at a pixel.
fn scene_t(pixel: vec2<u32>) -> f32 {
    return t_of_depth(view.t_from_depth, depth_of_meshes(scene_depth, target_pixel(pixel)));
}

fn depth_at(t: f32) -> f32 {
    let m = view.depth_from_t;
    return saturate((m.x * t + m.y) / (m.z * t + m.w));
}

// The nearest surface before `t_max`.
fn nearest_surface(segment: Segment, pixel: vec2<u32>, t_max: f32) -> Surface {
    var nearest = no_surface();
    var t_end = t_max;
    let end = end_of(segment);
    var i = next_volume(segment, pixel, view.volume_first, t_end);
    for (; i < end; i = next_volume(segment, pixel, i + 1u, t_end)) {
        let start = start_of(segment, i, pixel);
        if volumes[i].kind == KIND_FOG || start >= t_end {
            continue;
        }
        let ray = ray_of(segment, i, t_end);
#ifdef VDB_SURFACES
        if volumes[i].kind == KIND_SURFACE {
            nearest = nearer(nearest, meet_voxels(i, ray, start));
        }
#endif
#ifdef VDB_SMOOTH
        if volumes[i].kind == KIND_SMOOTH {
            nearest = nearer(nearest, meet_smooth(i, ray, start));
        }
#endif
        t_end = select(t_end, nearest.t, nearest.found);
    }
    return nearest;
}

// What the view's ray finds.
struct Found {
    color: vec3<f32>,       // luminance, or what is shown instead
    coverage: f32,
    depth: f32,
    mover: u32,             // the volume that it moves with, or NONE
    mover_depth: f32,
}

#ifdef VDB_LIT
#ifdef VDB_REFLECTIONS
// Two numbers from 0 up to but not 1, of a pixel's own, that neighbours share evenly among them: the
// fractional parts of multiples of the plastic number's powers, as Martin Roberts has it, on a noise of
// Jorge Jimenez's.
fn chance(pixel: vec2<u32>, bounce: u32) -> vec2<f32> {
    let at = vec2<f32>(pixel) + 5.588238 * f32(bounce);
    let noise = fract(52.9829189 * fract(dot(at, vec2(0.06711056, 0.00583715))));
    let turn = vec2(chance_of_frame(0.41421356), chance_of_frame(0.73205081));
    return fract(noise + turn + vec2(0.7548776662, 0.5698402910) * f32(bounce + 1u));
}
#endif

// What fogs add to the view's ray.
struct Veil {
    radiance: vec3<f32>,
    coverage: f32,
    t: f32,
}

#ifdef DISTANCE_FOG
// What the distance of a place on a ray of the view leaves of it.
fn far_away(color: vec3<f32>, coverage: f32, segment: Segment, t: f32, pixel: vec2<u32>) -> vec3<f32> {
    let coord = vec2<f32>(target_pixel(pixel)) + 0.5;
    let at = Lit(world_position(along(segment, t)), vec3(0.0), coord, true);
#ifdef VDB_EMISSION
    // What shines covers nothing: of the distance's own light, it gets none.
    let without = through_distance_fog(vec3(0.0), 1.0, at);
    return through_distance_fog(color, 1.0, at) - (1.0 - coverage) * without;
#else
    return through_distance_fog(color, coverage, at);
#endif
}
#endif

// The light along the view's ray.
fn look(first: Segment, pixel: vec2<u32>, t_end: f32) -> Found {
    var found = Found(vec3(0.0), 0.0, NOTHING, NONE, 0.0);
    var segment = first;
    var t_max = t_end;
    // The part of what a segment brings that is seen, and what is seen if it meets nothing.
    var part = vec3(1.0);
    var if_nothing = vec3(0.0);
    var seen = no_surface();
    // Of what is seen, the part that is of fogs before the first surface.
    var veil = Veil(vec3(0.0), 0.0, 0.0);
    var roughness = 0.0;
    for (var bounce = 0u; bounce <= view.reflections; bounce++) {
        let surface = nearest_surface(segment, pixel, t_max);
        t_max = select(t_max, surface.t, surface.found);
        if surface.found && bounce == 0u {
            seen = surface;
            found.coverage = 1.0;
            found.depth = depth_at(surface.t);
            found.mover = surface.volume;
            found.mover_depth = found.depth;
        }
#ifdef VDB_FOGS
        let fog = trace_fogs(segment, pixel, t_max);
        let transmittance = exp(-fog.optical_depth);
#ifndef VDB_GLOSSY_ONLY
        found.color += part * fog.radiance;
#endif
        part *= transmittance;
        if_nothing *= transmittance;
#ifdef VDB_EMISSION
        let is_seen = fog.optical_depth > 0.0 || any(fog.radiance > vec3(0.0));
#else
        let is_seen = fog.optical_depth > 0.0;
#endif
        if is_seen && bounce == 0u {
            found.coverage = 1.0 - transmittance * (1.0 - found.coverage);
            found.depth = select(found.depth, -1.0 - depth_at(fog.t_first), found.depth < 0.0);
            veil = Veil(fog.radiance, 1.0 - transmittance, fog.t_mean);
            // A pixel moves with what most of its light is from.
            if transmittance < 0.5 {
                found.mover = fog.mover;
                found.mover_depth = depth_at(fog.t_mean);
            }
        }
#endif
        if !surface.found {
            found.color += if_nothing;
            break;
        }
        let point = leave(segment, surface);
        let outwards = normal_of(surface);
        let to_viewer = -normalize(segment.dir);
        // Seen from within, a surface is lit from within.
        let normal = select(outwards, -outwards, dot(outwards, to_viewer) < 0.0);
        let coord = vec2<f32>(target_pixel(pixel)) + 0.5;
        let at = Lit(world_position(along(segment, surface.t)), normal, coord, segment.is_view);
        roughness = roughness_seen(surface.volume, roughness);
        var base_color = volumes[surface.volume].base_color;
#ifdef VDB_COLORS
        base_color *= color_along(segment, surface.t, surface.volume);
#endif
        let shaded = shade(surface.volume, base_color, at, point, to_viewer, roughness);
        found.color += part * shaded.light;
        if_nothing = part * shaded.mirrored;
        part *= shaded.mirror;
#ifdef VDB_REFLECTIONS
        // Less than a step of 16-bit floats beside 1.
        if bounce < view.reflections && max(max(part.x, part.y), part.z) > 1.0 / 4096.0 {
            let direction = reflected(roughness, normal, to_viewer, chance(pixel, bounce));
            segment = Segment(point, direction, false, 0.0);
            t_max = view.reflection_range;
            continue;
        }
#endif
        found.color += if_nothing;
        break;
    }
    found.color *= view.exposure;
#ifdef DISTANCE_FOG
    let own = view.exposure * veil.radiance;
    let behind = found.color - own;
    found.color = far_away(own, veil.coverage, first, veil.t, pixel);
    if seen.found {
        found.color += far_away(behind, found.coverage - veil.coverage, first, seen.t, pixel);
    }
#endif
    found.color = bordered(found.color, first, seen);
    return found;
}
#else
// What is shown of the surface that the view's ray meets.
fn look(first: Segment, pixel: vec2<u32>, t_end: f32) -> Found {
    var found = Found(vec3(0.0), 0.0, NOTHING, NONE, 0.0);
    let surface = nearest_surface(first, pixel, t_end);
    if surface.found {
        found.coverage = 1.0;
        found.depth = depth_at(surface.t);
        found.mover = surface.volume;
        found.mover_depth = found.depth;
#ifdef VDB_SHOW_NORMALS
        found.color = 0.5 + 0.5 * normal_of(surface);
#endif
#ifdef VDB_SHOW_DEPTH
        found.color = vec3(found.depth);
#endif
#ifdef VDB_SHOW_GRAY
        found.color = vec3(gray(surface));
#endif
#ifdef VDB_SHOW_AXES
        found.color = axis_shares(surface);
#endif
#ifdef VDB_SHOW_VOXELS
        found.color = voxel_color(surface);
#endif
        found.color = bordered(found.color, first, surface);
    }
#ifdef VDB_COUNT_STEPS
#ifdef VDB_FOGS
    let t_max = select(t_end, surface.t, surface.found);
    let fog = trace_fogs(first, pixel, t_max);
#endif
    if steps > 0u {
        found.color = bordered(heat(f32(steps) / view.steps_scale), first, surface);
        found.coverage = 1.0;
        found.depth = select(found.depth, -1.0 - depth_at(view.t_near), found.depth < 0.0);
    }
#endif
    return found;
}

#ifdef VDB_COUNT_STEPS
// Light blue to red.
fn heat(x: f32) -> vec3<f32> {
    return mix(vec3(0.55, 0.8, 1.0), vec3(1.0, 0.0, 0.0), saturate(x));
}
#endif
#endif

// With the borders of the tree's nodes, where the camera shows them.
fn bordered(color: vec3<f32>, segment: Segment, surface: Surface) -> vec3<f32> {
#ifdef VDB_OVERLAYS
    if surface.found {
        return overlaid(color, segment, surface);
    }
#endif
    return color;
}

// The same color with nothing infinite and no number that is none: lights may have them.
fn finite(color: vec3<f32>) -> vec3<f32> {
    let bits = bitcast<vec3<u32>>(color);
    let is_finite = (bits & vec3(0x7f800000u)) != vec3(0x7f800000u);
    let is_infinite = bits == vec3(0x7f800000u);
    let whole = select(vec3(0.0), color, is_finite);
    return clamp(select(whole, vec3(MAX_COLOR), is_infinite), vec3(0.0), vec3(MAX_COLOR));
}

// Two tiles a group: half as many groups to start.
@compute @workgroup_size(8, 16, 1)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.size) {
        return;
    }
    var ndc = ndc_of(pixel, view.size);
#ifdef VDB_ACCUMULATED
    ndc += view.shift * vec2(2.0, -2.0) / vec2<f32>(view.size);
#endif
    let first = view_segment(ndc);
    let found = look(first, pixel, min(scene_t(pixel), view.t_far));
    textureStore(out_color, pixel, vec4(finite(found.color), found.coverage));
    textureStore(out_depth, pixel, vec4(found.depth, 0.0, 0.0, 0.0));
#ifdef VDB_MOTION_VECTORS
    let mover = select(found.mover - view.volume_first, NONE, found.mover == NONE);
    textureStore(out_moving, pixel, vec4(mover, bitcast<u32>(found.mover_depth), 0u, 0u));
#endif
}
