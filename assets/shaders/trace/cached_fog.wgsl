// A single fog along a segment, lit from the light cache.
#define_import_path bevy_vdb::trace::cached_fog

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::trace::fog_march::{Fog, MIN_STEP, OPAQUE_DEPTH, light_interval}
#import bevy_vdb::trace::lights::environment_light
#import bevy_vdb::trace::scattering::{ScatteringSums, add_sample, scattered_radiance}
#import bevy_vdb::trace::segment::{Segment, lattice_ray}
#import bevy_vdb::trace::shared_light::{begin_interval, begin_light, light_at_sample}
#import bevy_vdb::traversal::fog::{begin_steps, next_step, stride_at}
#import bevy_vdb::traversal::hdda::mirrored_ray
#import bevy_vdb::traversal::tree::new_accessor
#import bevy_vdb::view::scene::volumes

// Ray marches a single fog. `march_media` would give the same result, but needs more registers.
fn march_cached(segment: Segment, volume: u32, pixel: vec2<u32>, t_first: f32, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, volume);
    var t_sum = 0.0;
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let scale = volumes[volume].density_scale * length(segment.dir);
    let max_integral = 100.0 / max(scale, 1e-30);
    let dir = normalize(segment.dir);
    let environment = environment_light(dir);
    let t_interval = light_interval(segment, volume) / length(mirrored.speed);
    var shared_light = begin_light(dir, environment, volumes[volume].anisotropy);
    var steps =
        begin_steps(mirrored, start_t(segment, volume, pixel), max(volumes[volume].fog_step, MIN_STEP));
    var accessor = new_accessor(steps.ray.cell);
    var sums = ScatteringSums();
    while fog.optical_depth <= OPAQUE_DEPTH {
        let next = next_step(grid, &steps, &accessor, stride_at(fog.optical_depth));
        if next.width <= 0.0 {
            break;
        }
        let depth = scale * min(next.width * next.density, max_integral);
        if depth <= 0.0 {
            continue;
        }
        let t = clamp(steps.t_origin + next.t, t_first, t_max);
        if t >= shared_light.t_next {
            begin_interval(&shared_light, segment, pixel, t, t_interval, t_max, environment);
        }
        let light = light_at_sample(shared_light, volume, next.point);
        let weight = exp(-fog.optical_depth) * (1.0 - exp(-depth));
        fog.radiance += weight * volumes[volume].emissive;
        add_sample(&sums, weight, volumes[volume].base_color, light);
        t_sum += weight * t;
        fog.optical_depth += depth;
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
    return fog;
}
