// One fog along a segment: its optical depth and the light that it sends.
#define_import_path bevy_vdb::trace::fog_march

#ifdef VDB_LIT
#import bevy_vdb::view::scene::{frame_random, view, volumes}
#import bevy_vdb::trace::segment::{Segment, lattice_ray, point_at}
#import bevy_vdb::trace::lights::{EnvironmentLight, environment_light, in_scattered, shading_point}
#import bevy_vdb::trace::scattering::{ScatteringSums, InScattered, OCTAVES, add_sample, scattered_radiance}
#ifndef VDB_EVEN_LIGHT
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::traversal::hdda::{enter_at, local_cell, mirrored_ray}
#import bevy_vdb::traversal::march::{begin_march, next_interval, visible_mean_t, scaled_step}
#import bevy_vdb::traversal::tree::new_accessor
#ifdef VDB_LIGHT_CACHE
#import bevy_vdb::trace::light_cache::{cached_depth, has_light_cache}
#import bevy_vdb::trace::lights::{CachedSun, cached_sun, unoccluded}
#import bevy_vdb::traversal::fog::{begin_steps, next_step, stride_at}
#endif
#endif
#endif

// Optical depth beyond which nothing is visible: e^-16 is 1/4,000 of the step of 16-bit floats near 1.
const OPAQUE_DEPTH: f32 = 16.0;

// Above this many voxels along the longest edge of a fog's box, the intervals that share one lighting sample
// become longer in proportion.
const LIGHT_EDGE: f32 = 128.0;
// In reflections, intervals are longer by this factor, because every interval evaluates every light.
const REFLECTED_STEP_FACTOR: u32 = 4u;

#ifdef VDB_LIGHT_CACHE
// The shortest step of ray marching, in voxels.
const MIN_STEP: f32 = 0.25;
const SUN_COUNT: u32 = #{VDB_CACHED_SUNS}u;
#endif

struct Fog {
    radiance: vec3<f32>,
    optical_depth: f32,
    t_first: f32,
    // Mean t of the visible fog, weighted by visibility. With several slabs, `motion_volume` is the volume
    // that contributes most to what is visible.
    t_mean: f32,
    motion_volume: u32,
}

