// All fogs and emission grids along a segment, marched together, with light from the light cache.
//
// The media share their steps. Within a step, every fog is homogeneous, with the density and the light in the
// middle of the step, and emission has its mean over a few samples. The integral of transmittance then has a
// closed form, so overlap adds no error.
#define_import_path bevy_vdb::trace::media

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::fog_march::{Fog, MIN_STEP, light_interval}
#ifdef VDB_VARYING_ALBEDO
#import bevy_vdb::trace::color::albedo_along
#import bevy_vdb::trace::scattering::add_varied_sample
#endif
#ifdef VDB_RAMPS
#import bevy_vdb::trace::ramp_light::{RampSums, add_stretch, visible_albedo}
#import bevy_vdb::view::scene::fog_grid
#endif
#import bevy_vdb::trace::light_cache::{cached_sun_depth, lattice_point}
#import bevy_vdb::trace::medium::{HAS_MANY_MEDIA, MAX_FOGS, Medium, MetMedia, begun, first_step}
#import bevy_vdb::trace::medium::{new_medium, no_medium, suitable_step}
#import bevy_vdb::trace::scattering::{OCTAVES, OPAQUE_DEPTH, ScatteringSums, add_sample, mean_transmittance}
#import bevy_vdb::trace::scattering::{octave_weights, octaves_of_depth, scattered_radiance}
#import bevy_vdb::trace::scattering::visibility_between
#import bevy_vdb::trace::segment::{NONE, Segment}
#import bevy_vdb::trace::shared_light::{SUN_COUNT, SUN_SLOTS, CachedLight, FogPoint, SharedLight}
#import bevy_vdb::trace::shared_light::{begin_interval, begin_light, mean_light}
#import bevy_vdb::traversal::fog::{next_index, point_in_box, sample_fog, step_length, stride_at}
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::{view, volumes}
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::trace::light_cache::{NOT_CACHED, cached_lamp_light, lamp_light_lattice}
#import bevy_vdb::trace::lights::range_near_lamps
#import bevy_vdb::trace::segment::{point_at, world_position}
#endif
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::{EmissionStep, max3, sampled_emission}
#import bevy_vdb::trace::medium::{EMISSION_STEP, MAX_EMITTERS}
#import bevy_vdb::traversal::fog::probe_fog
#endif

#ifdef VDB_RAMPS
// Voxels of a step through a fog with a ramp, at most.
const RAMP_STEP: f32 = 1.0;
#endif

// Sums over the steps of one fog in an interval.
struct FogSums {
    weights: array<f32, OCTAVES>,   // of the steps
#ifdef VDB_VARYING_ALBEDO
    scattered: array<vec3<f32>, OCTAVES>,   // weighted sums of the albedo
#endif
    t: f32,                         // weighted sum
    light: CachedLight,             // weighted sum
}

// Sums over an interval. Everything but how much fog lets through of cached suns is evaluated once per
// interval.
struct IntervalSums {
    width: f32,     // in t
    weight: f32,
    t: f32,
    fogs: array<FogSums, MAX_FOGS>,
}

// Sums over a segment.
struct SegmentSums {
    weight: f32,
    t: f32,
    scattering: ScatteringSums,
    fogs: array<f32, MAX_FOGS>,     // weights
}

// Meshes or surfaces may stand between fog and its lights.
#ifdef VDB_MESH_CASTERS
const HAS_OCCLUDERS: bool = true;
#else ifdef VDB_SURFACES
const HAS_OCCLUDERS: bool = true;
#else ifdef VDB_SMOOTH
const HAS_OCCLUDERS: bool = true;
#else
const HAS_OCCLUDERS: bool = false;
#endif
#ifdef VDB_OTHER_LIGHTS
const HAS_OTHER_LIGHTS: bool = true;
#else ifdef VDB_CACHED_LAMPS
const HAS_OTHER_LIGHTS: bool = true;
#else
const HAS_OTHER_LIGHTS: bool = false;
#endif
// If false, light varies along a ray only through the cache of suns, which is read at every step.
const HAS_INTERVALS: bool = HAS_OCCLUDERS || HAS_OTHER_LIGHTS;
// Intervals are at most this fraction of the distance to a lamp.
const LAMP_INTERVAL: f32 = 0.25;
// The shortest interval near lamps, as a fraction of the longest.
const MIN_INTERVAL: f32 = 0.015625;
// The longest interval in samples of the cache: other lights are assumed to vary as smoothly as its depths.
const SAMPLES_OF_INTERVAL: f32 = 2.5;

