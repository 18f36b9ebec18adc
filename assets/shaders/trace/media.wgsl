// All fogs and emission grids along a segment, marched together, with light from the light cache.
//
// The media share their steps. Within a step, every fog is homogeneous, with the density and the light in the
// middle of the step, and emission has its mean over a few samples. The integral of transmittance then has a
// closed form, so overlap adds no error.
//
// A single fog stays in registers. Several do not fit, and what is kept for each of them passes through the memory of
// its thread: only what cannot be computed anew from the volume is kept, and sums are over all fogs where possible.
#define_import_path bevy_vdb::trace::media

#ifdef VDB_VARYING_ALBEDO
#import bevy_vdb::trace::color::albedo_along
#endif
#import bevy_vdb::trace::fog_march::{Fog, light_around}
#import bevy_vdb::trace::intervals::{HAS_INTERVALS, IntervalSums, LAMP_INTERVAL, MIN_INTERVAL, SegmentSums}
#import bevy_vdb::trace::intervals::{add_interval, interval_voxels, next_multiple}
#import bevy_vdb::trace::media_step::{FogStep, add_for_others, add_suns, fog_step, fog_traits, step_albedo}
#import bevy_vdb::trace::medium::{HAS_MANY_MEDIA, MAX_FOGS, Medium, MetMedia, begun, first_step}
#import bevy_vdb::trace::medium::{fog_step_voxels, new_medium, step_of_voxels, suitable_step}
#import bevy_vdb::trace::scattering::{OPAQUE_DEPTH, Tint, add_environment, all_visible, pass_stretch}
#import bevy_vdb::trace::scattering::scattered_radiance
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattered_light::{ScatteredLight, has_scattered_light, scattered_light_at, scattered_ray}
#import bevy_vdb::trace::scattered_light::{scattered_slot, scattered_towards_viewer}
#import bevy_vdb::trace::scattering::{add_tints, forward_depth}
#endif
#import bevy_vdb::trace::segment::{NONE, Segment}
#import bevy_vdb::trace::shared_light::{HAS_OTHER_LIGHTS, begin_light, sun_phases}
#import bevy_vdb::traversal::fog::{next_index, step_length, stride_at}
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::tree::{Accessor, empty_accessor}
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
#import bevy_vdb::trace::medium::{EMISSION_STEP, MAX_EMITTERS, missed_medium}
#endif

// Radiance and optical depth of the media along a segment up to `t_max`: of at least one fog.
fn march_media(segment: Segment, pixel: vec2<u32>, met: MetMedia, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, FAR, FAR, NONE);
    var list = met.fogs;
    var fogs = array<Medium, MAX_FOGS>();
    // There is at least one. With a single slot, the count is a constant, so that the slot stays in registers.
    let fog_count = select(min(met.fog_count, MAX_FOGS), 1u, MAX_FOGS == 1u);
    var t_base = FAR;
    var t_first = FAR;
    var t_last = -FAR;
    var t_interval = FAR;
    for (var i = 0u; i < fog_count; i++) {
        let medium = new_medium(segment, list[i], t_max);
        fogs[i] = medium;
        t_first = min(t_first, medium.t_next);
        t_last = max(t_last, medium.t_last);
        t_base = min(t_base, step_of_voxels(medium, fog_step_voxels(list[i])));
        if HAS_INTERVALS {
            t_interval = min(t_interval, step_of_voxels(medium, interval_voxels(segment, list[i])));
        }
    }
#ifdef VDB_EMISSION
    var emitter_list = met.emitters;
    var emitters = array<Medium, MAX_EMITTERS>();
    var emitter_accessors = array<Accessor, MAX_EMITTERS>();
    let emitter_count = select(min(met.emitter_count, MAX_EMITTERS), 1u, MAX_EMITTERS == 1u);
    for (var i = 0u; i < emitter_count; i++) {
        var medium = missed_medium(list[0]);
        if i < met.emitter_count {
            medium = new_medium(segment, emitter_list[i], t_max);
        }
        emitters[i] = medium;
        emitter_accessors[i] = empty_accessor();
        t_first = min(t_first, medium.t_next);
        t_last = max(t_last, medium.t_last);
        t_base = min(t_base, step_of_voxels(medium, EMISSION_STEP));
    }
