// In-scattered light at samples of fog in the light cache. What varies slowly along the ray is evaluated once
// per interval.
#define_import_path bevy_vdb::trace::shared_light

#import bevy_vdb::trace::fog_march::with_environment
#ifdef VDB_UNCACHED_LIGHTS
#import bevy_vdb::trace::fog_march::in_scattered_at
#endif
#import bevy_vdb::trace::lights::{CachedSun, EnvironmentLight, cached_sun, environment_light, shading_point}
#import bevy_vdb::trace::lights::{sun_phases, unoccluded}
#import bevy_vdb::trace::scattering::{InScattered, OCTAVES}
#import bevy_vdb::trace::segment::{Segment, point_at}

const SUN_COUNT: u32 = #{VDB_CACHED_SUNS}u;

// What fog lets through of each cached light, in each octave.
struct CachedLight {
    slots: array<array<f32, OCTAVES>, SUN_COUNT>,
}

// The light along a ray.
struct SharedLight {
    dir: vec3<f32>,                         // of the ray, world space, unit length
    environment: EnvironmentLight,
    suns: array<CachedSun, SUN_COUNT>,
    visibility: array<f32, SUN_COUNT>,      // what surfaces and meshes let through, in this interval
    is_evaluated: bool,                     // whether `light` is of this interval
    light: InScattered,                     // of everything but the cached lights
}

fn begin_light(dir: vec3<f32>) -> SharedLight {
    var shared_light = SharedLight();
    shared_light.dir = dir;
    shared_light.environment = environment_light(dir);
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        shared_light.suns[slot] = cached_sun(slot);
    }
    return shared_light;
}

// Evaluates what surfaces and meshes let through at t.
fn begin_interval(shared_light: ptr<function, SharedLight>, segment: Segment, pixel: vec2<u32>, t: f32) {
    (*shared_light).is_evaluated = false;
    let point = point_at(segment, t);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        (*shared_light).visibility[slot] = unoccluded(at, point, (*shared_light).suns[slot].light);
    }
}

// Mean light over the steps of a fog in the interval. `cached` are sums over these steps; `factor` turns them
// into means.
fn mean_light(
    shared_light: ptr<function, SharedLight>,
    segment: Segment,
    pixel: vec2<u32>,
    t: f32,
    anisotropy: f32,
    cached: CachedLight,
    factor: f32,
) -> InScattered {
    let environment = (*shared_light).environment;
#ifdef VDB_UNCACHED_LIGHTS
    // Fogs with the same phase function share their rays to the lights.
    if !(*shared_light).is_evaluated || (*shared_light).light.anisotropy != anisotropy {
        (*shared_light).light = in_scattered_at(segment, pixel, t, anisotropy, environment, true);
        (*shared_light).is_evaluated = true;
    }
    var light = (*shared_light).light;
#else
    var light = with_environment(array<vec3<f32>, OCTAVES>(), environment, anisotropy);
#endif
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        let phases = sun_phases(slot, (*shared_light).dir, anisotropy);
        var octave_visibility = (*shared_light).visibility[slot];
        for (var octave = 0u; octave < OCTAVES; octave++) {
            light.octaves[octave] += (factor * octave_visibility * cached.slots[slot][octave] * phases[octave])
                * (*shared_light).suns[slot].illuminance;
            octave_visibility = sqrt(octave_visibility);
        }
    }
    return light;
}
