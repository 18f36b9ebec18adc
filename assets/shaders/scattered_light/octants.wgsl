// What the lattice of scattered light is made from: fog and the light that arrives in it, in the eight octants of each
// cell.

#import bevy_vdb::gpu::types::{KIND_FOG, MAX_CACHED_LAMPS, MAX_CACHED_SUNS, MAX_HALF}
#import bevy_vdb::scattered_light::layout::{octant_word, octant_words}
#import bevy_vdb::trace::color::albedo_along
#import bevy_vdb::trace::occlusion::{casts_shadow, fog_depth, fog_depth_to_light}
#import bevy_vdb::trace::scattering::{forward_part, rest_anisotropy}
#import bevy_vdb::trace::segment::{NONE, Point, Segment, lattice_from_world, lattice_ray, point_at}
#import bevy_vdb::traversal::hdda::{FAR, enter, mirrored_ray}
#import bevy_vdb::view::scene::{fog_grid, view, volumes}
#ifdef VDB_RAMPS
#import bevy_vdb::trace::color::value_along
#import bevy_vdb::traversal::ramps::{SCATTERING, crossed_entries, means_over}
#endif
#ifdef VDB_LIGHT_CACHE
#import bevy_vdb::trace::color::lattice_point_along
#import bevy_vdb::trace::light_cache::{cached_sun_depth, has_light_cache, lattice_point}
#ifdef VDB_CACHED_LAMPS
#import bevy_vdb::trace::light_cache::{NOT_CACHED, cached_lamp_depth, lamp_group_lattices}
#endif
#endif

// The most lights.
const MAX_SOURCES: u32 = MAX_CACHED_SUNS + MAX_CACHED_LAMPS;

// A light with shadows.
struct Light {
    position: vec3<f32>,    // relative to the view's eye; direction to a sun, of unit length. World space.
    inverse_square_range: f32,  // of a lamp; negative for suns
    color: vec3<f32>,       // lux of a sun, candela of a lamp, times the lattice's scale
    radius: f32,            // of a lamp
    axis: vec3<f32>,        // of a spot light's cone, of unit length
    slot: u32,              // in the light cache, among suns or lamps
    // Brightness in the cone as a function of the cosine; 0 and 1 for a point light.
    cone_scale: f32,
    cone_offset: f32,
}

struct Job {
    origin: vec3<f32>,      // centre of the first octant, relative to the view's eye, world space
    light_count: u32,
    axis_x: vec3<f32>,      // edges of an octant
    fog_count: u32,
    axis_y: vec3<f32>,
    channels: u32,
    axis_z: vec3<f32>,
    edge: f32,              // length of an octant's edges
    size: vec3<u32>,        // octants along each axis
    lights: array<Light, MAX_SOURCES>,
}

@group(2) @binding(6) var<uniform> job: Job;
@group(2) @binding(7) var<storage, read_write> octants: array<u32>;
// Volumes of the view.
@group(2) @binding(8) var<storage, read> fogs: array<u32>;

// The fogs in an octant, as optical depths along one of its edges.
struct Mixture {
    depth: f32,
    scattered: vec3<f32>,   // of scattering outside of the forward peak
    forward: vec3<f32>,     // of scattering in the peak
    anisotropy: f32,        // of scattering outside of it, times the mean of `scattered`
    thickest: u32,          // the fog that attenuates most, or NONE
    thickest_depth: f32,
}

// The albedo of a fog in the middle of a segment.
fn albedo_at(segment: Segment, t: f32, volume: u32) -> vec3<f32> {
    var albedo = albedo_along(segment, t, volume);
#ifdef VDB_RAMPS
    if volumes[volume].ramp != 0u {
        let grid = fog_grid(volume);
        let value = value_along(segment, t, volume);
        let scattering = means_over(grid, crossed_entries(grid, value, value), SCATTERING);
        albedo *= scattering.rgb / max(scattering.w, 1e-30);
    }
#endif
    return saturate(albedo);
}

fn mixture_at(segment: Segment) -> Mixture {
    var mixture = Mixture();
    mixture.thickest = NONE;
    for (var i = 0u; i < min(job.fog_count, arrayLength(&fogs)); i++) {
        let volume = view.volume_first + fogs[i];
        // Fogs that cast no shadows attenuate nothing.
        if volumes[volume].kind != KIND_FOG || !casts_shadow(volume) {
            continue;
        }
        let grid = fog_grid(volume);
        let ray = mirrored_ray(grid, lattice_ray(segment, volume, job.edge));
        let dda = enter(ray);
        if dda.inside {
            let depth = fog_depth(volume, grid, ray, dda, false, 0.0);
            if depth > 0.0 {
                let anisotropy = volumes[volume].anisotropy;
                let f = forward_part(anisotropy);
                let albedo = albedo_at(segment, 0.5 * job.edge, volume);
                let scattered = (depth * (1.0 - f)) * albedo;
                mixture.depth += depth;
                mixture.scattered += scattered;
                mixture.forward += (depth * f) * albedo;
                mixture.anisotropy += rest_anisotropy(anisotropy) * dot(scattered, vec3(1.0 / 3.0));
                if depth > mixture.thickest_depth {
                    mixture.thickest = volume;
                    mixture.thickest_depth = depth;
                }
            }
        }
    }
    return mixture;
}

