// In-scattered light at samples of fog in the light cache. What varies slowly along the ray is evaluated once
// per interval.
#define_import_path bevy_vdb::trace::shared_light

#import bevy_vdb::trace::fog_march::with_environment
#ifdef VDB_CACHED_LAMPS
#import bevy_vdb::trace::cached_lights::add_cached_lamps
#endif
#ifdef VDB_OTHER_LIGHTS
#import bevy_vdb::trace::cached_lights::add_other_lights
#endif
#import bevy_vdb::trace::cached_lights::{CachedSun, LocalLight, cached_sun, sun_phases, unoccluded}
#import bevy_vdb::trace::lights::{EnvironmentLight, depth_of, environment_light, shading_point}
#import bevy_vdb::trace::scattering::{InScattered, OCTAVES, octave_transmittances}
#import bevy_vdb::trace::segment::{Segment, point_at}
#import bevy_vdb::traversal::fog::SamplePoint
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::volumes

const SUN_COUNT: u32 = #{VDB_CACHED_SUNS}u;
// Arrays are not empty even if only other lights are in the cache.
const SUN_SLOTS: u32 = max(SUN_COUNT, 1u);

// What fog lets through of each cached sun, in each octave; where the albedo varies, times the albedo.
struct CachedLight {
#ifdef VDB_VARYING_ALBEDO
    slots: array<array<vec3<f32>, OCTAVES>, SUN_SLOTS>,
#else
    slots: array<array<f32, OCTAVES>, SUN_SLOTS>,
#endif
}

// The light along a ray.
struct SharedLight {
    dir: vec3<f32>,                         // of the ray, world space, unit length
    environment: EnvironmentLight,
    suns: array<CachedSun, SUN_SLOTS>,
    visibility: array<f32, SUN_SLOTS>,      // what surfaces and meshes let through, in this interval
    nearest: f32,                           // distance to the nearest lamp, in this interval
}

// A point of a segment in a fog.
struct FogPoint {
    volume: u32,
    place: SamplePoint, // in the fog's lattice
    t: f32,
    extent: f32,        // of the interval, world units
    is_near_lamps: bool,    // whether not all light of cached lamps is interpolated
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
    let point = point_at(segment, t);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        (*shared_light).visibility[slot] = unoccluded(at, point, (*shared_light).suns[slot].light);
    }
    (*shared_light).nearest = FAR;
}

// Mean light over the steps of a fog in the interval, whose mean position is `fog_point`. `cached` are sums
// over these steps, with the weights of the octaves; `weights` are the sums of those weights. Where the albedo
// varies, both include it, so that the mean is over what is scattered.
fn mean_light(
    shared_light: ptr<function, SharedLight>,
    segment: Segment,
    pixel: vec2<u32>,
    fog_point: FogPoint,
    cached: CachedLight,
#ifdef VDB_VARYING_ALBEDO
    weights: array<vec3<f32>, OCTAVES>,
#else
    weights: array<f32, OCTAVES>,
#endif
) -> InScattered {
    var totals = weights;
    let ray = (*shared_light).dir;
    let anisotropy = volumes[fog_point.volume].anisotropy;
    let point = point_at(segment, fog_point.t);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    var others = LocalLight(array<vec3<f32>, OCTAVES>(), FAR);
#ifdef VDB_CACHED_LAMPS
    if fog_point.is_near_lamps {
        let place = fog_point.place;
        add_cached_lamps(&others, at, point, ray, fog_point.extent, anisotropy, fog_point.volume, place);
    }
#endif
#ifdef VDB_OTHER_LIGHTS
    add_other_lights(&others, at, point, ray, fog_point.extent, anisotropy, fog_point.volume);
#endif
    (*shared_light).nearest = min((*shared_light).nearest, others.nearest);
    var light = with_environment(others.octaves, (*shared_light).environment, anisotropy);
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        var phases = sun_phases(slot, ray, anisotropy);
        var let_through = octave_transmittances(depth_of((*shared_light).visibility[slot]), anisotropy);
        for (var octave = 0u; octave < OCTAVES; octave++) {
#ifdef VDB_VARYING_ALBEDO
            let total = max(totals[octave], vec3(1e-30));
#else
            let total = max(totals[octave], 1e-30);
#endif
            let visible = let_through[octave] * cached.slots[slot][octave] / total;
            light.octaves[octave] += (visible * phases[octave]) * (*shared_light).suns[slot].illuminance;
        }
    }
    return light;
}