fn next_multiple(t: f32, factor: f32) -> f32 {
    return (floor(t / factor) + 1.0) * factor;
}

// The longest interval of a fog in dense parts, in voxels.
fn interval_voxels(segment: Segment, volume: u32) -> f32 {
    var voxels = FAR;
    if HAS_OTHER_LIGHTS {
        voxels = SAMPLES_OF_INTERVAL * exp2(f32(volumes[volume].light_log));
    }
    if HAS_OCCLUDERS {
        voxels = min(voxels, light_interval(segment, volume));
    }
    return voxels;
}

// Adds an interval to the sums of its segment, with the light at the mean position of what is visible. Every
// t of the media and the sums is relative to `t_zero`.
fn add_interval(
    segment: Segment,
    pixel: vec2<u32>,
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    t_zero: f32,
    t_max: f32,
    shared_light: ptr<function, SharedLight>,
    interval: ptr<function, IntervalSums>,
    is_near_lamps: bool,
    sums: ptr<function, SegmentSums>,
) {
    let t_mean = (*interval).t / (*interval).weight;
    begin_interval(shared_light, segment, pixel, min(t_zero + t_mean, t_max));
    var scattering = (*sums).scattering;
    for (var i = 0u; i < MAX_FOGS; i++) {
        let own = (*interval).fogs[i];
        if own.weights[0] > 0.0 {
            let volume = (*fogs)[i].volume;
            let t = own.t / own.weights[0];
            let grid = grids[volumes[volume].grid];
            let place = point_in_box(grid, (*fogs)[i].ray, t - (*fogs)[i].ray.t_origin);
            let extent = (*interval).width * length(segment.dir);
            let at = FogPoint(volume, place, min(t_zero + t, t_max), extent, is_near_lamps);
#ifdef VDB_VARYING_ALBEDO
            let light = mean_light(shared_light, segment, pixel, at, own.light, own.scattered);
            add_varied_sample(&scattering, own.weights[0], own.scattered, light);
#else
            let light = mean_light(shared_light, segment, pixel, at, own.light, own.weights);
            add_sample(&scattering, own.weights, volumes[volume].base_color, light);
#endif
            (*sums).fogs[i] += own.weights[0];
        }
    }
    (*sums).scattering = scattering;
    (*sums).weight += (*interval).weight;
    (*sums).t += (*interval).t;
    *interval = IntervalSums();
}

#ifdef VDB_LAMP_LIGHT
// Between which t, relative to `t_zero`, some of the lamps' light has to be evaluated in intervals.
fn near_lamps(
    segment: Segment,
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    t_zero: f32,
) -> vec2<f32> {
    let dir_length = length(segment.dir);
    let origin = world_position(point_at(segment, t_zero));
    var near = vec2(FAR, -FAR);
    for (var i = 0u; i < MAX_FOGS; i++) {
        if i < fog_count {
            let range = range_near_lamps(origin, segment.dir / dir_length, (*fogs)[i].volume);
            near = vec2(min(near.x, range.x / dir_length), max(near.y, range.y / dir_length));
        }
    }
#ifdef VDB_OTHER_LIGHTS
    return vec2(-FAR, FAR);
#else
    return near;
#endif
}

