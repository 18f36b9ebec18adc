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
#import bevy_vdb::trace::intervals::{add_interval, first_bounds, next_bounds, was_near_lamps}
#import bevy_vdb::trace::media_step::{FogStep, FogTraits, add_for_others, add_suns, fog_step, fog_traits, step_albedo}
#import bevy_vdb::trace::medium::{HAS_MANY_MEDIA, MAX_FOGS, Medium, MetMedia}
#import bevy_vdb::trace::scattering::{OPAQUE_DEPTH, Tint, Visible, add_environment, all_visible, pass_stretch}
#import bevy_vdb::trace::scattering::scattered_radiance
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattered_light::{ScatteredLight, ScatteredRay, has_scattered_light, scattered_light_at}
#import bevy_vdb::trace::scattered_light::{scattered_ray, scattered_slot, scattered_towards_viewer}
#import bevy_vdb::trace::scattering::{add_tints, forward_depth}
#endif
#import bevy_vdb::trace::segment::{NONE, Segment}
#import bevy_vdb::trace::shared_light::{HAS_OTHER_LIGHTS, SharedLight, SunPhases, begin_light, sun_phases}
#import bevy_vdb::trace::span::{Span, Step, begin_fogs, first_step, longest_fog_step, meet_fogs, new_span, step_to}
#import bevy_vdb::traversal::fog::{next_index, stride_at}
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::tree::{Accessor, empty_accessor}
#import bevy_vdb::view::scene::volumes
#ifdef VDB_EMITS
#import bevy_vdb::trace::intervals::add_emitted
#endif
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::trace::light_cache::{NOT_CACHED, lamp_light_lattice}
#import bevy_vdb::trace::media_step::step_lamp_light
#import bevy_vdb::trace::scattering::remaining_color
#import bevy_vdb::view::scene::view
#endif
#ifdef VDB_EMISSION
#import bevy_vdb::trace::media_step::emitted_in_step
#import bevy_vdb::trace::medium::MAX_EMITTERS
#import bevy_vdb::trace::span::{begin_emitters, longest_emission_step, meet_emitters}
#endif

// What the march keeps of the ray and of the last fog from step to step.
struct MarchState {
    dir: vec3<f32>,         // normalised
    dir_length: f32,        // of the segment's direction
    accessor: Accessor,
    traits: FogTraits,
    phases: SunPhases,
#ifdef VDB_SCATTERED
    in_lattice: ScatteredRay,
#endif
}

// What a step finds in all media.
struct Found {
    extinction: f32,
    t_near: f32,            // there is nothing between the step and this t
    is_empty: bool,
#ifdef VDB_SCATTERED
    forward: Tint,          // extinction by scattering in the forward peak
#endif
}

// Radiance and optical depth of the media along a segment up to `t_max`: of at least one fog.
fn march_media(segment: Segment, pixel: vec2<u32>, met: MetMedia, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, FAR, FAR, NONE);
    var fogs = array<Medium, MAX_FOGS>();
    // There is at least one. With a single slot, the count is a constant, so that the slot stays in registers.
    let fog_count = select(min(met.fog_count, MAX_FOGS), 1u, MAX_FOGS == 1u);
    var extent = meet_fogs(&fogs, fog_count, met, segment, t_max);
#ifdef VDB_EMISSION
    var emitters = array<Medium, MAX_EMITTERS>();
    var accessors = array<Accessor, MAX_EMITTERS>();
    let emitter_count = select(min(met.emitter_count, MAX_EMITTERS), 1u, MAX_EMITTERS == 1u);
    extent = meet_emitters(&emitters, emitter_count, met, segment, t_max, extent);
    for (var i = 0u; i < emitter_count; i++) {
        accessors[i] = empty_accessor();
    }
#endif
    if extent.t_first >= extent.t_last {
        return fog;
    }
    fog.t_first = extent.t_first;
    let span = new_span(extent);
    var t_near = begin_fogs(&fogs, fog_count, segment, pixel, span);     // of what comes next
