// All fogs of a segment: what they hide, and what light they send.
#define_import_path bevy_vdb::trace::fogs

#import bevy_vdb::gpu::types::KIND_FOG
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::candidates::{end_of, next_volume, start_of}
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}
#import bevy_vdb::traversal::hdda::{FAR, box_exit, mirrored_ray, enter, enter_at}
#import bevy_vdb::view::scene::{view, volumes}
#import bevy_vdb::trace::segment::{NONE, Segment, ray_of}
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::{emitted, escaping, is_emitter}
#endif
#ifdef VDB_LIT
#import bevy_vdb::view::scene::{chance_of_frame, target_pixel}
#import bevy_vdb::trace::segment::{along, world_position}
#import bevy_vdb::trace::lights::{Lit, Surroundings, scattered, surroundings}
#import bevy_vdb::trace::scattering::{Gathered, Light, OCTAVES, gather, join, light_of}
#ifndef VDB_EVEN_LIGHT
#import bevy_vdb::traversal::hdda::local_cell
#import bevy_vdb::traversal::march::{march_of, next_stretch, seen_middle, step_of}
#import bevy_vdb::traversal::tree::nowhere
#endif
#endif

// Optical depth from which on nothing behind is visible: e^-16 is below a 16-bit float's step
// beside 1, by a factor of 4,000.
const OPAQUE: f32 = 16.0;

// Voxels along the longest edge of a fog's box from which on longer stretches are lit as one.
const LIGHT_EDGE: f32 = 128.0;
// Of what is reflected, so many times as much is lit as one: each stretch asks for the light of every lamp.
const REFLECTED: u32 = 4u;

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
fn depth_of_part(
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
    let mirrored = mirrored_ray(grid, ray);
    let thin = max(scale, 1e-30);
#ifdef VDB_FOG_STEPS
    // A part of a ray may be shorter than a step.
    var fog = 0.0;
    let step = volumes[volume].fog_step;
    if is_whole && step > 0.0 {
        fog = stepped_length(grid, mirrored, start, OPAQUE / thin, step, scale);
    } else {
        fog = optical_length(grid, mirrored, enter_at(mirrored, start), OPAQUE / thin);
    }
#else
    let fog = optical_length(grid, mirrored, enter_at(mirrored, start), OPAQUE / thin);
#endif
    // At most 100, and not by way of a product that f32 does not hold.
    return scale * min(fog, 100.0 / thin);
}

// Whether a volume dims a ray, or sends light along it.
fn is_medium(volume: u32) -> bool {
#ifdef VDB_EMISSION
    return volumes[volume].kind == KIND_FOG || is_emitter(volume);
#else
    return volumes[volume].kind == KIND_FOG;
#endif
}

// All fogs of a segment in front of `t_max`. Radiance of one fog with an even source S and optical depth τ is
// S·(1 - e^-τ), exactly; where light differs from place to place, the segment is cut into stretches, and
// where several overlap, into slabs. What shines, E in all of a slab, is taken as evenly boundary with the
// fogs there: E·(1 - e^-τ) / τ of it leaves the slab.
fn trace_fogs(segment: Segment, pixel: vec2<u32>, t_max: f32) -> Fog {
    var met = 0u;
    var last_met = 0u;
    var t_first = FAR;
    var t_last = segment.t_min;
    let end = end_of(segment);
    let begin = next_volume(segment, pixel, view.volume_first, t_max);
    for (var i = begin; i < end; i = next_volume(segment, pixel, i + 1u, t_max)) {
        if !is_medium(i) {
            continue;
        }
        let mirrored = mirrored_ray(grids[volumes[i].grid], ray_of(segment, i, t_max));
        let dda = enter(mirrored);
        if dda.inside && dda.t < t_max {
            met += 1u;
            last_met = i;
            t_first = min(t_first, dda.t);
            t_last = max(t_last, min(box_exit(mirrored), t_max));
        }
    }
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, NONE);
    if met == 0u {
        return fog;
    }
    let is_whole = met == 1u;
#ifndef VDB_EVEN_LIGHT
#ifdef VDB_LIT
    if is_whole && volumes[last_met].kind == KIND_FOG {
        return march_fog(segment, last_met, pixel, t_first, t_max);
    }
#endif
#endif
    // Within one slab, fogs are taken as evenly boundary and evenly lit.
    let shared_slabs = select(max(view.slabs / REFLECTED, 1u), view.slabs, segment.is_view);
    let slabs = select(shared_slabs, 1u, is_whole);
#ifdef VDB_LIT
    let around = surroundings(normalize(segment.dir));
    var scatters = Gathered();
#endif
    var t_sum = 0.0;
#ifdef VDB_EMISSION
    var bright = 0.0;
    var t_bright = 0.0;
