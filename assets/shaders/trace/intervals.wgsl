// Sums over the media along a segment. Light that is costly is evaluated once per interval of several steps, at
// the mean position of what is visible.
#define_import_path bevy_vdb::trace::intervals

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::fog_march::light_interval
#import bevy_vdb::trace::medium::{MAX_FOGS, Medium, step_of_voxels}
#import bevy_vdb::trace::scattering::{ScatteringSums, Tint, remaining_color}
#import bevy_vdb::trace::segment::Segment
#import bevy_vdb::trace::shared_light::{FogPoint, FogSums, HAS_OCCLUDERS, HAS_OTHER_LIGHTS, SUN_COUNT, SUN_SLOTS}
#import bevy_vdb::trace::shared_light::{SharedLight, begin_interval, other_light}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::shared_light::{let_through, sun_occlusion}
#endif
#import bevy_vdb::traversal::fog::point_in_box
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::volumes
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::trace::cached_lights::range_near_lamps
#import bevy_vdb::trace::segment::{point_at, world_position}
#endif

// Sums over an interval. What is interpolated is read at every step: depths towards cached suns, scattered light, and
// the light of lamps. All else is evaluated once per interval.
struct IntervalSums {
    width: f32,     // in t
    weight: f32,
    t: f32,
    suns: array<SunSum, SUN_SLOTS>,
    fogs: array<FogSums, OTHER_SLOTS>,
#ifdef VDB_SCATTERED
    scattered: vec3<f32>,   // light from lattices of scattered light, of all fogs
#endif
}

// What all fogs scatter towards the viewer, for an illuminance of 1 from a cached sun.
struct SunSum {
#ifdef VDB_SCATTERED
    light: Tint,
#else
    light: vec3<f32>,
#endif
}

// Sums over a segment.
struct SegmentSums {
    weight: f32,
    t: f32,
    scattering: ScatteringSums,
    fogs: array<f32, MAX_FOGS>,     // weights
#ifdef VDB_VARYING_ALBEDO
    albedos: array<vec3<f32>, MAX_FOGS>,    // times the weights
#endif
#ifdef VDB_LAMP_LIGHT
    lamp_light: vec3<f32>,          // of lamps, times the exposure
#endif
#ifdef VDB_EMITS
    emitted: vec3<f32>,
    emitted_weight: f32,            // the sum of its channels
    t_emitted: f32,                 // t times the weight
#endif
}

// Where an interval begins and ends. Every t is relative to where the march begins.
struct IntervalBounds {
    t_end: f32,
    t_longest: f32,                 // the length of intervals before anything attenuates the view ray, far from lamps
#ifdef VDB_LAMP_LIGHT
    t_begin: f32,
    near: vec2<f32>,                // see `near_lamps`
#endif
}

// If false, light varies along a ray only through the cache of suns, which is read at every step.
const HAS_INTERVALS: bool = HAS_OCCLUDERS || HAS_OTHER_LIGHTS;
// Only lights other than cached suns are evaluated for each fog.
const OTHER_SLOTS: u32 = select(1u, MAX_FOGS, HAS_OTHER_LIGHTS);
// Intervals are at most this fraction of the distance to a lamp.
const LAMP_INTERVAL: f32 = 0.25;
// The shortest interval near lamps, as a fraction of the longest.
const MIN_INTERVAL: f32 = 0.015625;
// The longest interval in samples of the cache: other lights are assumed to vary as smoothly as its depths.
const SAMPLES_OF_INTERVAL: f32 = 2.5;

fn next_multiple(t: f32, factor: f32) -> f32 {
    return (floor(t / factor) + 1.0) * factor;
}

// The longest interval of a fog in dense parts, in voxels.
fn interval_voxels(segment: Segment, volume: u32) -> f32 {
    var voxels = FAR;
    if HAS_OTHER_LIGHTS {
        voxels = SAMPLES_OF_INTERVAL / volumes[volume].light_scale;
    }
    if HAS_OCCLUDERS {
        voxels = min(voxels, light_interval(segment, volume));
    }
    return voxels;
}

// The first interval is short, because a lamp may be near.
fn first_bounds(
    segment: Segment,
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    t_zero: f32,
    t_begin: f32,
) -> IntervalBounds {
    var bounds = IntervalBounds();
    bounds.t_longest = FAR;
    if HAS_INTERVALS {
        for (var i = 0u; i < fog_count; i++) {
            let voxels = interval_voxels(segment, (*fogs)[i].volume);
            bounds.t_longest = min(bounds.t_longest, step_of_voxels((*fogs)[i], voxels));
        }
    }
#ifdef VDB_LAMP_LIGHT
    bounds.near = near_lamps(segment, fogs, fog_count, t_zero);
#endif
    return next_bounds(bounds, 0.25 * bounds.t_longest, t_zero, t_begin, t_begin);
}

