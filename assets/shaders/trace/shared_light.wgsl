// In-scattered light at samples of fog in the light cache. What varies slowly along the ray is evaluated once
// per interval.
#define_import_path bevy_vdb::trace::shared_light

#ifdef VDB_CACHED_LAMPS
#import bevy_vdb::trace::cached_lights::add_cached_lamps
#endif
#ifdef VDB_OTHER_LIGHTS
#import bevy_vdb::trace::cached_lights::add_other_lights
#endif
#import bevy_vdb::trace::cached_lights::{CachedSun, LocalLight, cached_sun, unoccluded}
#import bevy_vdb::trace::lights::{EnvironmentLight, environment_light, light_cosine, shading_point}
#import bevy_vdb::trace::scattering::{InScattered, Scatterer, Tint}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattering::{add_occlusion, split_phases}
#else
#import bevy_vdb::trace::scattering::phase
#endif
#import bevy_vdb::trace::segment::{Segment, point_at}
#import bevy_vdb::traversal::fog::SamplePoint
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::{view, volumes}

const SUN_COUNT: u32 = #{VDB_CACHED_SUNS}u;
// Arrays are not empty even if only other lights are in the cache.
const SUN_SLOTS: u32 = max(SUN_COUNT, 1u);

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
// Sums over the steps of one fog in an interval, for lights other than cached suns.
struct FogSums {
    weight: f32,            // fraction of the pixel that the steps cover
    t: f32,                 // times the weight
    whole: Tint,            // weight times albedo
#ifdef VDB_SCATTERED
    rest: Tint,             // the same for light that was scattered outside of the forward peak
    forward: Tint,          // `Visible::forward` times the weight
#endif
}

// Phase functions of a fog for each cached sun, for a direction of view.
struct SunPhases {
    anisotropy: f32,
#ifdef VDB_SCATTERED
    suns: array<vec4<f32>, SUN_SLOTS>,      // as `split_phases` returns them
#else
    suns: array<f32, SUN_SLOTS>,
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

fn sun_phases(dir: vec3<f32>, anisotropy: f32) -> SunPhases {
    var phases = SunPhases();
    phases.anisotropy = anisotropy;
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        let cosine = light_cosine(view.cached_suns[slot].xyz, dir);
#ifdef VDB_SCATTERED
        phases.suns[slot] = split_phases(anisotropy, cosine);
#else
        phases.suns[slot] = phase(anisotropy, cosine);
#endif
    }
    return phases;
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

// Light of others than the cached suns at the mean position of the steps of a fog in the interval.
fn other_light(segment: Segment, pixel: vec2<u32>, at: FogPoint, sums: FogSums) -> LocalLight {
    var light = LocalLight(InScattered(), FAR);
    let ray = normalize(segment.dir);
    var scatterer = Scatterer();
    scatterer.anisotropy = volumes[at.volume].anisotropy;
    scatterer.albedo = Tint(sums.whole.value / sums.weight);
#ifdef VDB_SCATTERED
    scatterer.forward = Tint(sums.forward.value / sums.weight);
#endif
    let point = point_at(segment, at.t);
    let shaded = shading_point(point, vec3(0.0), pixel, segment.is_view);
#ifdef VDB_CACHED_LAMPS
    if at.is_near_lamps {
        add_cached_lamps(&light, shaded, point, ray, at.extent, scatterer, at.volume, at.place);
    }
#endif
#ifdef VDB_OTHER_LIGHTS
    add_other_lights(&light, shaded, point, ray, at.extent, scatterer, at.volume);
#endif
    return light;
}

#ifdef VDB_SCATTERED
// The illuminance of the cached suns in this interval, and what surfaces and meshes let through of it.
fn sun_occlusion(shared_light: ptr<function, SharedLight>) -> InScattered {
    var light = InScattered();
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        add_occlusion(&light, (*shared_light).suns[slot].illuminance, (*shared_light).visibility[slot]);
    }
    return light;
}

// The fraction of the illuminance that surfaces and meshes let through.
fn let_through(light: InScattered) -> f32 {
    return select(1.0, light.unoccluded / max(light.all, 1e-30), light.all > 0.0);
}
#endif