#ifdef VDB_EMISSION
    t_near = min(t_near, begin_emitters(&emitters, emitter_count, segment, pixel, span));
#endif
    var state = begin_state(segment, span, met.fogs[0]);
    var shared_light = begin_light(state.dir);
    var passed = all_visible();
    var sums = SegmentSums();
    var interval = IntervalSums();
    var bounds = first_bounds(segment, &fogs, fog_count, span.t_zero, t_near);
    var steps = array<FogStep, MAX_FOGS>();
    var k = first_step(span, t_near);
    var is_done = t_near >= span.t_end;
    // Ends by its condition only: llvmpipe drops invocations of a group whose neighbours leave nested loops
    // by `break` or `continue`.
    while !is_done {
        let t_low = max(k * span.t_base, span.t_start);
        var stride = stride_at(fog.optical_depth);
        if HAS_MANY_MEDIA {
            var t_step = longest_fog_step(&fogs, fog_count, span, t_low);
#ifdef VDB_EMISSION
            t_step = min(t_step, longest_emission_step(&emitters, emitter_count, span, t_low));
#endif
            stride *= max(t_step * span.inverse_base, 1.0);
        }
        let step = step_to(span, t_low, k + stride);
        var found = sample_fogs(&fogs, fog_count, &steps, &state, segment, span.t_zero, step);
        let depth = found.extinction * step.width;
#ifdef VDB_SCATTERED
        let visible = pass_stretch(&passed, depth, Tint(step.width * found.forward.value));
#else
        let visible = pass_stretch(&passed, depth);
#endif
        add_fogs(&fogs, fog_count, &steps, &state, segment, span.t_zero, step, depth, visible, &interval, &sums);
        let visible_width = visible.whole * step.width;
#ifdef VDB_EMISSION
        add_emitters(&emitters, emitter_count, &accessors, step, visible_width * state.dir_length, &found, &sums);
#endif
        t_near = found.t_near;
        let k_near = max(k + 1.0, first_step(span, t_near));
        k = next_index(k, select(k + stride, k_near, found.is_empty));
        let weight = found.extinction * visible_width;
        interval.width += select(0.0, step.width, weight > 0.0);
        interval.weight += weight;
        interval.t += weight * step.t_middle;
        fog.optical_depth += depth;
        is_done = k * span.t_base >= span.t_end || t_near >= span.t_end || fog.optical_depth > OPAQUE_DEPTH;
        // The only call: compilers inline it, with rays to all lights.
        if HAS_INTERVALS && (step.t_high >= bounds.t_end || is_done) && interval.weight > 0.0 {
            let is_near = was_near_lamps(bounds, step.t_high);
            add_interval(segment, pixel, &fogs, fog_count, span.t_zero, t_max, &shared_light, &interval, is_near, &sums);
            // As steps do, intervals become longer where the view ray is attenuated.
            let longest = LAMP_INTERVAL * shared_light.nearest / (state.dir_length * bounds.t_longest);
            let part = max(min(stride_at(fog.optical_depth), longest), MIN_INTERVAL);
            let t_length = bounds.t_longest * exp2(floor(log2(part)));
            bounds = next_bounds(bounds, t_length, span.t_zero, step.t_high, t_near);
        }
    }
    if !HAS_INTERVALS && interval.weight > 0.0 {
        add_interval(segment, pixel, &fogs, fog_count, span.t_zero, t_max, &shared_light, &interval, true, &sums);
    }
    finish(&fog, &fogs, fog_count, shared_light, span.t_zero, sums);
    return fog;
}

fn begin_state(segment: Segment, span: Span, volume: u32) -> MarchState {
    var state = MarchState();
    state.dir_length = length(segment.dir);
    state.dir = segment.dir / state.dir_length;
    state.accessor = empty_accessor();
    state.traits = fog_traits(volume, state.dir_length);
    state.phases = sun_phases(state.dir, volumes[volume].anisotropy);
#ifdef VDB_SCATTERED
    // Fogs that overlap usually share a lattice.
    state.in_lattice = scattered_ray(segment, span.t_zero, scattered_slot(volume));
#endif
    return state;
}

