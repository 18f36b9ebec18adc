// Sums over the media along a segment. Light that is costly is evaluated once per interval of several steps, at
// the mean position of what is visible.
#define_import_path bevy_vdb::trace::intervals

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::fog_march::{light_around, light_interval}
#import bevy_vdb::trace::medium::{MAX_FOGS, Medium}
#import bevy_vdb::trace::scattering::{ScatteringSums, add_environment}
#import bevy_vdb::trace::segment::Segment
#import bevy_vdb::trace::shared_light::{FogPoint, FogSums, HAS_OCCLUDERS, HAS_OTHER_LIGHTS, HAS_VARYING_ALBEDO}
#import bevy_vdb::trace::shared_light::{SharedLight, begin_interval, interval_light}
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
    fogs: array<FogSums, MAX_FOGS>,
#ifdef VDB_SCATTERED
    scattered: vec3<f32>,   // light from lattices of scattered light, of all fogs
#endif
}

// Sums over a segment.
struct SegmentSums {
    weight: f32,
    t: f32,
    scattering: ScatteringSums,
    fogs: array<f32, MAX_FOGS>,     // weights
}

// If false, light varies along a ray only through the cache of suns, which is read at every step.
const HAS_INTERVALS: bool = HAS_OCCLUDERS || HAS_OTHER_LIGHTS;
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
        voxels = SAMPLES_OF_INTERVAL * exp2(f32(volumes[volume].light_log));
    }
    if HAS_OCCLUDERS {
        voxels = min(voxels, light_interval(segment, volume));
    }
    return voxels;
}

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
    var scattering = (*sums).scattering;
    var unoccluded = 0.0;   // the mean over fogs, times the weight
    for (var i = 0u; i < fog_count; i++) {
        let own = (*interval).fogs[i];
        if own.weight > 0.0 {
            let volume = (*fogs)[i].volume;
            let t = own.t / own.weight;
            let grid = grids[volumes[volume].grid];
            let place = point_in_box(grid, (*fogs)[i].ray, t - (*fogs)[i].ray.t_origin);
            let extent = (*interval).width * length(segment.dir);
            let at = FogPoint(volume, place, min(t_zero + t, t_max), extent, is_near_lamps);
            let light = interval_light(shared_light, segment, pixel, at, own);
            scattering.radiance += light.radiance;
            unoccluded += own.weight * light.visibility;
            let anisotropy = volumes[volume].anisotropy;
            let around = light_around((*shared_light).environment, anisotropy);
            var albedo = volumes[volume].base_color;
            if HAS_VARYING_ALBEDO {
                albedo = vec3(own.whole.value / own.weight);
            }
            add_environment(&scattering, own.weight, albedo, around, anisotropy);
            (*sums).fogs[i] += own.weight;
        }
    }
#ifdef VDB_SCATTERED
    scattering.radiance += unoccluded / (*interval).weight * (*interval).scattered;
#endif
    (*sums).scattering = scattering;
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
fn flush_near_lamps(t_flush: f32, t_begin: f32, near: vec2<f32>) -> f32 {
    return select(max(t_flush, near.x), FAR, t_begin >= near.y);
}
#endif
