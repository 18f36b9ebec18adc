// All fogs and emission grids along a segment, marched together, with light from the light cache.
//
// The media share their steps. Within a step, every fog is homogeneous, with the density and the light in the
// middle of the step, and emission has its mean over a few samples. The integral of transmittance then has a
// closed form, so overlap adds no error.
//
// Steps come in blocks. Each fog is sampled at all steps of a block before the next fog is, because several fogs do
// not fit into registers: what it takes to sample a fog is read from memory once per block. Then the light of the steps
// is added up, step by step. A single fog stays in registers, and its blocks are single steps.
#define_import_path bevy_vdb::trace::media

#ifdef VDB_VARYING_ALBEDO
#import bevy_vdb::trace::color::albedo_along
#endif
#import bevy_vdb::trace::fog_march::Fog
#import bevy_vdb::trace::intervals::{HAS_INTERVALS, IntervalSums, LAMP_INTERVAL, MIN_INTERVAL, SegmentSums}
#import bevy_vdb::trace::intervals::{add_interval, interval_voxels, next_multiple}
#import bevy_vdb::trace::media_step::{FogStep, add_step, fog_step, step_albedo}
#import bevy_vdb::trace::medium::{BLOCK, HAS_MANY_MEDIA, MAX_FOGS, Medium, MetMedia, begun, first_step}
#import bevy_vdb::trace::medium::{fog_step_voxels, new_medium, step_of_voxels, suitable_step}
#import bevy_vdb::trace::scattering::{OPAQUE_DEPTH, Tint, all_visible, pass_stretch, scattered_radiance}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattered_light::{ScatteredLight, has_scattered_light, scattered_light_at, scattered_ray}
#import bevy_vdb::trace::scattered_light::{scattered_slot, scattered_towards_viewer}
#import bevy_vdb::trace::scattering::{add_tints, forward_depth}
#endif
#import bevy_vdb::trace::segment::{NONE, Segment}
#import bevy_vdb::trace::shared_light::{HAS_OTHER_LIGHTS, begin_light}
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

// The ends of a step, and its middle.
struct StepPlace {
    t_low: f32,
    t_middle: f32,
    t_high: f32,
}

