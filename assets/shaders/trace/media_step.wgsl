// One step of the march through several media: what it finds in each, and what each adds to the sums of the
// interval. Every t is relative to where the march begins.
#define_import_path bevy_vdb::trace::media_step

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::intervals::FogSums
#import bevy_vdb::trace::light_cache::{cached_sun_depth, lattice_point}
#import bevy_vdb::trace::medium::Medium
#import bevy_vdb::trace::scattering::{OCTAVES, octaves_of_depth}
#import bevy_vdb::trace::shared_light::{SUN_COUNT, SUN_SLOTS}
#import bevy_vdb::traversal::fog::sample_fog
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::{fog_grid, volumes}
#ifdef VDB_RAMPS
#import bevy_vdb::trace::ramp_light::{RampSums, add_stretch, visible_albedo}
#import bevy_vdb::trace::scattering::mean_transmittance
#import bevy_vdb::traversal::tree::Accessor
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
    is_inside: bool,                // whether the middle of the step is in the fog
    extinction: f32,                // per t
    depths: array<f32, SUN_SLOTS>,  // optical depth towards each cached sun
#ifdef VDB_LAMP_LIGHT
    point: vec3<f32>,               // in the fog's lattice
#endif
#ifdef VDB_RAMPS
    albedo: vec3<f32>,              // the ramp's, in the mean
    emission: vec3<f32>,            // per world unit
#endif
}

// A fog between two t, and when to look for it next.
fn fog_step(medium: ptr<function, Medium>, t_low: f32, t_middle: f32, t_high: f32, dir_length: f32) -> FogStep {
    var step = FogStep();
    let volume = (*medium).volume;
    let t_origin = (*medium).ray.t_origin;
    var accessor = (*medium).accessor;
    let found = sample_fog(fog_grid(volume), (*medium).ray, &accessor, t_middle - t_origin);
    let is_in_box = t_middle < (*medium).t_last;
    (*medium).t_next = select(FAR, select(t_middle, t_origin + found.t_out, found.is_empty), is_in_box);
    step.is_inside = !found.is_empty && is_in_box;
    if step.is_inside {
        var density = found.density;
#ifdef VDB_RAMPS
        step.albedo = vec3(1.0);
        if volumes[volume].ramp != 0u {
            density = ramp_step(&step, medium, &accessor, t_low, density, t_high, dir_length);
        }
#endif
        step.extinction = (*medium).extinction * min(density, (*medium).max_density);
        let point = lattice_point(volume, found.point.cell, found.point.u);
#ifdef VDB_LAMP_LIGHT
        step.point = point;
#endif
        for (var slot = 0u; slot < SUN_COUNT; slot++) {
            step.depths[slot] = cached_sun_depth(point, volume, slot);
        }
    }
    (*medium).accessor = accessor;
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
    let low = max(t_low - ray.t_origin, ray.t_first);
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
    add_stretch(&sums, fog_grid(volume), values, length * (*medium).extinction, emission_length);
    let width = max(t_high - t_low, 0.0);
    let visible_length = mean_transmittance(sums.optical_depth) * width * dir_length;
    (*step).albedo = visible_albedo(sums);
    (*step).emission = sums.emitted / max(visible_length, 1e-30);
    return sums.optical_depth / max(width * (*medium).extinction, 1e-30);
}
#endif

// Adds a step to the sums of a fog, given the step's weight in each octave and the optical depth towards each
// cached sun.
fn add_step(
    sums: ptr<function, FogSums>,
    volume: u32,
    octave_weights: array<f32, OCTAVES>,
    sun_depths: array<f32, SUN_SLOTS>,
#ifdef VDB_VARYING_ALBEDO
    albedo: vec3<f32>,
#endif
) {
    var weights = octave_weights;
    var depths = sun_depths;
    for (var octave = 0u; octave < OCTAVES; octave++) {
        (*sums).weights[octave] += weights[octave];
#ifdef VDB_VARYING_ALBEDO
        (*sums).scattered[octave] += weights[octave] * albedo;
#endif
    }
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        var arriving = octaves_of_depth(depths[slot], volumes[volume].anisotropy);
        for (var octave = 0u; octave < OCTAVES; octave++) {
#ifdef VDB_VARYING_ALBEDO
            (*sums).light.slots[slot][octave] += weights[octave] * arriving[octave] * albedo;
#else
            (*sums).light.slots[slot][octave] += weights[octave] * arriving[octave];
#endif
        }
    }
}

#ifdef VDB_LAMP_LIGHT
// Adds the interpolated light of lamps that a step scatters: in each octave, times the exposure.
fn add_lamp_light(
    sums: ptr<function, array<vec3<f32>, OCTAVES>>,
    point: vec3<f32>,
    lattice: u32,
    volume: u32,
    octave_weights: array<f32, OCTAVES>,
    albedo: vec3<f32>,
) {
    var weights = octave_weights;
    for (var octave = 0u; octave < OCTAVES; octave++) {
        let light = cached_lamp_light(point, lattice, volume, octave);
        (*sums)[octave] += weights[octave] * albedo * light;
    }
}
#endif

#ifdef VDB_EMISSION
// What a step through an emission grid adds to the radiance, given that so far; and when to look for the grid
// next. `visible_length` is the length of the step in world units times what is visible of it.
fn emitted_in_step(
    medium: ptr<function, Medium>,
    t_low: f32,
    t_high: f32,
    visible_length: f32,
    radiance: vec3<f32>,
) -> vec3<f32> {
    let volume = (*medium).volume;
    let grid = grids[volumes[volume].grid];
    let t_origin = (*medium).ray.t_origin;
    var accessor = (*medium).accessor;
    let step = EmissionStep(
        t_low - t_origin,
        t_high - t_origin,
        view.exposure * visible_length,
        view.exposure * max3(radiance),
    );
    let emitted = visible_length * sampled_emission(volume, grid, (*medium).ray, &accessor, step);
    let probe = probe_fog(grid, (*medium).ray, &accessor, t_high - t_origin);
    (*medium).accessor = accessor;
    let t_next = select(t_high, max(t_origin + probe.t_out, t_high), probe.is_empty);
    (*medium).t_next = select(FAR, t_next, t_high < (*medium).t_last);
    return emitted;
}
#endif
