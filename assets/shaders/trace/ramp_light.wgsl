// Light of fog with a transfer function (`VdbRamp`) along a ray.
#define_import_path bevy_vdb::trace::ramp_light

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::trace::color::albedo_along
#import bevy_vdb::trace::fog_march::{Fog, add_fog, in_scattered_at, light_interval, pass_fog}
#import bevy_vdb::trace::lights::environment_light
#import bevy_vdb::trace::scattering::{InScattered, OPAQUE_DEPTH, ScatteringSums, mean_transmittance}
#import bevy_vdb::trace::scattering::{all_visible, scattered_radiance}
#import bevy_vdb::trace::segment::{Segment, lattice_ray}
#import bevy_vdb::traversal::hdda::{FAR, enter_at, local_cell, mirrored_ray}
#import bevy_vdb::traversal::march::{begin_march, next_interval}
#import bevy_vdb::traversal::ramps::{Crossed, EMISSION, SCATTERING, crossed_entries, means_over}
#import bevy_vdb::traversal::tree::new_accessor
#import bevy_vdb::view::scene::{fog_grid, frame_random, volumes}

// Sums over stretches of a ray, each attenuated by those before it.
struct RampSums {
    optical_depth: f32,
    opacity: f32,           // ∫ T σ dt, which is 1 - T
    scattered: vec3<f32>,   // ∫ T σ ω dt, with ω the ramp's albedo
    emitted: vec3<f32>,     // ∫ T ε ds
}

// A stretch whose optical depth is larger is divided into parts, because the properties of a part are
// evenly mixed: of two colours of which one is in front, it shows both.
const PART_DEPTH: f32 = 0.25;
const MAX_PARTS: f32 = 16.0;

// Adds a part of a stretch, given what it crosses of the ramp, and its means. `optical_length` is its length
// times the extinction per unit of the ramp's; `emission_length` is its length in world units times a factor of
// emission.
fn add_part(
    sums: ptr<function, RampSums>,
    grid: Grid,
    crossed: Crossed,
    scattering: vec4<f32>,
    optical_length: f32,
    emission_length: f32,
) {
    var emission = vec3(0.0);
    if emission_length > 0.0 {
        emission = means_over(grid, crossed, EMISSION).rgb;
    }
    let depth = scattering.w * optical_length;
    let visible = exp(-(*sums).optical_depth) * mean_transmittance(depth);
    (*sums).opacity += visible * depth;
    (*sums).scattered += visible * optical_length * scattering.rgb;
    (*sums).emitted += visible * emission_length * emission;
    (*sums).optical_depth += depth;
}

// Adds a stretch of a ray on which values are linear from its start to its middle and from there to its end.
fn add_stretch(
    sums: ptr<function, RampSums>,
    grid: Grid,
    values: vec3<f32>,
    optical_length: f32,
    emission_length: f32,
) {
    for (var side = 0u; side < 2u; side++) {
        let from_value = select(values.y, values.x, side == 0u);
        let to_value = select(values.z, values.y, side == 0u);
        var crossed = crossed_entries(grid, from_value, to_value);
        var scattering = means_over(grid, crossed, SCATTERING);
        let parts = clamp(ceil(0.5 * scattering.w * optical_length / PART_DEPTH), 1.0, MAX_PARTS);
        let optical_part = 0.5 * optical_length / parts;
        let emission_part = 0.5 * emission_length / parts;
        for (var i = 0.0; i < parts; i += 1.0) {
            if parts > 1.0 {
                let begin = mix(from_value, to_value, i / parts);
                crossed = crossed_entries(grid, begin, mix(from_value, to_value, (i + 1.0) / parts));
                scattering = means_over(grid, crossed, SCATTERING);
            }
            add_part(sums, grid, crossed, scattering, optical_part, emission_part);
        }
    }
}

// Voxels after which a stretch ends wherever light does not matter; it ends with its cell in any case.
const STRETCHES_STEP: f32 = 64.0;

// The mean albedo of what is visible of a stretch.
fn visible_albedo(sums: RampSums) -> vec3<f32> {
    return sums.scattered / max(sums.opacity, 1e-30);
}

// What a fog with a ramp does to light between two t of a segment. Nothing stops the ray before `start`.
fn ramp_between(segment: Segment, volume: u32, start: f32, t_min: f32, t_max: f32) -> RampSums {
    let grid = fog_grid(volume);
    var ray = lattice_ray(segment, volume, t_max);
    ray.t_min = max(ray.t_min, t_min);
    let mirrored = mirrored_ray(grid, ray);
    let entry = enter_at(mirrored, start);
    let dir_length = length(segment.dir);
    let optical_length = volumes[volume].density_scale * dir_length;
    let emission_length = volumes[volume].ramp_emission * dir_length;
    var march = begin_march(mirrored, entry, STRETCHES_STEP);
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    var sums = RampSums();
    while march.dda.inside && sums.optical_depth <= OPAQUE_DEPTH {
        let stretch = next_interval(grid, mirrored, &march, &accessor, 1e30);
        add_stretch(
            &sums,
            grid,
            stretch.values,
            stretch.width * optical_length,
            stretch.width * emission_length,
        );
    }
    return sums;
}

// One fog with a ramp along a segment, with light that varies along it.
fn march_ramp(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    let grid = fog_grid(volume);
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let entry = enter_at(mirrored, start_t(segment, volume, pixel));
    let dir_length = length(segment.dir);
    let optical_length = volumes[volume].density_scale * dir_length;
    let emission_length = volumes[volume].ramp_emission * dir_length;
    let environment = environment_light(normalize(segment.dir));
    var sums = ScatteringSums();
    var passed = all_visible();
    var march = begin_march(mirrored, entry, light_interval(segment, volume));
    march.t_box -= frame_random(0.41421356) * march.t_step;
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    var light = InScattered();
    var t_lit = -FAR;       // where the light ends to be that of the interval
    var t_sum = 0.0;
    while march.dda.inside && fog.optical_depth <= OPAQUE_DEPTH {
        let stretch = next_interval(grid, mirrored, &march, &accessor, 1e30);
        var own = RampSums();
        add_stretch(&own, grid, stretch.values, stretch.width * optical_length, stretch.width * emission_length);
        let t = min(stretch.t_first + 0.5 * stretch.width, t_max);
        let transmittance = exp(-fog.optical_depth);
        fog.radiance += transmittance * own.emitted;
        if own.opacity > 0.0 {
            let albedo = albedo_along(segment, t, volume) * visible_albedo(own);
            let visible = pass_fog(&passed, own.optical_depth, albedo, volume);
            if t >= t_lit {
                t_lit = march.t_box + (floor((t - march.t_box) / march.t_step) + 1.0) * march.t_step;
                let t_light = clamp(t_lit - 0.5 * march.t_step, t, t_max);
                light = in_scattered_at(segment, pixel, t_light, march.t_step, volume, albedo, visible);
            }
            add_fog(&sums, volume, own.optical_depth, albedo, visible, light, environment);
            let weight = transmittance * own.opacity;
            fog.radiance += weight * volumes[volume].emissive;
            t_sum += weight * t;
            fog.optical_depth += own.optical_depth;
        }
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    let opacity = 1.0 - exp(-fog.optical_depth);
    // Light may come from where nothing is opaque.
    fog.t_mean = select(t_first, t_sum / max(opacity, 1e-30), opacity > 1e-6);
    return fog;
}