#endif
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
#ifdef VDB_LIT
        var light = Light(array<vec3<f32>, OCTAVES>(), vec3(0.0), 2.0);
        var slab_scatters = Gathered();
#endif
#ifdef VDB_EMISSION
        var shining = vec3(0.0);
#endif
        for (var i = begin; i < end; i = next_volume(segment, pixel, i + 1u, t_max)) {
#ifdef VDB_EMISSION
            if is_emitter(i) && (!is_whole || i == last_met) {
                shining += emitted(segment, i, start, t_low, t_high);
            }
#endif
            if volumes[i].kind == KIND_FOG && (!is_whole || i == last_met) {
                let part = depth_of_part(segment, i, start, t_low, t_high, is_whole);
                if part > 0.0 {
                    thickest = select(thickest, i, part > thickest_part);
                    thickest_part = max(thickest_part, part);
                    depth += part;
#ifdef VDB_LIT
                    // Fogs that scatter alike share the rays to the lights.
                    if light.anisotropy != volumes[i].anisotropy {
                        let aside = fract(0.5 + chance_of_frame(0.41421356)) - 0.5;
                        let t = 0.5 * (t_low + t_high) + aside * (t_high - t_low);
                        light = light_at(segment, pixel, t, volumes[i].anisotropy, around);
                    }
                    source += part * volumes[i].emissive;
                    gather(&slab_scatters, part, volumes[i].base_color, light);
#endif
                }
            }
        }
#ifdef VDB_EMISSION
        let radiance_before = fog.radiance;
        fog.radiance += exp(-fog.optical_depth) * escaping(depth) * shining;
#endif
        if depth > 0.0 {
            let seen = exp(-fog.optical_depth) * (1.0 - exp(-depth));
            fog.radiance += seen * (source / max(depth, 1e-30));
#ifdef VDB_LIT
            join(&scatters, seen / max(depth, 1e-30), slab_scatters);
#endif
            t_sum += seen * 0.5 * (t_low + t_high);
            fog.mover = select(fog.mover, thickest, seen > most);
            most = max(most, seen);
            fog.optical_depth += depth;
        }
#ifdef VDB_EMISSION
        let added = dot(fog.radiance - radiance_before, vec3(1.0));
        bright += added;
        t_bright += added * 0.5 * (max(t_low, t_first) + min(t_high, t_last));
#endif
    }
#ifdef VDB_LIT
    fog.radiance += light_of(scatters, fog.optical_depth);
#endif
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
#ifdef VDB_EMISSION
    // Where the light is from, as what shines need not hide anything.
    fog.t_mean = select(fog.t_mean, t_bright / max(bright, 1e-30), bright > 1e-30);
#endif
    return fog;
}

#ifdef VDB_LIT
#ifndef VDB_EVEN_LIGHT
// One fog of a segment under lights that are not the same everywhere.
fn march_fog(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    var t_sum = 0.0;
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, ray_of(segment, volume, t_max));
    let enters = enter_at(mirrored, start_of(segment, volume, pixel));
    let scale = volumes[volume].density_scale * length(segment.dir);
    let most = 100.0 / max(scale, 1e-30);
    let anisotropy = volumes[volume].anisotropy;
    let around = surroundings(normalize(segment.dir));
    let step = volumes[volume].light_step * select(f32(REFLECTED), 1.0, segment.is_view);
    var scatters = Gathered();
    var march = march_of(mirrored, enters, step_of(grid, step, LIGHT_EDGE));
    march.t_box -= chance_of_frame(0.41421356) * march.t_step;
    var place = nowhere(local_cell(mirrored, enters.rel));
    while march.dda.inside && fog.optical_depth <= OPAQUE {
        let stretch = next_stretch(grid, mirrored, &march, &place, most);
        let depth = scale * min(stretch.density, most);
        if depth > 0.0 {
            let t = clamp(seen_middle(stretch, depth), stretch.t_first, t_max);
            let light = light_at(segment, pixel, t, anisotropy, around);
            let seen = exp(-fog.optical_depth) * (1.0 - exp(-depth));
            fog.radiance += seen * volumes[volume].emissive;
            gather(&scatters, seen, volumes[volume].base_color, light);
            t_sum += seen * t;
            fog.optical_depth += depth;
        }
    }
    fog.radiance += light_of(scatters, fog.optical_depth);
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}
#endif

fn light_at(segment: Segment, pixel: vec2<u32>, t: f32, anisotropy: f32, around: Surroundings) -> Light {
    let point = along(segment, t);
    let coord = vec2<f32>(target_pixel(pixel)) + 0.5;
    let at = Lit(world_position(point), vec3(0.0), coord, segment.is_view);
    let light = scattered(at, point, normalize(segment.dir), anisotropy);
    return Light(light, max(around.mean + anisotropy * around.ahead, vec3(0.0)), anisotropy);
}
#endif