// Optical depth between the middle of a segment and a light in a direction at a distance.
fn depth_towards(
    segment: Segment,
    volume: u32,
    light: Light,
    direction: vec3<f32>,
    distance: f32,
) -> f32 {
#ifdef VDB_LIGHT_CACHE
    if has_light_cache(volume) {
        let place = lattice_point_along(segment, 0.5 * job.edge, volume);
        let point = lattice_point(volume, place.cell, place.u);
        if light.inverse_square_range < 0.0 {
            return cached_sun_depth(point, volume, light.slot);
        }
#ifdef VDB_CACHED_LAMPS
        let lattice = lamp_group_lattices(volume, light.slot / 4u)[light.slot % 4u];
        if lattice != NOT_CACHED {
            return cached_lamp_depth(point, lattice);
        }
#endif
    }
#endif
    // Rays take about two samples in each octant.
    let cells = job.edge * length(lattice_from_world(volume, direction));
    return fog_depth_to_light(point_at(segment, 0.5 * job.edge), direction, distance, 0.5 * cells);
}

// Illuminance by a light, without shadows.
fn arriving(light: Light, to_light: vec3<f32>) -> vec3<f32> {
    if light.inverse_square_range < 0.0 {
        return light.color;
    }
    let distance_squared = dot(to_light, to_light);
    let cosine = dot(-light.axis, to_light * inverseSqrt(max(distance_squared, 1e-30)));
    let cone = saturate(cosine * light.cone_scale + light.cone_offset);
    // As `lamp_illuminance`; an octant is lit as a ball of its volume would be.
    let radius_squared = max(light.radius * light.radius, 0.4 * job.edge * job.edge);
    let effective_squared = distance_squared + radius_squared / 3.0;
    let factor = effective_squared * light.inverse_square_range;
    let smooth_factor = saturate(1.0 - factor * factor);
    return light.color * (cone * cone * smooth_factor * smooth_factor / max(effective_squared, 1e-4));
}

@compute @workgroup_size(4, 4, 4)
fn sample_octants(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= job.size) {
        return;
    }
    let place = vec3<f32>(id);
    let middle = job.origin + place.x * job.axis_x + place.y * job.axis_y + place.z * job.axis_z;
    let diagonal = normalize(job.axis_x + job.axis_y + job.axis_z);
    let start = Point(vec2(0.0), 0.0, middle - (0.5 * job.edge) * diagonal, NONE, vec3(0), vec3(0.0));
    let segment = Segment(start, diagonal, false, 0.0);
    let mixture = mixture_at(segment);
    var light = array<vec3<f32>, 4>();     // in each channel: brightness, then its sum over directions
    if mixture.depth > 0.0 {
        let volume = mixture.thickest;
        let forward = mixture.forward / mixture.depth;
        for (var i = 0u; i < min(job.light_count, MAX_SOURCES); i++) {
            let source = job.lights[i];
            let is_sun = source.inverse_square_range < 0.0;
            let to_light = select(source.position - middle, source.position, is_sun);
            let illuminance = arriving(source, to_light);
            if any(illuminance > vec3(0.0)) {
                let distance = select(length(to_light), FAR, is_sun);
                let direction = normalize(to_light);
                let depth = depth_towards(segment, volume, source, direction, distance);
                let own = illuminance * exp(depth * (forward - 1.0));
                light[0] += own;
                // Light travels away from where it comes from.
                light[1] -= own * direction.x;
                light[2] -= own * direction.y;
                light[3] -= own * direction.z;
            }
        }
    }
    let first = octant_word(id, job.size, job.channels);
    let rest_anisotropy = mixture.anisotropy / max(dot(mixture.scattered, vec3(1.0 / 3.0)), 1e-30);
    // Depths are those of a cell.
    octants[first] = pack2x16float(vec2(min(2.0 * mixture.depth, MAX_HALF), rest_anisotropy));
    for (var channel = 0u; channel < job.channels; channel++) {
        let rest = max(mixture.depth - mixture.forward[channel], 0.0);
        let depths = min(2.0 * vec2(rest, mixture.scattered[channel]), vec2(MAX_HALF));
        let own = vec4(light[0][channel], light[1][channel], light[2][channel], light[3][channel]);
        let bounded = clamp(own, vec4(-MAX_HALF), vec4(MAX_HALF));
        let word = first + octant_words(0u) + 3u * channel;
        octants[word] = pack2x16float(depths);
        octants[word + 1u] = pack2x16float(bounded.xy);
        octants[word + 2u] = pack2x16float(bounded.zw);
    }
}