// Samples all fogs in a step.
fn sample_fogs(
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    steps: ptr<function, array<FogStep, MAX_FOGS>>,
    state: ptr<function, MarchState>,
    segment: Segment,
    t_zero: f32,
    at: Step,
) -> Found {
    var found = Found();
    found.t_near = FAR;
    found.is_empty = true;
    let dir_length = (*state).dir_length;
    var accessor = (*state).accessor;
    for (var i = 0u; i < fog_count; i++) {
        var medium = (*fogs)[i];
        var step = FogStep();
        if medium.t_next <= at.t_middle {
            if MAX_FOGS > 1u {
                accessor = empty_accessor();
                (*state).traits = fog_traits(medium.volume, dir_length);
            }
            step = fog_step(&medium, &accessor, at.t_low, at.t_middle, at.t_high, dir_length, (*state).traits);
            found.is_empty = found.is_empty && medium.t_next != at.t_middle;
#ifdef VDB_VARYING_ALBEDO
            if step.extinction > 0.0 {
                let own = albedo_along(segment, t_zero + at.t_middle, medium.volume);
                step.albedo = Tint(step.albedo.value * own);
            }
#endif
            found.extinction += step.extinction;
#ifdef VDB_SCATTERED
            let traits = (*state).traits;
            let own_forward = forward_depth(step.extinction, step_albedo(traits, step), traits.anisotropy);
            found.forward = add_tints(found.forward, own_forward);
#endif
            (*fogs)[i].t_next = medium.t_next;
#ifdef VDB_RAMPS
            (*fogs)[i].t_known = medium.t_known;
            (*fogs)[i].value = medium.value;
#endif
        }
        (*steps)[i] = step;
        found.t_near = min(found.t_near, medium.t_next);
    }
    (*state).accessor = accessor;
    return found;
}

// Adds the light of all fogs in a step of an optical depth.
fn add_fogs(
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    steps: ptr<function, array<FogStep, MAX_FOGS>>,
    state: ptr<function, MarchState>,
    segment: Segment,
    t_zero: f32,
    at: Step,
    depth: f32,
    visible: Visible,
    interval: ptr<function, IntervalSums>,
    sums: ptr<function, SegmentSums>,
) {
    let dir = (*state).dir;
    let visible_width = visible.whole * at.width;
#ifdef VDB_SCATTERED
    let gain = Tint(exp(visible.forward.value));
    var scattered = ScatteredLight();
    if depth > 0.0 {
        scattered = scattered_light_at((*state).in_lattice, dir, at.t_middle);
    }
#else
    let gain = Tint();
#endif
    for (var i = 0u; i < fog_count; i++) {
        let step = (*steps)[i];
        let weight = step.extinction * visible_width;
#ifdef VDB_RAMPS
        add_emitted(sums, visible_width * (*state).dir_length * step.emission, at.t_middle);
#endif
        if weight > 0.0 {
            let volume = (*fogs)[i].volume;
            let own_depth = step.extinction * at.width;
            if MAX_FOGS > 1u {
                (*state).traits = fog_traits(volume, (*state).dir_length);
            }
            let albedo = step_albedo((*state).traits, step);
            (*sums).fogs[i] += weight;
#ifdef VDB_VARYING_ALBEDO
            (*sums).albedos[i] += weight * albedo.value;
#endif
            // Fogs that overlap usually have the same phase function.
            if MAX_FOGS > 1u && (*state).traits.anisotropy != (*state).phases.anisotropy {
                (*state).phases = sun_phases(dir, (*state).traits.anisotropy);
            }
            add_suns(interval, volume, (*state).phases, own_depth, visible, gain, step.depths, albedo);
            if HAS_OTHER_LIGHTS {
                var own = (*interval).fogs[i];
                add_for_others(&own, own_depth, at.t_middle, visible, albedo);
                (*interval).fogs[i] = own;
            }
#ifdef VDB_SCATTERED
            let slot = scattered_slot(volume);
            if MAX_FOGS > 1u && slot != (*state).in_lattice.slot && has_scattered_light(volume) {
                (*state).in_lattice = scattered_ray(segment, t_zero, slot);
                scattered = scattered_light_at((*state).in_lattice, dir, at.t_middle);
            }
            // Without `remaining_color`: where light is scattered, tinted fogs have a factor for each channel.
            (*interval).scattered += (own_depth * visible.rest.value * albedo.value)
                * scattered_towards_viewer(scattered, volume);
#endif
#ifdef VDB_LAMP_LIGHT
            let lattice = lamp_light_lattice(volume);
            if lattice != NOT_CACHED {
                let light = step_lamp_light(step.point, lattice, volume, own_depth, visible, gain, albedo);
                (*sums).lamp_light += light * remaining_color(volumes[volume].base_color);
            }
#endif
        }
    }
}

