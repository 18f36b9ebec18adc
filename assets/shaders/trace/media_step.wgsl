// One step of the march through several media: what it finds in each, and what each adds to the sums of the
// interval. Every t is relative to where the march begins.
#define_import_path bevy_vdb::trace::media_step

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::fog_march::MAX_DEPTH_OF_STEP
#import bevy_vdb::trace::intervals::{IntervalSums, SunSum}
#import bevy_vdb::trace::light_cache::{cached_sun_depth, lattice_point}
#import bevy_vdb::trace::medium::Medium
#import bevy_vdb::trace::scattering::{Tint, Visible, tint}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattering::{arriving_light, forward_depth}
#else
#import bevy_vdb::trace::scattering::remaining_color
#endif
#import bevy_vdb::trace::shared_light::{FogSums, SUN_COUNT, SUN_SLOTS, SunPhases}
#import bevy_vdb::traversal::fog::sample_fog
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::tree::Accessor
#import bevy_vdb::view::scene::{fog_grid, volumes}
#ifdef VDB_RAMPS
#import bevy_vdb::trace::ramp_light::{RampSums, add_stretch, visible_albedo}
#import bevy_vdb::trace::scattering::mean_transmittance
#endif
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::trace::light_cache::cached_lamp_light
#endif
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::{EmissionStep, max3, sampled_emission}
#import bevy_vdb::traversal::fog::probe_fog
#import bevy_vdb::view::scene::view
#endif

// A fog in a step.
struct FogStep {
    extinction: f32,                // per t
#ifdef VDB_VARYING_ALBEDO
    albedo: Tint,                   // of the ramp in the mean
#endif
    depths: array<f32, SUN_SLOTS>,  // optical depth towards each cached sun
#ifdef VDB_LAMP_LIGHT
    point: vec3<f32>,               // in the fog's lattice
#endif
#ifdef VDB_RAMPS
    emission: vec3<f32>,            // per world unit
#endif
}

// What of a fog every step needs.
struct FogTraits {
    extinction: f32,    // per unit of density and of t
    anisotropy: f32,
#ifndef VDB_VARYING_ALBEDO
    albedo: Tint,
#endif
}

fn fog_traits(volume: u32, dir_length: f32) -> FogTraits {
    var traits = FogTraits();
    traits.extinction = volumes[volume].density_scale * dir_length;
    traits.anisotropy = volumes[volume].anisotropy;
#ifndef VDB_VARYING_ALBEDO
    traits.albedo = tint(volumes[volume].base_color);
#endif
    return traits;
}

// The albedo of a fog in a step.
fn step_albedo(traits: FogTraits, step: FogStep) -> Tint {
#ifdef VDB_VARYING_ALBEDO
    return step.albedo;
#else
    return traits.albedo;
#endif
}

// A fog between two t, and when to look for it next: at the middle of the step if that is in the fog.
fn fog_step(
    medium: ptr<function, Medium>,
    accessor: ptr<function, Accessor>,
    t_low: f32,
    t_middle: f32,
    t_high: f32,
    dir_length: f32,
    traits: FogTraits,
) -> FogStep {
    var step = FogStep();
    let volume = (*medium).volume;
    let t_origin = (*medium).ray.t_origin;
    let found = sample_fog(fog_grid(volume), (*medium).ray, accessor, t_middle - t_origin);
    let is_in_box = t_middle < (*medium).t_last;
    (*medium).t_next = select(FAR, select(t_middle, t_origin + found.t_out, found.is_empty), is_in_box);
    if !found.is_empty && is_in_box {
        var density = found.density;
#ifdef VDB_VARYING_ALBEDO
        step.albedo = Tint(vec3(1.0));
#endif
#ifdef VDB_RAMPS
        if volumes[volume].ramp != 0u {
            density = ramp_step(&step, medium, accessor, t_low, density, t_high, dir_length);
        }
#endif
        // Per t. The largest densities would overflow.
        let extinction = traits.extinction;
        let max_density = MAX_DEPTH_OF_STEP / max(extinction * (t_high - t_low), 1e-30);
        step.extinction = extinction * min(density, max_density);
        let point = lattice_point(volume, found.point.cell, found.point.u);
#ifdef VDB_LAMP_LIGHT
        step.point = point;
#endif
        for (var slot = 0u; slot < SUN_COUNT; slot++) {
            step.depths[slot] = cached_sun_depth(point, volume, slot);
        }
    }
    return step;
}

#ifdef VDB_RAMPS
// Sets albedo and emission of a step through a fog with a ramp, given the value in the middle of the step, and
// returns its mean density.
fn ramp_step(
    step: ptr<function, FogStep>,
    medium: ptr<function, Medium>,
    accessor: ptr<function, Accessor>,
    t_low: f32,
    middle_value: f32,
    t_high: f32,
    dir_length: f32,
) -> f32 {
    let volume = (*medium).volume;
    let grid = grids[volumes[volume].grid];
    let ray = (*medium).ray;
    // Values are sampled at both ends, too, so that no shell between them is missed. Where the last step ends, the
    // value is known.
    let low = max(t_low, (*medium).t_first) - ray.t_origin;
    let high = min(t_high, (*medium).t_last) - ray.t_origin;
    var near = (*medium).value;
    if t_low > (*medium).t_known {
        near = sample_fog(grid, ray, accessor, low).density;
    }
    let far = sample_fog(grid, ray, accessor, high).density;
    (*medium).t_known = t_high;
    (*medium).value = far;
    let values = vec3(near, middle_value, far);
    // Where all values are 0 there is nothing, whatever the ramp says.
    let length = select(0.0, high - low, any(values > vec3(0.0)));
    let emission_length = length * dir_length * volumes[volume].ramp_emission;
    var sums = RampSums();
    let extinction = volumes[volume].density_scale * dir_length;
    add_stretch(&sums, fog_grid(volume), values, length * extinction, emission_length);
    let width = max(t_high - t_low, 0.0);
    let visible_length = mean_transmittance(sums.optical_depth) * width * dir_length;
    (*step).albedo = Tint(visible_albedo(sums));
    (*step).emission = sums.emitted / max(visible_length, 1e-30);
    return sums.optical_depth / max(width * extinction, 1e-30);
}
#endif