// The interval that begins at `t_begin`, if there is nothing before `t_near`. It ends at a multiple of `t_length`, so
// that neighbouring rays evaluate light in the same iteration.
fn next_bounds(bounds: IntervalBounds, t_length: f32, t_zero: f32, t_begin: f32, t_near: f32) -> IntervalBounds {
    var next = bounds;
    next.t_end = next_multiple(t_zero + max(t_begin, t_near), t_length) - t_zero;
#ifdef VDB_LAMP_LIGHT
    next.t_begin = t_begin;
    next.t_end = end_near_lamps(next.t_end, t_begin, bounds.near);
#endif
    return next;
}

// Whether some of the lamps' light has to be evaluated for an interval that ends at `t_end`.
fn was_near_lamps(bounds: IntervalBounds, t_end: f32) -> bool {
#ifdef VDB_LAMP_LIGHT
    return bounds.near.x < t_end && bounds.near.y > bounds.t_begin;
#else
    return true;
#endif
}

#ifdef VDB_EMITS
// Adds the radiance that media emit at `t`.
fn add_emitted(sums: ptr<function, SegmentSums>, emitted: vec3<f32>, t: f32) {
    let weight = dot(emitted, vec3(1.0));
    (*sums).emitted += emitted;
    (*sums).emitted_weight += weight;
    (*sums).t_emitted += weight * t;
}
#endif

// Adds an interval to the sums of its segment, with the light at the mean position of what is visible. Every
// t of the media and the sums is relative to `t_zero`.
fn add_interval(
    segment: Segment,
    pixel: vec2<u32>,
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    t_zero: f32,
    t_max: f32,
    shared_light: ptr<function, SharedLight>,
    interval: ptr<function, IntervalSums>,
    is_near_lamps: bool,
    sums: ptr<function, SegmentSums>,
) {
    let t_mean = (*interval).t / (*interval).weight;
    begin_interval(shared_light, segment, pixel, min(t_zero + t_mean, t_max));
    var radiance = vec3(0.0);
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        let illuminance = (*shared_light).visibility[slot] * (*shared_light).suns[slot].illuminance;
#ifdef VDB_SCATTERED
        radiance += illuminance * (*interval).suns[slot].light.value;
#else
        radiance += illuminance * (*interval).suns[slot].light;
#endif
    }
#ifdef VDB_SCATTERED
    let suns = sun_occlusion(shared_light);
    var visibility = let_through(suns);
    var visible_weight = 0.0;
#endif
    if HAS_OTHER_LIGHTS {
        for (var i = 0u; i < fog_count; i++) {
            let own = (*interval).fogs[i];
            if own.weight > 0.0 {
                let volume = (*fogs)[i].volume;
                let t = own.t / own.weight;
                let grid = grids[volumes[volume].grid];
                let place = point_in_box(grid, (*fogs)[i].ray, t - (*fogs)[i].ray.t_origin);
                let extent = (*interval).width * length(segment.dir);
                let at = FogPoint(volume, place, min(t_zero + t, t_max), extent, is_near_lamps);
                let others = other_light(segment, pixel, at, own);
                (*shared_light).nearest = min((*shared_light).nearest, others.nearest);
                var scattered = own.whole.value * others.light.whole;
#ifdef VDB_SCATTERED
                scattered += own.rest.value * others.light.rest;
                var light = suns;
                light.all += others.light.all;
                light.unoccluded += others.light.unoccluded;
                visible_weight += own.weight * let_through(light);
#endif
                radiance += scattered * remaining_color(volumes[volume].base_color);
            }
        }
#ifdef VDB_SCATTERED
        visibility = visible_weight / (*interval).weight;
#endif
    }
#ifdef VDB_SCATTERED
    radiance += visibility * (*interval).scattered;
#endif
    (*sums).scattering.radiance += radiance;
    (*sums).weight += (*interval).weight;
    (*sums).t += (*interval).t;
    *interval = IntervalSums();
}

#ifdef VDB_LAMP_LIGHT
// Between which t, relative to `t_zero`, some of the lamps' light has to be evaluated in intervals.
fn near_lamps(
    segment: Segment,
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    t_zero: f32,
) -> vec2<f32> {
    let dir_length = length(segment.dir);
    let origin = world_position(point_at(segment, t_zero));
    var near = vec2(FAR, -FAR);
    for (var i = 0u; i < fog_count; i++) {
        let range = range_near_lamps(origin, segment.dir / dir_length, (*fogs)[i].volume);
        near = vec2(min(near.x, range.x / dir_length), max(near.y, range.y / dir_length));
    }
#ifdef VDB_OTHER_LIGHTS
    return vec2(-FAR, FAR);
#else
    return near;
#endif
}

// Where the next interval ends, given where it would end if lamps were near everywhere, and where it begins.
fn end_near_lamps(t_end: f32, t_begin: f32, near: vec2<f32>) -> f32 {
    return select(max(t_end, near.x), FAR, t_begin >= near.y);
}
#endif