#ifdef VDB_EMISSION
// Adds what emission grids emit in a step. `visible_length` is the length of the step in world units times what is
// visible of it.
fn add_emitters(
    emitters: ptr<function, array<Medium, MAX_EMITTERS>>,
    emitter_count: u32,
    accessors: ptr<function, array<Accessor, MAX_EMITTERS>>,
    at: Step,
    visible_length: f32,
    found: ptr<function, Found>,
    sums: ptr<function, SegmentSums>,
) {
    for (var i = 0u; i < emitter_count; i++) {
        var medium = (*emitters)[i];
        if medium.t_next < at.t_high {
            (*found).is_empty = false;
            var accessor = (*accessors)[i];
            let emitted =
                emitted_in_step(&medium, &accessor, at.t_low, at.t_high, visible_length, (*sums).emitted);
            (*accessors)[i] = accessor;
            (*emitters)[i].t_next = medium.t_next;
            add_emitted(sums, emitted, at.t_middle);
        }
        (*found).t_near = min((*found).t_near, medium.t_next);
    }
}
#endif

// Sets the radiance of the media, and where and what they seem to be.
fn finish(
    fog: ptr<function, Fog>,
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    shared_light: SharedLight,
    t_zero: f32,
    all_sums: SegmentSums,
) {
    var sums = all_sums;
    var scattering = sums.scattering;
#ifdef VDB_LAMP_LIGHT
    scattering.radiance += sums.lamp_light / max(view.exposure, 1e-30);
#endif
#ifdef VDB_EMITS
    (*fog).radiance = sums.emitted;
#endif
#ifdef VDB_MOTION_VECTORS
    var largest_weight = 0.0;
#endif
    for (var i = 0u; i < fog_count; i++) {
        let volume = (*fogs)[i].volume;
        let weight = sums.fogs[i];
#ifdef VDB_MOTION_VECTORS
        (*fog).motion_volume = select((*fog).motion_volume, volume, weight > largest_weight);
        largest_weight = max(largest_weight, weight);
#endif
        (*fog).radiance += weight * volumes[volume].emissive;
        let anisotropy = volumes[volume].anisotropy;
        let around = light_around(shared_light.environment, anisotropy);
#ifdef VDB_VARYING_ALBEDO
        let albedo = sums.albedos[i] / max(weight, 1e-30);
#else
        let albedo = volumes[volume].base_color;
#endif
        add_environment(&scattering, weight, albedo, around, anisotropy);
    }
    (*fog).radiance += scattered_radiance(scattering, (*fog).optical_depth);
    (*fog).t_mean = t_zero + sums.t / max(sums.weight, 1e-30);
#ifdef VDB_EMITS
    // Emission need not attenuate anything, so weight t by radiance.
    let t_emitted = t_zero + sums.t_emitted / max(sums.emitted_weight, 1e-30);
    (*fog).t_mean = select((*fog).t_mean, t_emitted, sums.emitted_weight > 1e-30);
#endif
}
