// One thread a pixel: the nearest surface of all volumes, then all fogs in front of it; and the same
// again for what the surface reflects.
// Writes radiance times exposure, premultiplied with coverage, and a depth for the composite.

#import bevy_vdb::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE}
#import bevy_vdb::rays::ndc_of
#import bevy_vdb::hdda::FAR
#import bevy_vdb::scene::{scene_end, seen_end, view, volumes}
#import bevy_vdb::segment::{NONE, Segment, along, ray_of, view_segment, world_position}
#import bevy_vdb::surface::{Surface, leave, nearer, no_surface, normal_of}
#ifdef SURFACES
#import bevy_vdb::surface::meet_voxels
#endif
#ifdef SMOOTH
#import bevy_vdb::surface::meet_smooth
#endif
#ifdef FOGS
#import bevy_vdb::bindings::grids
#import bevy_vdb::fog::{optical_length, stepped_length}
#import bevy_vdb::hdda::{course_of, enter, enter_at, plane_t}
#ifndef EVEN_LIGHT
#ifdef LIT
#import bevy_vdb::hdda::local_cell
#import bevy_vdb::march::{march_of, next_stretch, seen_middle, step_of}
#import bevy_vdb::tree::nowhere
#endif
#endif
#endif
#ifdef LIT
#ifdef DISTANCE_FOG
#import bevy_vdb::lights::through_distance_fog
#endif
#import bevy_vdb::lights::{Lit, Surroundings, reflected, roughness_seen, scattered, shade, surroundings}
#else
#import bevy_vdb::show::{axis_shares, gray, voxel_color}
#endif
#ifdef OVERLAYS
#import bevy_vdb::show::overlaid
#endif
#ifdef COUNT_STEPS
#import bevy_vdb::hdda::steps
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

#ifdef MOTION_VECTORS
// The volume that a pixel moves with, in the view's list, or NONE; and the bits of the depth of the
// place that moves.
@group(2) @binding(10) var out_moving: texture_storage_2d<rg32uint, write>;
#endif

// Optical depth from which on nothing behind is visible: e^-16 is below a 16-bit float's step
// beside 1, by a factor of 4,000.
const OPAQUE: f32 = 16.0;

// Voxels along a ray for which a fog is lit as one, at least, and into how many such stretches the longest
// edge of its box is cut, at most.
const LIGHT_STEP: f32 = 2.0;
const LIGHT_STEPS: f32 = 64.0;
// The same of what is reflected.
const LIGHT_STEP_REFLECTED: f32 = 8.0;
const LIGHT_STEPS_REFLECTED: f32 = 16.0;
// The part of a ray that overlapping fogs share is cut into this many slabs; within one, they are taken as
// evenly mixed and evenly lit.
const SLABS: u32 = 32u;
// What is reflected, into fewer: each slab asks for the light of every lamp.
const SLABS_REFLECTED: u32 = 8u;

// What a 16-bit float can hold.
const MAX_COLOR: f32 = 65000.0;

// The t of whatever opaque meshes show at a pixel; with several samples the farthest, because the
// composite tests each sample's own depth again.
fn scene_t(pixel: vec2<u32>) -> f32 {
    let at = pixel + view.origin;
#ifdef MULTISAMPLED
    var depth = 1.0;
    for (var i = 0u; i < textureNumSamples(scene_depth); i++) {
        depth = min(depth, textureLoad(scene_depth, at, i32(i)));
    }
#else
    let depth = textureLoad(scene_depth, at, 0);
#endif
    let m = view.t_from_depth;
    let w = m.z * depth + m.w;
    return select(-(m.x * depth + m.y) / w, FAR, abs(w) < 1e-30);
}

#ifdef BEAMS
// For each tile of 8×8 pixels, a bit for each volume, or group of volumes, of the view that can stop a ray
// of the tile; then, if they are kept, for each volume and tile the t before which nothing can.
@group(2) @binding(9) var<storage, read> tiles: array<u32>;

fn tile_of(pixel: vec2<u32>) -> u32 {
    return pixel.y / 8u * ((view.size.x + 7u) / 8u) + pixel.x / 8u;
}
#endif