#endif
    if t_first >= t_last {
        return fog;
    }
    fog.t_first = t_first;
    fog.t_mean = t_first;
    // The shortest step; all begin at its multiples from the segment's origin, so that neighbouring rays
    // sample neighbouring points.
    t_base = step_length(t_base, t_last - t_first);
    let inverse_base = 1.0 / t_base;
    let t_zero = floor(t_first * inverse_base) * t_base;
    let t_start = t_first - t_zero;
    let t_end = t_last - t_zero;
    var t_near = FAR;   // of what comes next
    for (var i = 0u; i < fog_count; i++) {
        let medium = begun(fogs[i], segment, pixel, t_zero);
        fogs[i] = medium;
        t_near = min(t_near, medium.t_next);
    }
#ifdef VDB_EMISSION
    for (var i = 0u; i < emitter_count; i++) {
        let medium = begun(emitters[i], segment, pixel, t_zero);
        emitters[i] = medium;
        t_near = min(t_near, medium.t_next);
    }
#endif
    let dir_length = length(segment.dir);
    let dir = segment.dir / dir_length;
    var shared_light = begin_light(dir);
    var phases = sun_phases(dir, volumes[list[0]].anisotropy);
#ifdef VDB_SCATTERED
    // Fogs that overlap usually share a lattice.
    var in_lattice = scattered_ray(segment, t_zero, scattered_slot(list[0]));
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
    var lamp_light = vec3(0.0);     // of lamps, times the exposure
#endif
#ifdef VDB_EMITS
    var radiance_sum = 0.0;
    var t_radiance_sum = 0.0;
