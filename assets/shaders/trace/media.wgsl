// All fogs and emission grids along a segment, marched together, with light from the light cache.
//
// The media share their steps. Within a step, every fog is homogeneous, with the density and the light in the
// middle of the step, and emission has its mean over a few samples. The integral of transmittance then has a
// closed form, so overlap adds no error.
#define_import_path bevy_vdb::trace::media

#ifdef VDB_VARYING_ALBEDO
#import bevy_vdb::trace::color::albedo_along
#endif
#import bevy_vdb::trace::fog_march::{Fog, MIN_STEP}
#import bevy_vdb::trace::intervals::{HAS_INTERVALS, IntervalSums, LAMP_INTERVAL, MIN_INTERVAL, SegmentSums}
#import bevy_vdb::trace::intervals::{add_interval, interval_voxels, next_multiple}
#import bevy_vdb::trace::media_step::{FogStep, add_step, fog_step}
#import bevy_vdb::trace::medium::{HAS_MANY_MEDIA, MAX_FOGS, Medium, MetMedia, begun, first_step}
#import bevy_vdb::trace::medium::{new_medium, no_medium, suitable_step}
#import bevy_vdb::trace::scattering::{OPAQUE_DEPTH, Tint, all_visible, pass_stretch, scattered_radiance}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattered_light::{ScatteredRay, scattered_light_at, scattered_ray}
#import bevy_vdb::trace::scattering::{add_tints, forward_depth}
#endif
#import bevy_vdb::trace::segment::{NONE, Segment}
#import bevy_vdb::trace::shared_light::begin_light
#import bevy_vdb::traversal::fog::{next_index, step_length, stride_at}
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::volumes
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::trace::intervals::{flush_near_lamps, near_lamps}
#import bevy_vdb::trace::light_cache::{NOT_CACHED, lamp_light_lattice}
#import bevy_vdb::trace::media_step::step_lamp_light
#import bevy_vdb::trace::scattering::remaining_color
#import bevy_vdb::view::scene::view
#endif
#ifdef VDB_EMISSION
#import bevy_vdb::trace::media_step::emitted_in_step
#import bevy_vdb::trace::medium::{EMISSION_STEP, MAX_EMITTERS}
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
            let step = max(volumes[list[i]].fog_step, MIN_STEP);
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
    var shared_light = begin_light(segment.dir / dir_length);
#ifdef VDB_SCATTERED
    var scattered_rays = array<ScatteredRay, MAX_FOGS>();
    for (var i = 0u; i < MAX_FOGS; i++) {
        scattered_rays[i] = scattered_ray(segment, t_zero, fogs[i].volume);
    }
#endif
    var passed = all_visible();
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
    var lamp_light = vec3(0.0);     // of lamps, times the exposure
#endif
#ifdef VDB_EMITS
    var radiance_sum = 0.0;
    var t_radiance_sum = 0.0;
#endif
    var is_near_lamps = true;
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
#ifdef VDB_SCATTERED
        var forward = Tint();   // extinction by scattering in the forward peak
#endif
        var steps = array<FogStep, MAX_FOGS>();
        for (var i = 0u; i < MAX_FOGS; i++) {
            if fogs[i].t_next <= t_middle {
                var medium = fogs[i];
                steps[i] = fog_step(&medium, t_low, t_middle, t_high, dir_length);
                fogs[i].accessor = medium.accessor;
                fogs[i].t_next = medium.t_next;
#ifdef VDB_RAMPS
                fogs[i].t_known = medium.t_known;
                fogs[i].value = medium.value;
#endif
                is_empty = is_empty && !steps[i].is_inside;
                extinction += steps[i].extinction;
#ifdef VDB_VARYING_ALBEDO
                if steps[i].extinction > 0.0 {
                    let own = albedo_along(segment, t_zero + t_middle, fogs[i].volume);
                    steps[i].albedo = Tint(steps[i].albedo.value * own);
                }
#endif
#ifdef VDB_SCATTERED
                let anisotropy = volumes[fogs[i].volume].anisotropy;
                forward = add_tints(forward, forward_depth(steps[i].extinction, steps[i].albedo, anisotropy));
#endif
            }
        }
        let depth = extinction * width;
#ifdef VDB_SCATTERED
        forward = Tint(width * forward.value);
        let visible = pass_stretch(&passed, depth, forward);
        let gain = Tint(exp(visible.forward.value));
#else
        let visible = pass_stretch(&passed, depth);
        let gain = Tint();
#endif
        let visible_width = visible.whole * width;
        t_near = FAR;
        for (var i = 0u; i < MAX_FOGS; i++) {
            let weight = steps[i].extinction * visible_width;
#ifdef VDB_RAMPS
            let glow = visible_width * dir_length * steps[i].emission;
            fog.radiance += glow;
            radiance_sum += dot(glow, vec3(1.0));
            t_radiance_sum += dot(glow, vec3(1.0)) * t_middle;
#endif
            if weight > 0.0 {
                let volume = fogs[i].volume;
                let own_depth = steps[i].extinction * width;
                var own = interval.fogs[i];
                own.t += weight * t_middle;
                add_step(&own, volume, own_depth, visible, gain, steps[i].depths, steps[i].albedo);
#ifdef VDB_SCATTERED
                let scattered = scattered_light_at(scattered_rays[i], t_middle);
                own.scattered += (own_depth * visible.rest.value * steps[i].albedo.value) * scattered;
#endif
                interval.fogs[i] = own;
#ifdef VDB_LAMP_LIGHT
                let lattice = lamp_lattices[i];
                if lattice != NOT_CACHED {
                    let point = steps[i].point;
                    let light = step_lamp_light(point, lattice, volume, own_depth, visible, gain, steps[i].albedo);
                    lamp_light += light * remaining_color(volumes[volume].base_color);
                }
#endif
            }
            t_near = min(t_near, fogs[i].t_next);
        }
#ifdef VDB_EMISSION
        for (var i = 0u; i < MAX_EMITTERS; i++) {
            if emitters[i].t_next < t_high {
                is_empty = false;
                var medium = emitters[i];
                let visible_length = visible_width * dir_length;
                let added = emitted_in_step(&medium, t_low, t_high, visible_length, fog.radiance);
                emitters[i].accessor = medium.accessor;
                emitters[i].t_next = medium.t_next;
                fog.radiance += added;
                radiance_sum += dot(added, vec3(1.0));
                t_radiance_sum += dot(added, vec3(1.0)) * t_middle;
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
        is_done = k * t_base >= t_end || t_near >= t_end || fog.optical_depth > OPAQUE_DEPTH;
        // The only call: compilers inline it, with rays to all lights.
        if HAS_INTERVALS && (t_high >= t_flush || is_done) && interval.weight > 0.0 {
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
    if !HAS_INTERVALS && interval.weight > 0.0 {
        add_interval(segment, pixel, &fogs, t_zero, t_max, &shared_light, &interval, is_near_lamps, &sums);
    }
#ifdef VDB_LAMP_LIGHT
    sums.scattering.radiance += lamp_light / max(view.exposure, 1e-30);
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