// The first volume from `i` on that a segment may meet; past the last one, if there is none.
fn next_volume(segment: Segment, pixel: vec2<u32>, i: u32) -> u32 {
#ifdef BEAMS
    // Other rays, and volumes that the view does not see, have no beams.
    if segment.is_view && i < seen_end() {
        let words = tile_of(pixel) * view.tile_words;
        let bit = (i - view.volume_first) >> view.group_bits;
        var word = bit >> 5u;
        var bits = tiles[words + word] & (0xffffffffu << (bit & 31u));
        while bits == 0u && word + 1u < view.tile_words {
            word++;
            bits = tiles[words + word];
        }
        let next = view.volume_first + ((32u * word + firstTrailingBit(bits)) << view.group_bits);
        return select(max(i, next), seen_end(), bits == 0u);
    }
#endif
    return i;
}

// The t before which nothing of a volume can stop a ray.
fn start_of(segment: Segment, volume: u32, pixel: vec2<u32>) -> f32 {
#ifdef BEAMS
    if segment.is_view && view.keeps_starts != 0u {
        let size = (view.size + 7u) / 8u;
        let starts = size.x * size.y * (view.tile_words + volume - view.volume_first);
        return bitcast<f32>(tiles[starts + tile_of(pixel)]);
    }
#endif
    return segment.t_min;
}

// One past the volumes that a segment can meet.
fn end_of(segment: Segment) -> u32 {
    return select(scene_end(), seen_end(), segment.is_view);
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
    var i = next_volume(segment, pixel, view.volume_first);
    for (; i < end; i = next_volume(segment, pixel, i + 1u)) {
        let start = start_of(segment, i, pixel);
        if volumes[i].kind == KIND_FOG || start >= t_end {
            continue;
        }
        let ray = ray_of(segment, i, t_end);
#ifdef SURFACES
        if volumes[i].kind == KIND_SURFACE {
            nearest = nearer(nearest, meet_voxels(i, ray, start));
        }
#endif
#ifdef SMOOTH
        if volumes[i].kind == KIND_SMOOTH {
            nearest = nearer(nearest, meet_smooth(i, ray, start));
        }
#endif
        t_end = select(t_end, nearest.t, nearest.found);
    }
    return nearest;
}

#ifdef FOGS
struct Fog {
    radiance: vec3<f32>,
    optical_depth: f32,
    t_first: f32,
    // The mean t of what is seen of the fogs, weighed with how much of it is seen, and the volume
    // that most of it is of, where slabs are.
    t_mean: f32,
    mover: u32,
}

// Optical depth of one fog over a part of a segment, which nothing stops before `start`.
fn optical_depth(
    segment: Segment,
    volume: u32,
    start: f32,
    t_min: f32,
    t_max: f32,
    is_whole: bool,
) -> f32 {
    let scale = volumes[volume].density_scale * length(segment.dir);
    var ray = ray_of(segment, volume, t_max);
    ray.t_min = t_min;
    let grid = grids[volumes[volume].grid];
    let course = course_of(grid, ray);
    let thin = max(scale, 1e-30);
#ifdef FOG_STEPS
    // A part of a ray may be shorter than a step.
    var fog = 0.0;
    if is_whole {
        fog = stepped_length(grid, course, start, OPAQUE / thin, view.fog_step);
    } else {
        fog = optical_length(grid, course, enter_at(course, start), OPAQUE / thin);
    }
#else
    let fog = optical_length(grid, course, enter_at(course, start), OPAQUE / thin);
#endif
    // At most 100, and not by way of a product that f32 does not hold.
    return scale * min(fog, 100.0 / thin);
}

// All fogs of a segment in front of `t_max`. Radiance of one fog with an even source S and optical depth
// τ is S·(1 - e^-τ), exactly; where light differs from place to place, the segment is cut into stretches,
// and where several overlap, into slabs.
fn trace_fogs(segment: Segment, pixel: vec2<u32>, t_max: f32) -> Fog {
    var met = 0u;
    var last_met = 0u;
    var t_first = FAR;
    var t_last = segment.t_min;
    let end = end_of(segment);
    let begin = next_volume(segment, pixel, view.volume_first);
    for (var i = begin; i < end; i = next_volume(segment, pixel, i + 1u)) {
        if volumes[i].kind != KIND_FOG {
            continue;
        }
        let course = course_of(grids[volumes[i].grid], ray_of(segment, i, t_max));
        let walk = enter(course);
        if walk.inside && walk.t < t_max {
            met += 1u;
            last_met = i;
            let exits = plane_t(course, course.last + 1u);
            t_first = min(t_first, walk.t);
            t_last = max(t_last, min(min(min(exits.x, exits.y), exits.z), t_max));
        }
    }
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, NONE);
    if met == 0u {
        return fog;
    }
    let is_whole = met == 1u;
