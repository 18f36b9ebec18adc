// One fog along a segment, lit by rays: its optical depth and radiance.
#define_import_path bevy_vdb::trace::fog_march

#ifdef VDB_LIT
#import bevy_vdb::view::scene::{fog_grid, frame_random, volumes}
#import bevy_vdb::trace::segment::{Segment, lattice_ray, point_at}
#import bevy_vdb::trace::lights::{EnvironmentLight, environment_light, in_scattered, shading_point}
#import bevy_vdb::trace::scattering::{ScatteringSums, InScattered, OCTAVES, add_sample, octave_weights}
#import bevy_vdb::trace::scattering::{scattered_radiance, visibility_between}
#ifndef VDB_EVEN_LIGHT
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::color::albedo_along
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::trace::scattering::OPAQUE_DEPTH
#import bevy_vdb::traversal::hdda::{enter_at, local_cell, mirrored_ray}
#import bevy_vdb::traversal::march::{begin_march, next_interval, visible_mean_t, scaled_step}
#import bevy_vdb::traversal::tree::new_accessor
#endif
#endif

// Above this many voxels along the longest edge of a fog's box, the intervals that share one lighting sample
// become longer in proportion.
const LIGHT_EDGE: f32 = 128.0;
// In reflections, intervals are longer by this factor, because every interval evaluates every light.
const REFLECTED_STEP_FACTOR: u32 = 4u;
// The largest optical depth of a fog in a step. Nothing is visible behind it, and products stay within f32.
const MAX_DEPTH_OF_STEP: f32 = 100.0;
// The shortest step between samples, in voxels.
const MIN_STEP: f32 = 0.25;

struct Fog {
    radiance: vec3<f32>,
    optical_depth: f32,
    t_first: f32,
    // Mean t of the visible fog, weighted by visibility. With several media, `motion_volume` is the volume
    // that contributes most to what is visible.
    t_mean: f32,
    motion_volume: u32,
}

#ifdef VDB_LIT
#ifndef VDB_EVEN_LIGHT
// Voxels that share one lighting sample in a fog.
fn light_interval(segment: Segment, volume: u32) -> f32 {
    let step = volumes[volume].light_step * select(f32(REFLECTED_STEP_FACTOR), 1.0, segment.is_view);
    return scaled_step(grids[volumes[volume].grid], step, LIGHT_EDGE);
}

// One fog of a segment, under lighting that varies along it.
fn march_fog(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    var t_sum = 0.0;
    let grid = fog_grid(volume);
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let entry = enter_at(mirrored, start_t(segment, volume, pixel));
    let scale = volumes[volume].density_scale * length(segment.dir);
    let max_integral = MAX_DEPTH_OF_STEP / max(scale, 1e-30);
    let anisotropy = volumes[volume].anisotropy;
    let environment = environment_light(normalize(segment.dir));
    var sums = ScatteringSums();
    var march = begin_march(mirrored, entry, light_interval(segment, volume));
    march.t_box -= frame_random(0.41421356) * march.t_step;
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    while march.dda.inside && fog.optical_depth <= OPAQUE_DEPTH {
        let interval = next_interval(grid, mirrored, &march, &accessor, max_integral);
        let depth = scale * min(interval.density_integral, max_integral);
        if depth > 0.0 {
            let t = clamp(visible_mean_t(interval, depth), interval.t_first, t_max);
            let light = in_scattered_at(segment, pixel, t, march.t_step, anisotropy, environment);
            let transmittance = exp(-fog.optical_depth);
            let weight = transmittance * (1.0 - exp(-depth));
            fog.radiance += weight * volumes[volume].emissive;
            let visible = visibility_between(transmittance, transmittance - weight);
            let weights = octave_weights(weight, visible, anisotropy);
            add_sample(&sums, weights, albedo_along(segment, t, volume), light);
            t_sum += weight * t;
            fog.optical_depth += depth;
        }
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}
#endif

fn with_environment(
    octaves: array<vec3<f32>, OCTAVES>,
    environment: EnvironmentLight,
    anisotropy: f32,
) -> InScattered {
    let from_environment = max(environment.mean + anisotropy * environment.forward, vec3(0.0));
    return InScattered(octaves, from_environment, anisotropy);
}

// The light around t on a segment.
fn in_scattered_at(
    segment: Segment,
    pixel: vec2<u32>,
    t: f32,
    t_extent: f32,
    anisotropy: f32,
    environment: EnvironmentLight,
) -> InScattered {
    let point = point_at(segment, t);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    let dir_length = length(segment.dir);
    let ray = segment.dir / dir_length;
    let octaves = in_scattered(at, point, ray, t_extent * dir_length, anisotropy);
    return with_environment(octaves, environment, anisotropy);
}
#endif