// Adds the light of cached suns that a step of an optical depth scatters, given the optical depth towards each.
fn add_suns(
    interval: ptr<function, IntervalSums>,
    volume: u32,
    phases: SunPhases,
    depth: f32,
    visible: Visible,
    gain: Tint,     // the exponential of `Visible::forward`
    sun_depths: array<f32, SUN_SLOTS>,
    albedo: Tint,
) {
    var depths = sun_depths;
    var of_suns = phases.suns;
    let scattered = (depth * visible.whole) * albedo.value;
#ifdef VDB_SCATTERED
    let rest = depth * visible.rest.value * albedo.value;
#else
    let colored = scattered * remaining_color(volumes[volume].base_color);
#endif
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        let phase = of_suns[slot];
        let sum = (*interval).suns[slot].light;
#ifdef VDB_SCATTERED
        let forward = forward_depth(depths[slot], albedo, phases.anisotropy);
        let own = arriving_light(depths[slot], forward, visible.forward, gain);
        let peak = phase.x * own.once + phase.y * own.twice.value + phase.z * own.often.value;
        (*interval).suns[slot] = SunSum(Tint(sum.value + scattered * peak + (phase.w * rest) * own.rest.value));
#else
        (*interval).suns[slot] = SunSum(sum + (phase * exp(-depths[slot])) * colored);
#endif
    }
}

// Adds a step to the sums of its fog for other lights.
fn add_for_others(sums: ptr<function, FogSums>, depth: f32, t: f32, visible: Visible, albedo: Tint) {
    let weight = depth * visible.whole;
    (*sums).weight += weight;
    (*sums).t += weight * t;
    (*sums).whole = Tint((*sums).whole.value + weight * albedo.value);
#ifdef VDB_SCATTERED
    (*sums).rest = Tint((*sums).rest.value + depth * visible.rest.value * albedo.value);
    (*sums).forward = Tint((*sums).forward.value + weight * visible.forward.value);
#endif
}

#ifdef VDB_LAMP_LIGHT
// The interpolated light of lamps that a step of an optical depth scatters, times the exposure.
fn step_lamp_light(
    point: vec3<f32>,
    lattice: u32,
    volume: u32,
    depth: f32,
    visible: Visible,
    gain: Tint,
    albedo: Tint,
) -> vec3<f32> {
    let scattered = depth * visible.whole * albedo.value;
    let once = cached_lamp_light(point, lattice, volume, 0u);
#ifdef VDB_SCATTERED
    let often = cached_lamp_light(point, lattice, volume, 1u);
    let rest = cached_lamp_light(point, lattice, volume, 2u);
    // The mean depth towards lamps, and what they scatter three times or more, relative to twice.
    let lamp_depth = max(once.w, 0.0);
    let forward = forward_depth(lamp_depth, albedo, volumes[volume].anisotropy);
    let own = arriving_light(lamp_depth, forward, visible.forward, gain);
    // In the lattice, light is attenuated by what is not scattered in the peak, so that it stays within 16 bits.
    let stored = 1.0 / max(own.rest.value, Tint().value + 1e-30);
    return scattered * stored
        * (own.once * once.rgb + (own.twice.value + often.w * own.often.value) * often.rgb)
        + (depth * visible.rest.value * albedo.value) * rest.rgb;
#else
    return scattered * once.rgb;
#endif
}
#endif

#ifdef VDB_EMISSION
// What a step through an emission grid adds to the radiance, given that so far; and when to look for the grid
// next. `visible_length` is the length of the step in world units times what is visible of it.
fn emitted_in_step(
    medium: ptr<function, Medium>,
    accessor: ptr<function, Accessor>,
    t_low: f32,
    t_high: f32,
    visible_length: f32,
    radiance: vec3<f32>,
) -> vec3<f32> {
    let volume = (*medium).volume;
    let grid = grids[volumes[volume].grid];
    let t_origin = (*medium).ray.t_origin;
    let step = EmissionStep(
        t_low - t_origin,
        t_high - t_origin,
        (*medium).t_first - t_origin,
        (*medium).t_last - t_origin,
        view.exposure * visible_length,
        view.exposure * max3(radiance),
    );
    let emitted = visible_length * sampled_emission(volume, grid, (*medium).ray, accessor, step);
    let probe = probe_fog(grid, (*medium).ray, accessor, t_high - t_origin);
    let t_next = select(t_high, max(t_origin + probe.t_out, t_high), probe.is_empty);
    (*medium).t_next = select(FAR, t_next, t_high < (*medium).t_last);
    return emitted;
}
#endif