// Between two multiples of the shortest step.
fn step_place(first: f32, last: f32, t_base: f32, t_start: f32, t_end: f32) -> StepPlace {
    let t_low = min(max(first * t_base, t_start), t_end);
    let t_high = clamp(last * t_base, t_low, t_end);
    return StepPlace(t_low, t_low + 0.5 * (t_high - t_low), t_high);
}

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
    var steps = array<FogStep, MAX_FOGS * BLOCK>();
    // Ends by its condition only: llvmpipe drops invocations of a group whose neighbours leave nested loops
    // by `break` or `continue`.
    while !is_done {
        var stride = stride_at(fog.optical_depth);
        if HAS_MANY_MEDIA {
            // The longest step that suits the media here and those that begin within the block.
            let t_low = max(k * t_base, t_start);
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
        var is_empty = true;
        var extinctions = array<f32, BLOCK>();
#ifdef VDB_SCATTERED
        var forwards = array<Tint, BLOCK>();    // extinction by scattering in the forward peak
#endif
        t_near = FAR;
        for (var i = 0u; i < fog_count; i++) {
            var medium = fogs[i];
            if MAX_FOGS > 1u {
                accessor = empty_accessor();
            }
            for (var j = 0u; j < BLOCK; j++) {
                let place = step_place(k + f32(j) * stride, k + f32(j + 1u) * stride, t_base, t_start, t_end);
                var step = FogStep();
                if medium.t_next <= place.t_middle {
                    step = fog_step(&medium, &accessor, place.t_low, place.t_middle, place.t_high, dir_length);
                    is_empty = is_empty && medium.t_next != place.t_middle;
#ifdef VDB_VARYING_ALBEDO
                    if step.extinction > 0.0 {
                        let own = albedo_along(segment, t_zero + place.t_middle, medium.volume);
                        step.albedo = Tint(step.albedo.value * own);
                    }
#endif
                    extinctions[j] += step.extinction;
#ifdef VDB_SCATTERED
                    let anisotropy = volumes[medium.volume].anisotropy;
                    let own_forward = forward_depth(step.extinction, step_albedo(medium.volume, step), anisotropy);
                    forwards[j] = add_tints(forwards[j], own_forward);
#endif
                }
                steps[i * BLOCK + j] = step;
            }
            fogs[i].t_next = medium.t_next;
#ifdef VDB_RAMPS
            fogs[i].t_known = medium.t_known;
            fogs[i].value = medium.value;
#endif
            t_near = min(t_near, medium.t_next);
        }
        for (var j = 0u; j < BLOCK; j++) {
            let place = step_place(k + f32(j) * stride, k + f32(j + 1u) * stride, t_base, t_start, t_end);
            let width = place.t_high - place.t_low;
            let depth = extinctions[j] * width;
#ifdef VDB_SCATTERED
            let visible = pass_stretch(&passed, depth, Tint(width * forwards[j].value));
            // May overflow behind an opaque step of the same block, where nothing has a weight.
            let gain = Tint(exp(visible.forward.value));
            var scattered = ScatteredLight();
            if depth > 0.0 {
                scattered = scattered_light_at(in_lattice, dir, place.t_middle);
            }
#else
            let visible = pass_stretch(&passed, depth);
            let gain = Tint();
#endif
            let visible_width = visible.whole * width;
            for (var i = 0u; i < fog_count; i++) {
                let step = steps[i * BLOCK + j];
                let weight = step.extinction * visible_width;
#ifdef VDB_RAMPS
                let glow = visible_width * dir_length * step.emission;
                fog.radiance += glow;
                radiance_sum += dot(glow, vec3(1.0));
                t_radiance_sum += dot(glow, vec3(1.0)) * place.t_middle;
#endif
                if weight > 0.0 {
                    let volume = fogs[i].volume;
                    let own_depth = step.extinction * width;
                    let albedo = step_albedo(volume, step);
                    var own = interval.fogs[i];
                    if HAS_OTHER_LIGHTS {
                        own.t += weight * place.t_middle;
                    }
                    add_step(&own, volume, own_depth, visible, gain, step.depths, albedo);
                    interval.fogs[i] = own;
#ifdef VDB_SCATTERED
                    let slot = scattered_slot(volume);
                    if MAX_FOGS > 1u && slot != in_lattice.slot && has_scattered_light(volume) {
                        in_lattice = scattered_ray(segment, t_zero, slot);
                        scattered = scattered_light_at(in_lattice, dir, place.t_middle);
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
                if emitters[i].t_next < place.t_high {
                    is_empty = false;
                    var medium = emitters[i];
                    var emitter_accessor = emitter_accessors[i];
                    let visible_length = visible_width * dir_length;
                    let added = emitted_in_step(
                        &medium,
                        &emitter_accessor,
                        place.t_low,
                        place.t_high,
                        visible_length,
                        fog.radiance,
                    );
                    emitter_accessors[i] = emitter_accessor;
                    emitters[i].t_next = medium.t_next;
                    fog.radiance += added;
                    radiance_sum += dot(added, vec3(1.0));
                    t_radiance_sum += dot(added, vec3(1.0)) * place.t_middle;
                }
                if j + 1u == BLOCK {
                    t_near = min(t_near, emitters[i].t_next);
                }
            }
#endif
            let weight = extinctions[j] * visible_width;
            interval.width += select(0.0, width, weight > 0.0);
            interval.weight += weight;
            interval.t += weight * place.t_middle;
            fog.optical_depth += depth;
            var t_next = place.t_high;
            if j + 1u == BLOCK {
                let k_near = first_step(min(t_near, t_end) * inverse_base);
                let k_end = k + select(f32(BLOCK) * stride, 1.0, is_empty);
                k = next_index(k, max(k_end, k_near));
                is_done = k * t_base >= t_end || t_near >= t_end || fog.optical_depth > OPAQUE_DEPTH;
                t_next = max(t_next, t_near);
            }
            // The only call: compilers inline it, with rays to all lights.
            if HAS_INTERVALS && (place.t_high >= t_flush || is_done) && interval.weight > 0.0 {
#ifdef VDB_LAMP_LIGHT
                is_near_lamps = near.x < place.t_high && near.y > t_interval_begin;
                t_interval_begin = place.t_high;
#endif
                add_interval(segment, pixel, &fogs, fog_count, t_zero, t_max, &shared_light, &interval, is_near_lamps, &sums);
                // Ends at multiples of a length, so that neighbouring rays evaluate light at the same time, and
                // grows like the steps.
                let longest = LAMP_INTERVAL * shared_light.nearest / (dir_length * t_interval);
                let part = max(min(stride_at(fog.optical_depth), longest), MIN_INTERVAL);
                let t_part = t_interval * exp2(floor(log2(part)));
                t_flush = next_multiple(t_zero + t_next, t_part) - t_zero;
#ifdef VDB_LAMP_LIGHT
                t_flush = flush_near_lamps(t_flush, place.t_high, near);
#endif
            }
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
    for (var i = 0u; i < fog_count; i++) {
        fog.radiance += sums.fogs[i] * volumes[fogs[i].volume].emissive;
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