#ifndef EVEN_LIGHT
#ifdef LIT
    if is_whole {
        return march_fog(segment, last_met, pixel, t_first, t_max);
    }
#endif
#endif
    let slabs = select(select(SLABS_REFLECTED, SLABS, segment.is_view), 1u, is_whole);
#ifdef LIT
    let around = surroundings(normalize(segment.dir));
#endif
    var t_sum = 0.0;
    var most = 0.0;
    for (var slab = 0u; slab < slabs && fog.optical_depth <= OPAQUE; slab++) {
        var t_low = mix(t_first, t_last, f32(slab) / f32(slabs));
        var t_high = mix(t_first, t_last, f32(slab + 1u) / f32(slabs));
        var start = t_low;
        if is_whole {
            t_low = segment.t_min;
            t_high = t_max;
            start = start_of(segment, last_met, pixel);
        }
        var depth = 0.0;
        var thickest = NONE;
        var thickest_part = 0.0;
        var source = vec3(0.0);
#ifdef LIT
        var light = Light(vec3(0.0), 2.0);
#endif
        for (var i = begin; i < end; i = next_volume(segment, pixel, i + 1u)) {
            if volumes[i].kind == KIND_FOG && (!is_whole || i == last_met) {
                let part = optical_depth(segment, i, start, t_low, t_high, is_whole);
                if part > 0.0 {
                    thickest = select(thickest, i, part > thickest_part);
                    thickest_part = max(thickest_part, part);
                    depth += part;
#ifdef LIT
                    // Fogs that scatter alike share the rays to the lights.
                    if light.anisotropy != volumes[i].anisotropy {
                        let t = 0.5 * (t_low + t_high);
                        light = light_at(segment, pixel, t, volumes[i].anisotropy, around);
                    }
                    source += part * (volumes[i].emissive + volumes[i].base_color * light.luminance);
#endif
                }
            }
        }
        if depth > 0.0 {
            source /= max(depth, 1e-30);
            let seen = exp(-fog.optical_depth) * (1.0 - exp(-depth));
            fog.radiance += seen * source;
            t_sum += seen * 0.5 * (t_low + t_high);
            fog.mover = select(fog.mover, thickest, seen > most);
            most = max(most, seen);
            fog.optical_depth += depth;
        }
    }
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}

#ifdef LIT
#ifndef EVEN_LIGHT
// One fog of a segment under lights that are not the same everywhere.
fn march_fog(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    var t_sum = 0.0;
    let grid = grids[volumes[volume].grid];
    let course = course_of(grid, ray_of(segment, volume, t_max));
    let enters = enter_at(course, start_of(segment, volume, pixel));
    let scale = volumes[volume].density_scale * length(segment.dir);
    let most = 100.0 / max(scale, 1e-30);
    let anisotropy = volumes[volume].anisotropy;
    let around = surroundings(normalize(segment.dir));
    let least = select(LIGHT_STEP_REFLECTED, LIGHT_STEP, segment.is_view);
    let steps = select(LIGHT_STEPS_REFLECTED, LIGHT_STEPS, segment.is_view);
    var march = march_of(course, enters, step_of(grid, least, steps));
    var place = nowhere(local_cell(course, enters.rel));
    while march.walk.inside && fog.optical_depth <= OPAQUE {
        let stretch = next_stretch(grid, course, &march, &place, most);
        let depth = scale * min(stretch.density, most);
        if depth > 0.0 {
            let t = clamp(seen_middle(stretch, depth), stretch.t_first, t_max);
            let light = light_at(segment, pixel, t, anisotropy, around).luminance;
            let source = volumes[volume].emissive + volumes[volume].base_color * light;
            let seen = exp(-fog.optical_depth) * (1.0 - exp(-depth));
            fog.radiance += seen * source;
            t_sum += seen * t;
            fog.optical_depth += depth;
        }
    }
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}
#endif

// What fog of albedo 1 scatters back along a segment, cd/m².
struct Light {
    luminance: vec3<f32>,
    anisotropy: f32,        // of that fog
}