#endif
    var is_near_lamps = true;
    var k = first_step(min(t_near, t_end) * inverse_base);
    var is_done = t_near >= t_end;
    var accessor = empty_accessor();
    var traits = fog_traits(list[0], dir_length);
    var steps = array<FogStep, MAX_FOGS>();
    // Ends by its condition only: llvmpipe drops invocations of a group whose neighbours leave nested loops
    // by `break` or `continue`.
    while !is_done {
        let t_low = max(k * t_base, t_start);
        var stride = stride_at(fog.optical_depth);
        if HAS_MANY_MEDIA {
            // The longest step that suits the media here and those that begin within it.
            var t_step = FAR;
            for (var i = 0u; i < fog_count; i++) {
                let t_longest = step_of_voxels(fogs[i], fog_step_voxels(fogs[i].volume));
                t_step = min(t_step, suitable_step(fogs[i], t_longest, t_low, t_end, t_base, inverse_base));
            }
#ifdef VDB_EMISSION
            for (var i = 0u; i < emitter_count; i++) {
                let t_longest = step_of_voxels(emitters[i], EMISSION_STEP);
                t_step = min(t_step, suitable_step(emitters[i], t_longest, t_low, t_end, t_base, inverse_base));
            }
#endif
            stride *= max(t_step * inverse_base, 1.0);
        }
        let t_high = clamp((k + stride) * t_base, t_low, t_end);
        let width = t_high - t_low;
        let t_middle = t_low + 0.5 * width;
        var is_empty = true;
        var extinction = 0.0;
#ifdef VDB_SCATTERED
        var forward = Tint();   // extinction by scattering in the forward peak
#endif
        t_near = FAR;
        for (var i = 0u; i < fog_count; i++) {
            var medium = fogs[i];
            var step = FogStep();
            if medium.t_next <= t_middle {
                if MAX_FOGS > 1u {
                    accessor = empty_accessor();
                    traits = fog_traits(medium.volume, dir_length);
                }
                step = fog_step(&medium, &accessor, t_low, t_middle, t_high, dir_length, traits);
                is_empty = is_empty && medium.t_next != t_middle;
#ifdef VDB_VARYING_ALBEDO
                if step.extinction > 0.0 {
                    let own = albedo_along(segment, t_zero + t_middle, medium.volume);
                    step.albedo = Tint(step.albedo.value * own);
                }
#endif
                extinction += step.extinction;
#ifdef VDB_SCATTERED
                let own_forward = forward_depth(step.extinction, step_albedo(traits, step), traits.anisotropy);
                forward = add_tints(forward, own_forward);
#endif
                fogs[i].t_next = medium.t_next;
#ifdef VDB_RAMPS
                fogs[i].t_known = medium.t_known;
                fogs[i].value = medium.value;
#endif
            }
            steps[i] = step;
            t_near = min(t_near, medium.t_next);
        }
        let depth = extinction * width;
#ifdef VDB_SCATTERED
        let visible = pass_stretch(&passed, depth, Tint(width * forward.value));
        let gain = Tint(exp(visible.forward.value));
        var scattered = ScatteredLight();
        if depth > 0.0 {
            scattered = scattered_light_at(in_lattice, dir, t_middle);
        }
#else
        let visible = pass_stretch(&passed, depth);
        let gain = Tint();
#endif
        let visible_width = visible.whole * width;
        for (var i = 0u; i < fog_count; i++) {
            let step = steps[i];
            let weight = step.extinction * visible_width;
#ifdef VDB_RAMPS
            let glow = visible_width * dir_length * step.emission;
            fog.radiance += glow;
            radiance_sum += dot(glow, vec3(1.0));
            t_radiance_sum += dot(glow, vec3(1.0)) * t_middle;
#endif
            if weight > 0.0 {
                let volume = fogs[i].volume;
                let own_depth = step.extinction * width;
                if MAX_FOGS > 1u {
                    traits = fog_traits(volume, dir_length);
                }
                let albedo = step_albedo(traits, step);
                sums.fogs[i] += weight;
#ifdef VDB_VARYING_ALBEDO
                sums.albedos[i] += weight * albedo.value;
#endif
                // Fogs that overlap usually have the same phase function.
                if MAX_FOGS > 1u && traits.anisotropy != phases.anisotropy {
                    phases = sun_phases(dir, traits.anisotropy);
                }
                add_suns(&interval, volume, phases, own_depth, visible, gain, step.depths, albedo);
                if HAS_OTHER_LIGHTS {
                    var own = interval.fogs[i];
                    add_for_others(&own, own_depth, t_middle, visible, albedo);
                    interval.fogs[i] = own;
                }
#ifdef VDB_SCATTERED
                let slot = scattered_slot(volume);
                if MAX_FOGS > 1u && slot != in_lattice.slot && has_scattered_light(volume) {
                    in_lattice = scattered_ray(segment, t_zero, slot);
                    scattered = scattered_light_at(in_lattice, dir, t_middle);
                }
                // Without `remaining_color`: where light is scattered, tinted fogs have a factor for each channel.
                interval.scattered += (own_depth * visible.rest.value * albedo.value)
                    * scattered_towards_viewer(scattered, volume);
#endif
#ifdef VDB_LAMP_LIGHT
                let lattice = lamp_light_lattice(volume);
                if lattice != NOT_CACHED {
                    let light = step_lamp_light(step.point, lattice, volume, own_depth, visible, gain, albedo);
                    lamp_light += light * remaining_color(volumes[volume].base_color);
                }
#endif
            }
        }
#ifdef VDB_EMISSION
        for (var i = 0u; i < emitter_count; i++) {
            if emitters[i].t_next < t_high {
                is_empty = false;
                var medium = emitters[i];
                var emitter_accessor = emitter_accessors[i];
                let visible_length = visible_width * dir_length;
                let added =
                    emitted_in_step(&medium, &emitter_accessor, t_low, t_high, visible_length, fog.radiance);
                emitter_accessors[i] = emitter_accessor;
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
            add_interval(segment, pixel, &fogs, fog_count, t_zero, t_max, &shared_light, &interval, is_near_lamps, &sums);
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
        add_interval(segment, pixel, &fogs, fog_count, t_zero, t_max, &shared_light, &interval, is_near_lamps, &sums);
    }
#ifdef VDB_LAMP_LIGHT
    sums.scattering.radiance += lamp_light / max(view.exposure, 1e-30);
#endif
#ifdef VDB_MOTION_VECTORS
    var largest_weight = 0.0;
    for (var i = 0u; i < fog_count; i++) {
        fog.motion_volume = select(fog.motion_volume, fogs[i].volume, sums.fogs[i] > largest_weight);
        largest_weight = max(largest_weight, sums.fogs[i]);
    }
#endif
    var scattering = sums.scattering;
    for (var i = 0u; i < fog_count; i++) {
        let volume = fogs[i].volume;
        let weight = sums.fogs[i];
        fog.radiance += weight * volumes[volume].emissive;
        let anisotropy = volumes[volume].anisotropy;
        let around = light_around(shared_light.environment, anisotropy);
#ifdef VDB_VARYING_ALBEDO
        let albedo = sums.albedos[i] / max(weight, 1e-30);
#else
        let albedo = volumes[volume].base_color;
#endif
        add_environment(&scattering, weight, albedo, around, anisotropy);
    }
    fog.radiance += scattered_radiance(scattering, fog.optical_depth);
    fog.t_mean = t_zero + sums.t / max(sums.weight, 1e-30);
#ifdef VDB_EMITS
    // Emission need not attenuate anything, so weight t by radiance.
    let t_radiance = t_zero + t_radiance_sum / max(radiance_sum, 1e-30);
    fog.t_mean = select(fog.t_mean, t_radiance, radiance_sum > 1e-30);
#endif
    return fog;
}
