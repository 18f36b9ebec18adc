// In-scattered light at samples of fog in the light cache. What varies slowly along the ray is evaluated once
// per interval.
#define_import_path bevy_vdb::trace::shared_light

#import bevy_vdb::trace::fog_march::with_environment
#ifdef VDB_UNCACHED_LIGHTS
#import bevy_vdb::trace::fog_march::in_scattered_at
#endif
#import bevy_vdb::trace::light_cache::cached_depth
#import bevy_vdb::trace::lights::{CachedSun, EnvironmentLight, cached_sun, shading_point, sun_phases}
#import bevy_vdb::trace::lights::unoccluded
#import bevy_vdb::trace::scattering::{InScattered, OCTAVES}
#import bevy_vdb::trace::segment::{Segment, point_at}
#import bevy_vdb::traversal::fog::SamplePoint

const SUN_COUNT: u32 = #{VDB_CACHED_SUNS}u;

struct SharedLight {
    light: InScattered,                     // of everything but the lights in the cache
    visibility: array<f32, SUN_COUNT>,      // of the cached lights: what surfaces and meshes let through
    suns: array<CachedSun, SUN_COUNT>,
    t_next: f32,                            // where the next interval begins
}

// The light along a ray (world space, unit length) through fog, before the first interval.
fn begin_light(dir: vec3<f32>, environment: EnvironmentLight, anisotropy: f32) -> SharedLight {
    var shared_light = SharedLight();
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        shared_light.suns[slot] = cached_sun(slot);
    }
    set_anisotropy(&shared_light, dir, environment, anisotropy);
    return shared_light;
}

// Evaluates what depends on the phase function, and ends the interval.
fn set_anisotropy(
    shared_light: ptr<function, SharedLight>,
    dir: vec3<f32>,
    environment: EnvironmentLight,
    anisotropy: f32,
) {
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        (*shared_light).suns[slot].phases = sun_phases(slot, dir, anisotropy);
    }
    (*shared_light).light = with_environment(array<vec3<f32>, OCTAVES>(), environment, anisotropy);
    (*shared_light).t_next = -1.0;
}

// Evaluates the light in the middle of the interval that begins at t.
fn begin_interval(
    shared_light: ptr<function, SharedLight>,
    segment: Segment,
    pixel: vec2<u32>,
    t: f32,
    t_interval: f32,
    t_max: f32,
    environment: EnvironmentLight,
) {
    (*shared_light).t_next = t + t_interval;
    let t_middle = min(t + 0.5 * t_interval, t_max);
#ifdef VDB_UNCACHED_LIGHTS
    let anisotropy = (*shared_light).light.anisotropy;
    (*shared_light).light = in_scattered_at(segment, pixel, t_middle, anisotropy, environment, true);
#endif
    let point = point_at(segment, t_middle);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        (*shared_light).visibility[slot] = unoccluded(at, point, (*shared_light).suns[slot].light);
    }
}

// Light at a sample of a fog.
fn light_at_sample(shared_light: SharedLight, volume: u32, sample: SamplePoint) -> InScattered {
    var light = shared_light.light;
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        let towards_sun = cached_depth(volume, slot, sample.cell, sample.u);
        var octave_visibility = shared_light.visibility[slot] * exp(-towards_sun);
        for (var octave = 0u; octave < OCTAVES; octave++) {
            light.octaves[octave] += (octave_visibility * shared_light.suns[slot].phases[octave])
                * shared_light.suns[slot].illuminance;
            octave_visibility = sqrt(octave_visibility);
        }
    }
    return light;
}