fn light_at(segment: Segment, pixel: vec2<u32>, t: f32, anisotropy: f32, around: Surroundings) -> Light {
    let point = along(segment, t);
    let coord = vec2<f32>(pixel + view.origin) + 0.5;
    let at = Lit(world_position(point), vec3(0.0), coord, segment.is_view);
    let light = scattered(at, point, normalize(segment.dir), anisotropy);
    return Light(light + max(around.mean + anisotropy * around.ahead, vec3(0.0)), anisotropy);
}
#endif
#endif

// What the view's ray finds.
struct Found {
    color: vec3<f32>,       // luminance, or what is shown instead
    coverage: f32,
    depth: f32,
    mover: u32,             // the volume that it moves with, or NONE
    mover_depth: f32,
}

#ifdef LIT
#ifdef REFLECTIONS
// Two numbers from 0 up to but not 1, of a pixel's own, that neighbours share evenly among them: the
// fractional parts of multiples of the plastic number's powers, as Martin Roberts has it, on a noise of
// Jorge Jimenez's.
fn chance(pixel: vec2<u32>, bounce: u32) -> vec2<f32> {
    let at = vec2<f32>(pixel) + 5.588238 * f32(bounce);
    let noise = fract(52.9829189 * fract(dot(at, vec2(0.06711056, 0.00583715))));
    return fract(noise + vec2(0.7548776662, 0.5698402910) * f32(bounce + 1u));
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
    let coord = vec2<f32>(pixel + view.origin) + 0.5;
    let at = Lit(world_position(along(segment, t)), vec3(0.0), coord, true);
    return through_distance_fog(color, coverage, at);
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
#ifdef FOGS
        let fog = trace_fogs(segment, pixel, t_max);
        let transmittance = exp(-fog.optical_depth);
#ifndef GLOSSY_ONLY
        found.color += part * fog.radiance;
#endif
        part *= transmittance;
        if_nothing *= transmittance;
        if fog.optical_depth > 0.0 && bounce == 0u {
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
        let coord = vec2<f32>(pixel + view.origin) + 0.5;
        let at = Lit(world_position(along(segment, surface.t)), normal, coord, segment.is_view);
        roughness = roughness_seen(surface.volume, roughness);
        let shaded = shade(surface.volume, at, point, to_viewer, roughness);
        found.color += part * shaded.light;
        if_nothing = part * shaded.mirrored;
        part *= shaded.mirror;
#ifdef REFLECTIONS
        // Less than a step of 16-bit floats beside 1.
        if bounce < view.reflections && max(max(part.x, part.y), part.z) > 1.0 / 4096.0 {
            let direction = reflected(roughness, normal, to_viewer, chance(pixel, bounce));
            segment = Segment(point, direction, false, 0.0);
            t_max = FAR;
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
#ifdef SHOW_NORMALS
        found.color = 0.5 + 0.5 * normal_of(surface);
#endif
#ifdef SHOW_DEPTH
        found.color = vec3(found.depth);
#endif
#ifdef SHOW_GRAY
        found.color = vec3(gray(surface));
#endif
#ifdef SHOW_AXES
        found.color = axis_shares(surface);
#endif
#ifdef SHOW_VOXELS
        found.color = voxel_color(surface);
#endif
        found.color = bordered(found.color, first, surface);
    }
#ifdef COUNT_STEPS
#ifdef FOGS
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

#ifdef COUNT_STEPS
// Light blue to red.
fn heat(x: f32) -> vec3<f32> {
    return mix(vec3(0.55, 0.8, 1.0), vec3(1.0, 0.0, 0.0), saturate(x));
}
#endif
#endif

// With the borders of the tree's nodes, where the camera shows them.
fn bordered(color: vec3<f32>, segment: Segment, surface: Surface) -> vec3<f32> {
#ifdef OVERLAYS
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

@compute @workgroup_size(8, 8, 1)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.size) {
        return;
    }
    let first = view_segment(ndc_of(pixel, view.size));
    let found = look(first, pixel, min(scene_t(pixel), view.t_far));
    textureStore(out_color, pixel, vec4(finite(found.color), found.coverage));
    textureStore(out_depth, pixel, vec4(found.depth, 0.0, 0.0, 0.0));
#ifdef MOTION_VECTORS
    let mover = select(found.mover - view.volume_first, NONE, found.mover == NONE);
    textureStore(out_moving, pixel, vec4(mover, bitcast<u32>(found.mover_depth), 0u, 0u));
#endif
}