// Where the next interval ends, given where it would end if lamps were near everywhere, and where it begins.
fn flush_near_lamps(t_flush: f32, t_begin: f32, near: vec2<f32>) -> f32 {
    return select(max(t_flush, near.x), FAR, t_begin >= near.y);
}
#endif

// Radiance and optical depth of the media along a segment up to `t_max`: of at least one fog. The nearest
// medium begins at `t_first`.
fn march_media(segment: Segment, pixel: vec2<u32>, met: MetMedia, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, NONE);
    // Variables, so that they can be indexed dynamically.
    var list = met.fogs;
    // Loops have a constant length, so that arrays stay in registers.
    var fogs = array<Medium, MAX_FOGS>();
    let fog_count = min(met.fog_count, MAX_FOGS);
    var t_base = FAR;
    var t_last = 0.0;
    var t_interval = FAR;
    for (var i = 0u; i < MAX_FOGS; i++) {
        fogs[i] = no_medium();
        if i < fog_count {
            var step = max(volumes[list[i]].fog_step, MIN_STEP);
#ifdef VDB_RAMPS
            step = select(step, min(step, RAMP_STEP), volumes[list[i]].ramp != 0u);
#endif
            fogs[i] = new_medium(segment, list[i], step, t_max);
            t_base = min(t_base, fogs[i].t_step);
            t_last = max(t_last, fogs[i].ray.t_origin + fogs[i].ray.t_last);
            if HAS_INTERVALS {
                let voxels = interval_voxels(segment, list[i]);
                t_interval = min(t_interval, voxels / max(length(fogs[i].ray.dir), 1e-30));
            }
        }
    }
#ifdef VDB_EMISSION
    var emitter_list = met.emitters;
    var emitters = array<Medium, MAX_EMITTERS>();
    let emitter_count = min(met.emitter_count, MAX_EMITTERS);
    for (var i = 0u; i < MAX_EMITTERS; i++) {
        emitters[i] = no_medium();
        if i < emitter_count {
            emitters[i] = new_medium(segment, emitter_list[i], EMISSION_STEP, t_max);
            t_base = min(t_base, emitters[i].t_step);
            t_last = max(t_last, emitters[i].ray.t_origin + emitters[i].ray.t_last);
        }
    }
#endif
    // The shortest step; all begin at its multiples from the segment's origin, so that neighbouring rays
    // sample neighbouring points.
    t_base = step_length(t_base, t_last - t_first);
    let inverse_base = 1.0 / t_base;
    let t_zero = floor(t_first * inverse_base) * t_base;
    var t_near = FAR;   // of what comes next
    var t_end = 0.0;
    for (var i = 0u; i < MAX_FOGS; i++) {
        if i < fog_count {
            fogs[i] = begun(fogs[i], segment, pixel, t_zero);
            t_near = min(t_near, fogs[i].t_next);
            t_end = max(t_end, fogs[i].t_last);
        }
    }
#ifdef VDB_EMISSION
    for (var i = 0u; i < MAX_EMITTERS; i++) {
        if i < emitter_count {
            emitters[i] = begun(emitters[i], segment, pixel, t_zero);
            t_near = min(t_near, emitters[i].t_next);
            t_end = max(t_end, emitters[i].t_last);
        }
    }
#endif
    let dir_length = length(segment.dir);
    var shared_light = begin_light(normalize(segment.dir));
    var sums = SegmentSums();
    var interval = IntervalSums();
    // Starts short, because a lamp may be near.
    var t_flush = next_multiple(t_zero + t_near, 0.25 * t_interval) - t_zero;
#ifdef VDB_LAMP_LIGHT
    let near = near_lamps(segment, &fogs, fog_count, t_zero);
    t_flush = flush_near_lamps(t_flush, t_near, near);
    var t_interval_begin = t_near;
    var lamp_lattices = array<u32, MAX_FOGS>();
    for (var i = 0u; i < MAX_FOGS; i++) {
        lamp_lattices[i] = lamp_light_lattice(fogs[i].volume);
    }
    // Of lamps, times the exposure: light in each octave.
    var lamp_light = array<vec3<f32>, OCTAVES>();
