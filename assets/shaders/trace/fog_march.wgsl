// One fog along a segment, lit by rays: its optical depth and radiance.
#define_import_path bevy_vdb::trace::fog_march

#ifdef VDB_LIT
#import bevy_vdb::view::scene::{fog_grid, frame_random, volumes}
#import bevy_vdb::trace::segment::{Segment, lattice_ray, point_at}
#import bevy_vdb::trace::lights::{EnvironmentLight, environment_light, in_scattered, shading_point}
#import bevy_vdb::trace::scattering::{InScattered, Scatterer, ScatteringSums, Visible, add_environment}
#import bevy_vdb::trace::scattering::{all_visible, pass_stretch, scattered_radiance, tint}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattered_light::{scattered_light_at, scattered_ray, scattered_slot}
#import bevy_vdb::trace::scattered_light::scattered_towards_viewer
#import bevy_vdb::trace::scattering::forward_depth
#endif
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
    let environment = environment_light(normalize(segment.dir));
    var sums = ScatteringSums();
    var passed = all_visible();
    var march = begin_march(mirrored, entry, light_interval(segment, volume));
    march.t_box -= frame_random(0.41421356) * march.t_step;
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    while march.dda.inside && fog.optical_depth <= OPAQUE_DEPTH {
        let interval = next_interval(grid, mirrored, &march, &accessor, max_integral);
        let depth = scale * min(interval.density_integral, max_integral);
        if depth > 0.0 {
            let t = clamp(visible_mean_t(interval, depth), interval.t_first, t_max);
            let albedo = albedo_along(segment, t, volume);
            let visible = pass_fog(&passed, depth, albedo, volume);
            let light = in_scattered_at(segment, pixel, t, march.t_step, volume, albedo, visible);
            add_fog(&sums, volume, depth, albedo, visible, light, environment);
            let weight = depth * visible.whole;
            fog.radiance += weight * volumes[volume].emissive;
            t_sum += weight * t;
            fog.optical_depth += depth;
        }
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}
#endif

// Moves a ray on through an optical depth of a fog alone. Returns what is visible of it.
fn pass_fog(passed: ptr<function, Visible>, depth: f32, albedo: vec3<f32>, volume: u32) -> Visible {
#ifdef VDB_SCATTERED
    return pass_stretch(passed, depth, forward_depth(depth, tint(albedo), volumes[volume].anisotropy));
#else
    return pass_stretch(passed, depth);
#endif
}

// Adds the light of a stretch with an optical depth of a fog.
fn add_fog(
    sums: ptr<function, ScatteringSums>,
    volume: u32,
    depth: f32,
    albedo: vec3<f32>,
    visible: Visible,
    light: InScattered,
    environment: EnvironmentLight,
) {
    let anisotropy = volumes[volume].anisotropy;
    (*sums).radiance += (depth * visible.whole) * albedo * light.whole;
#ifdef VDB_SCATTERED
    (*sums).radiance += (depth * visible.rest.value) * albedo * light.rest;
#endif
    add_environment(sums, depth * visible.whole, albedo, light_around(environment, anisotropy), anisotropy);
}

// The environment's light that fog scatters, without attenuation.
fn light_around(environment: EnvironmentLight, anisotropy: f32) -> vec3<f32> {
    return max(environment.mean + anisotropy * environment.forward, vec3(0.0));
}

// The light around t on a segment, in a fog.
fn in_scattered_at(
    segment: Segment,
    pixel: vec2<u32>,
    t: f32,
    t_extent: f32,
    volume: u32,
    albedo: vec3<f32>,
    visible: Visible,
) -> InScattered {
    let point = point_at(segment, t);
    let at = shading_point(point, vec3(0.0), pixel, segment.is_view);
    let dir_length = length(segment.dir);
    let ray = segment.dir / dir_length;
    var scatterer = Scatterer();
    scatterer.anisotropy = volumes[volume].anisotropy;
    scatterer.albedo = tint(albedo);
#ifdef VDB_SCATTERED
    scatterer.forward = visible.forward;
#endif
    var light = in_scattered(at, point, ray, t_extent * dir_length, scatterer);
#ifdef VDB_SCATTERED
    let in_lattice = scattered_ray(segment, t, scattered_slot(volume));
    let scattered = scattered_towards_viewer(scattered_light_at(in_lattice, ray, 0.0), volume);
    light.rest += (light.unoccluded / max(light.all, 1e-30)) * scattered;
#endif
    return light;
}
#endif