#ifdef VDB_LIT
#ifndef VDB_EVEN_LIGHT
// One fog of a segment, under lighting that varies along it.
fn march_fog(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
#ifdef VDB_LIGHT_CACHE
    if has_light_cache(volume) {
        return march_cached(segment, volume, pixel, t_first, t_max);
    }
#endif
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    var t_sum = 0.0;
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let entry = enter_at(mirrored, start_t(segment, volume, pixel));
    let scale = volumes[volume].density_scale * length(segment.dir);
    let max_integral = 100.0 / max(scale, 1e-30);
    let anisotropy = volumes[volume].anisotropy;
    let environment = environment_light(normalize(segment.dir));
    let step = volumes[volume].light_step * select(f32(REFLECTED_STEP_FACTOR), 1.0, segment.is_view);
    var sums = ScatteringSums();
    var march = begin_march(mirrored, entry, scaled_step(grid, step, LIGHT_EDGE));
    march.t_box -= frame_random(0.41421356) * march.t_step;
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    while march.dda.inside && fog.optical_depth <= OPAQUE_DEPTH {
        let interval = next_interval(grid, mirrored, &march, &accessor, max_integral);
        let depth = scale * min(interval.density_integral, max_integral);
        if depth > 0.0 {
            let t = clamp(visible_mean_t(interval, depth), interval.t_first, t_max);
            let light = in_scattered_at(segment, pixel, t, anisotropy, environment, false);
            let weight = exp(-fog.optical_depth) * (1.0 - exp(-depth));
            fog.radiance += weight * volumes[volume].emissive;
            add_sample(&sums, weight, volumes[volume].base_color, light);
            t_sum += weight * t;
            fog.optical_depth += depth;
        }
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}

#ifdef VDB_LIGHT_CACHE
// One fog of a segment, by ray marching. Optical depths towards the lights in the light cache are
// interpolated for every step. Whatever else depends on the position is evaluated once per interval.
fn march_cached(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    var t_sum = 0.0;
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let scale = volumes[volume].density_scale * length(segment.dir);
    let max_integral = 100.0 / max(scale, 1e-30);
    let anisotropy = volumes[volume].anisotropy;
    let dir = normalize(segment.dir);
    let environment = environment_light(dir);
    var suns = array<CachedSun, SUN_COUNT>();
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        suns[slot] = cached_sun(slot, dir, anisotropy);
    }
    let interval_step = volumes[volume].light_step * select(f32(REFLECTED_STEP_FACTOR), 1.0, segment.is_view);
    let t_interval = scaled_step(grid, interval_step, LIGHT_EDGE) / length(mirrored.speed);
    var t_next_interval = -1.0;
    var light = with_environment(array<vec3<f32>, OCTAVES>(), environment, anisotropy);
    var unoccluded_light = array<f32, SUN_COUNT>();
    for (var slot = 0u; slot < SUN_COUNT; slot++) {
        unoccluded_light[slot] = 1.0;
    }

    let start = start_t(segment, volume, pixel);
    var steps = begin_steps(mirrored, start, max(volumes[volume].fog_step, MIN_STEP));
    var accessor = new_accessor(steps.ray.cell);
    var sums = ScatteringSums();
    while fog.optical_depth <= OPAQUE_DEPTH {
        let next = next_step(grid, mirrored, &steps, &accessor, stride_at(fog.optical_depth));
        if next.width <= 0.0 {
            break;
        }
        let depth = scale * min(next.width * next.density, max_integral);
        if depth <= 0.0 {
            continue;
        }
        let t = clamp(steps.t_origin + next.t, t_first, t_max);
        if next.t >= t_next_interval {
            t_next_interval = next.t + t_interval;
            let t_middle = min(t + 0.5 * t_interval, t_max);
#ifdef VDB_UNCACHED_LIGHTS
            light = in_scattered_at(segment, pixel, t_middle, anisotropy, environment, true);
#endif
            let point = point_at(segment, t_middle);
            let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
            for (var slot = 0u; slot < SUN_COUNT; slot++) {
                unoccluded_light[slot] = unoccluded(at, point, suns[slot].light);
            }
        }
        var here = light;
        for (var slot = 0u; slot < SUN_COUNT; slot++) {
            let towards_sun = cached_depth(volume, slot, next.point.cell, next.point.u);
            var octave_visibility = unoccluded_light[slot] * exp(-towards_sun);
            for (var octave = 0u; octave < OCTAVES; octave++) {
                here.octaves[octave] +=
                    (octave_visibility * suns[slot].phases[octave]) * suns[slot].illuminance;
                octave_visibility = sqrt(octave_visibility);
            }
        }
        let weight = exp(-fog.optical_depth) * (1.0 - exp(-depth));
        fog.radiance += weight * volumes[volume].emissive;
        add_sample(&sums, weight, volumes[volume].base_color, here);
        t_sum += weight * t;
        fog.optical_depth += depth;
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}
#endif
#endif

fn with_environment(
    octaves: array<vec3<f32>, OCTAVES>,
    environment: EnvironmentLight,
    anisotropy: f32,
) -> InScattered {
    let from_environment = max(environment.mean + anisotropy * environment.forward, vec3(0.0));
    return InScattered(octaves, from_environment, anisotropy);
}

// The light at a point of a segment. With `skips_cached`, the lights in the light cache are left out.
fn in_scattered_at(
    segment: Segment,
    pixel: vec2<u32>,
    t: f32,
    anisotropy: f32,
    environment: EnvironmentLight,
    skips_cached: bool,
) -> InScattered {
    let point = point_at(segment, t);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    let octaves = in_scattered(at, point, normalize(segment.dir), anisotropy, skips_cached);
    return with_environment(octaves, environment, anisotropy);
}
#endif