#endif
#ifdef VDB_EMITS
    var radiance_sum = 0.0;
    var t_radiance_sum = 0.0;
#endif
    var is_near_lamps = true;
    var transmittance = 1.0;
    let t_start = t_first - t_zero;
    var k = first_step(min(t_near, t_end) * inverse_base);
    var is_done = t_near >= t_end;
    // Ends by its condition only: llvmpipe drops invocations of a group whose neighbours leave nested loops
    // by `break` or `continue`.
    while !is_done {
        let t_low = max(k * t_base, t_start);
        var stride = stride_at(fog.optical_depth);
        if HAS_MANY_MEDIA {
            // The longest step that suits the media here and those that begin within it.
            var t_step = FAR;
            for (var i = 0u; i < MAX_FOGS; i++) {
                t_step = min(t_step, suitable_step(fogs[i], t_low, t_end, t_base, inverse_base));
            }
#ifdef VDB_EMISSION
            for (var i = 0u; i < MAX_EMITTERS; i++) {
                t_step = min(t_step, suitable_step(emitters[i], t_low, t_end, t_base, inverse_base));
            }
#endif
            stride *= max(t_step * inverse_base, 1.0);
        }
        let t_high = min((k + stride) * t_base, t_end);
        let width = max(t_high - t_low, 0.0);
        let t_middle = t_low + 0.5 * width;
        var is_empty = true;
        var extinction = 0.0;
        var extinctions = array<f32, MAX_FOGS>();
#ifdef VDB_LAMP_LIGHT
        var points = array<vec3<f32>, MAX_FOGS>();
#endif
        var depths = array<array<f32, SUN_SLOTS>, MAX_FOGS>();
#ifdef VDB_RAMPS
        // Mean albedo in the step, and emission per world unit.
        var ramp_albedos = array<vec3<f32>, MAX_FOGS>();
        var ramp_emissions = array<vec3<f32>, MAX_FOGS>();
#endif
        for (var i = 0u; i < MAX_FOGS; i++) {
            if fogs[i].t_next <= t_middle {
                let volume = fogs[i].volume;
                let t_origin = fogs[i].ray.t_origin;
                let grid = grids[volumes[volume].grid];
                var accessor = fogs[i].accessor;
                let found = sample_fog(grid, fogs[i].ray, &accessor, t_middle - t_origin);
                fogs[i].accessor = accessor;
                let is_inside = t_middle < fogs[i].t_last;
                let t_next = select(t_middle, t_origin + found.t_out, found.is_empty);
                fogs[i].t_next = select(FAR, t_next, is_inside);
                if !found.is_empty && is_inside {
                    is_empty = false;
                    var density = found.density;
#ifdef VDB_RAMPS
                    ramp_albedos[i] = vec3(1.0);
                    if volumes[volume].ramp != 0u {
                        // Values are sampled at both ends, too, so that no shell between them is missed.
                        let low = max(t_low, fogs[i].ray.t_origin + fogs[i].ray.t_first) - t_origin;
                        let high = min(t_high, fogs[i].t_last) - t_origin;
                        let near = sample_fog(grid, fogs[i].ray, &accessor, low);
                        let far = sample_fog(grid, fogs[i].ray, &accessor, high);
                        fogs[i].accessor = accessor;
                        let values = vec3(near.density, found.density, far.density);
                        // Where all values are 0 there is nothing, whatever the ramp says.
                        let length = select(0.0, high - low, any(values > vec3(0.0)));
                        let optical_length = length * fogs[i].extinction;
                        let emission_length = length * dir_length * volumes[volume].ramp_emission;
                        var own = RampSums();
                        add_stretch(&own, fog_grid(volume), values, optical_length, emission_length);
                        density = own.optical_depth / max(width * fogs[i].extinction, 1e-30);
                        ramp_albedos[i] = visible_albedo(own);
                        let visible_length = max(mean_transmittance(own.optical_depth) * width * dir_length, 1e-30);
                        ramp_emissions[i] = own.emitted / visible_length;
                    }
#endif
                    extinctions[i] = fogs[i].extinction * min(density, fogs[i].max_density);
                    extinction += extinctions[i];
                    let point = lattice_point(volume, found.point.cell, found.point.u);
#ifdef VDB_LAMP_LIGHT
                    points[i] = point;
#endif
                    for (var slot = 0u; slot < SUN_COUNT; slot++) {
                        depths[i][slot] = cached_sun_depth(point, volume, slot);
                    }
                }
            }
        }
        let depth = extinction * width;
        let visible_width = transmittance * mean_transmittance(depth) * width;
        let transmittance_after = transmittance * exp(-depth);
        let visible = visibility_between(transmittance, transmittance_after);
        t_near = FAR;
        for (var i = 0u; i < MAX_FOGS; i++) {
            let weight = extinctions[i] * visible_width;
#ifdef VDB_VARYING_ALBEDO
            var albedo = vec3(0.0);
            if weight > 0.0 {
                albedo = albedo_along(segment, t_zero + t_middle, fogs[i].volume);
            }
#endif
#ifdef VDB_RAMPS
            albedo *= ramp_albedos[i];
            let glow = visible_width * dir_length * ramp_emissions[i];
            fog.radiance += glow;
            radiance_sum += dot(glow, vec3(1.0));
            t_radiance_sum += dot(glow, vec3(1.0)) * t_middle;
#endif
            if weight > 0.0 {
                interval.fogs[i].t += weight * t_middle;
                let anisotropy = volumes[fogs[i].volume].anisotropy;
                var weights = octave_weights(weight, visible, anisotropy);
                for (var octave = 0u; octave < OCTAVES; octave++) {
                    interval.fogs[i].weights[octave] += weights[octave];
                }
#ifdef VDB_VARYING_ALBEDO
                for (var octave = 0u; octave < OCTAVES; octave++) {
                    interval.fogs[i].scattered[octave] += weights[octave] * albedo;
                }
#endif
                for (var slot = 0u; slot < SUN_COUNT; slot++) {
                    var arriving = octaves_of_depth(depths[i][slot], anisotropy);
                    for (var octave = 0u; octave < OCTAVES; octave++) {
#ifdef VDB_VARYING_ALBEDO
                        let let_through = weights[octave] * arriving[octave] * albedo;
#else
                        let let_through = weights[octave] * arriving[octave];
#endif
                        interval.fogs[i].light.slots[slot][octave] += let_through;
                    }
                }
            }
#ifdef VDB_LAMP_LIGHT
            if weight > 0.0 && lamp_lattices[i] != NOT_CACHED {
                let volume = fogs[i].volume;
                let anisotropy = volumes[volume].anisotropy;
                var weights = octave_weights(weight, visible, anisotropy);
#ifndef VDB_VARYING_ALBEDO
                let albedo = volumes[volume].base_color;
#endif
                for (var octave = 0u; octave < OCTAVES; octave++) {
                    let light = cached_lamp_light(points[i], lamp_lattices[i], volume, octave);
                    lamp_light[octave] += weights[octave] * albedo * light;
                }
            }
#endif
            t_near = min(t_near, fogs[i].t_next);
        }
#ifdef VDB_EMISSION
        for (var i = 0u; i < MAX_EMITTERS; i++) {
            if emitters[i].t_next < t_high {
                is_empty = false;
                let volume = emitters[i].volume;
                let grid = grids[volumes[volume].grid];
                let t_origin = emitters[i].ray.t_origin;
                var accessor = emitters[i].accessor;
                let visible_length = visible_width * dir_length;
                let step = EmissionStep(
                    t_low - t_origin,
                    t_high - t_origin,
                    view.exposure * visible_length,
                    view.exposure * max3(fog.radiance),
                );
                let added = visible_length * sampled_emission(volume, grid, emitters[i].ray, &accessor, step);
                fog.radiance += added;
                radiance_sum += dot(added, vec3(1.0));
                t_radiance_sum += dot(added, vec3(1.0)) * t_middle;
                let probe = probe_fog(grid, emitters[i].ray, &accessor, t_high - t_origin);
                emitters[i].accessor = accessor;
                let t_next = select(t_high, max(t_origin + probe.t_out, t_high), probe.is_empty);
                emitters[i].t_next = select(FAR, t_next, t_high < emitters[i].t_last);
            }
            t_near = min(t_near, emitters[i].t_next);
        }
#endif
        let k_near = max(k + 1.0, first_step(min(t_near, t_end) * inverse_base));
        k = next_index(k, select(k + stride, k_near, is_empty));
        let weight = extinction * visible_width;
        interval.width += select(0.0, width, weight > 0.0);
        interval.weight += weight;
        interval.t += weight * t_middle;
        fog.optical_depth += depth;
        transmittance = transmittance_after;
        is_done = k * t_base >= t_end || t_near >= t_end || fog.optical_depth > OPAQUE_DEPTH;
        if HAS_INTERVALS && t_high >= t_flush && interval.weight > 0.0 && !is_done {
#ifdef VDB_LAMP_LIGHT
            is_near_lamps = near.x < t_high && near.y > t_interval_begin;
            t_interval_begin = t_high;
#endif
            add_interval(segment, pixel, &fogs, t_zero, t_max, &shared_light, &interval, is_near_lamps, &sums);
            // Ends at multiples of a length, so that neighbouring rays evaluate light at the same time, and
            // grows like the steps.
            let longest = LAMP_INTERVAL * shared_light.nearest / (dir_length * t_interval);
            let part = max(min(stride_at(fog.optical_depth), longest), MIN_INTERVAL);
            let t_part = t_interval * exp2(floor(log2(part)));
            t_flush = next_multiple(t_zero + max(t_high, t_near), t_part) - t_zero;
#ifdef VDB_LAMP_LIGHT
            t_flush = flush_near_lamps(t_flush, t_high, near);
#endif
        }
    }
    if interval.weight > 0.0 {
#ifdef VDB_LAMP_LIGHT
        is_near_lamps = near.x < t_end && near.y > t_interval_begin;
#endif
        add_interval(segment, pixel, &fogs, t_zero, t_max, &shared_light, &interval, is_near_lamps, &sums);
    }
#ifdef VDB_LAMP_LIGHT
    for (var octave = 0u; octave < OCTAVES; octave++) {
        sums.scattering.octaves[octave] += lamp_light[octave] / max(view.exposure, 1e-30);
    }
#endif
#ifdef VDB_MOTION_VECTORS
    var largest_weight = 0.0;
    for (var i = 0u; i < MAX_FOGS; i++) {
        fog.motion_volume = select(fog.motion_volume, fogs[i].volume, sums.fogs[i] > largest_weight);
        largest_weight = max(largest_weight, sums.fogs[i]);
    }
#endif
    for (var i = 0u; i < MAX_FOGS; i++) {
        if sums.fogs[i] > 0.0 {
            fog.radiance += sums.fogs[i] * volumes[fogs[i].volume].emissive;
        }
    }
    fog.radiance += scattered_radiance(sums.scattering, fog.optical_depth);
    fog.t_mean = t_zero + sums.t / max(sums.weight, 1e-30);
#ifdef VDB_EMITS
    // Emission need not attenuate anything, so weight t by radiance.
    let t_radiance = t_zero + t_radiance_sum / max(radiance_sum, 1e-30);
    fog.t_mean = select(fog.t_mean, t_radiance, radiance_sum > 1e-30);
#endif
    return fog;
}
