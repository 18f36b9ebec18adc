// One thread a pixel: a view ray, its light, and what it adds to the picture.

#import bevy_vdb::gpu::types::Ray
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::beam::{beam_of, beam_start_t}
#import bevy_vdb::traversal::hdda::{FAR, enter_at, local_cell, mirrored_ray}
#import bevy_vdb::traversal::rays::ray_through
#ifdef VDB_FOG
#import bevy_vdb::traversal::march::{begin_march, next_interval, scaled_step, visible_mean_t}
#import bevy_vdb::traversal::tree::new_accessor
#import vdb_web::volume::{OPAQUE_DEPTH, depth_from, transmittance}
#else
#import vdb_web::volume::{Surface, first_surface, is_blocked}
#endif
#import vdb_web::scene::{GROUND, GROUND_FADE, GROUND_SHADOW, PI, SKY, SUN}
#import vdb_web::scene::{around_normal, first_frame, frame_sum, ground_light, look, pcg, pixel_offset}
#import vdb_web::scene::{random_pair, sky, surroundings, to_sun_point, view}
#import vdb_web::volume::{Point, point_on, visibility}

// A view ray.
struct Eye {
    ray: Ray,
    dir: vec3<f32>,     // in world space, per unit of t
    start: f32,         // the t before which nothing can stop the ray, or FAR
    pixel: vec2<u32>,
}

// Light that arrives at a point on the ground: of the sun, and of the sky as far as the volume does not hide it.
fn ground_irradiance(start: Point, pixel: vec2<u32>) -> vec3<f32> {
    let to_sun = to_sun_point(random_pair(pixel, 0u));
    let sun = SUN * max(to_sun.y, 0.0) * visibility(start, to_sun);
    if look.frame == 0u {
        return sun + SKY;
    }
    return sun + SKY * visibility(start, around_normal(vec3(0.0, 1.0, 0.0), random_pair(pixel, 1u)));
}

// Radiance behind the volume: of the ground, which fades into the horizon, or of the sky.
fn background(eye: Eye) -> vec3<f32> {
    let dir = normalize(eye.dir);
    if eye.dir.y >= 0.0 || view.eye_height <= 0.0 {
        return sky(dir);
    }
    let t = view.eye_height / -eye.dir.y;
    let distance = length(t * eye.dir.xz - view.center) / view.radius;
    var light = ground_light();
    if distance < GROUND_SHADOW {
        let lit = GROUND / PI * ground_irradiance(point_on(eye.ray, t), eye.pixel);
        light = mix(lit, light, smoothstep(0.7 * GROUND_SHADOW, GROUND_SHADOW, distance));
    }
    return mix(light, sky(dir), 1.0 - exp(-distance * distance / (GROUND_FADE * GROUND_FADE)));
}

#ifdef VDB_FOG
// Henyey and Greenstein's phase function, 1941.
fn phase(cosine: f32, g: f32) -> f32 {
    let base = 1.0 + g * g - 2.0 * g * cosine;
    return (1.0 - g * g) / (4.0 * PI * base * sqrt(base));
}

// How much fog scatters forwards.
const ANISOTROPY: f32 = 0.6;
// Octaves that stand for light scattered more than once (Wrenninge, Kulla and Lundqvist 2013, "Oz: the great and
// volumetric"): each sees half the optical depth of the one before, and scatters half as much forwards.
const OCTAVES: u32 = 4u;
// Voxels that share a ray towards the sun.
const LIGHT_STEP: f32 = 3.0;

// Radiance per optical depth that fog at a point scatters towards the eye.
fn scattered(start: Point, dir: vec3<f32>) -> vec3<f32> {
    let depth = depth_from(start, look.to_sun);
    let cosine = dot(dir, look.to_sun);
    var strength = 1.0;
    var light = 0.0;
    for (var i = 0u; i < OCTAVES; i++) {
        light += strength * phase(cosine, strength * ANISOTROPY) * exp(-strength * depth);
        strength *= 0.5;
    }
    // The sun counts π times, chosen by eye for light that is scattered more often than the octaves account
    // for: without it, clouds are grey. The light of sky and ground is the same everywhere.
    return look.color * (PI * light * SUN + 0.5 / PI * SKY + 0.5 * ground_light());
}

// Light of the fog and what is behind it.
fn radiance(eye: Eye) -> vec3<f32> {
    var light = vec3(0.0);
    var depth = 0.0;
    if eye.start < FAR {
        let grid = grids[0];
        let mirrored = mirrored_ray(grid, eye.ray);
        let scale = max(look.extinction * length(eye.dir), 1e-30);
        let dir = normalize(eye.dir);
        let step = scaled_step(grid, LIGHT_STEP, 96.0);
        var march = begin_march(mirrored, enter_at(mirrored, eye.start), step);
        // Intervals begin elsewhere in each frame, whose mean therefore shows none of them.
        march.t_box -= select(random_pair(eye.pixel, 2u).x, 0.0, look.frame == 0u) * march.t_step;
        var accessor = new_accessor(local_cell(mirrored, march.dda.rel));
        while depth < OPAQUE_DEPTH {
            let interval = next_interval(grid, mirrored, &march, &accessor, 100.0 / scale);
            let own_depth = scale * interval.density_integral;
            if own_depth <= 0.0 {
                break;
            }
            let at = point_on(eye.ray, visible_mean_t(interval, own_depth));
            light += exp(-depth) * (1.0 - exp(-own_depth)) * scattered(at, dir);
            depth += own_depth;
        }
    }
    if depth >= OPAQUE_DEPTH {
        return light;
    }
    return light + exp(-depth) * background(eye);
}

// The transmittance of the whole ray, as grey.
fn data(eye: Eye) -> vec3<f32> {
    if eye.start >= FAR {
        return vec3(1.0);
    }
    return vec3(transmittance(eye.ray, eye.start, length(eye.dir)));
}
#else
// Roughness of the material's coat, squared, and its reflectance at normal incidence.
const ROUGHNESS: f32 = 0.12;
const REFLECTANCE: f32 = 0.04;

// A unit normal in world space, on the side of the eye.
fn world_normal(gradient: vec3<f32>, dir: vec3<f32>) -> vec3<f32> {
    let n = normalize(
        view.normal[0].xyz * gradient.x + view.normal[1].xyz * gradient.y + view.normal[2].xyz * gradient.z,
    );
    return select(n, -n, dot(n, dir) > 0.0);
}

// Reflectance of the coat for light from the sun: Trowbridge and Reitz's distribution, 1975, with the visibility of
// Kelemen and Szirmay-Kalos, 2001.
fn highlight(n: vec3<f32>, to_eye: vec3<f32>, to_sun: vec3<f32>) -> f32 {
    let half = normalize(to_eye + to_sun);
    let to_half = saturate(dot(n, half));
    let spread = to_half * to_half * (ROUGHNESS * ROUGHNESS - 1.0) + 1.0;
    let cosine = max(dot(to_sun, half), 0.05);
    return REFLECTANCE * ROUGHNESS * ROUGHNESS / (4.0 * PI * spread * spread * cosine * cosine);
}

fn fresnel(cosine: f32) -> f32 {
    return REFLECTANCE + (1.0 - REFLECTANCE) * pow(1.0 - cosine, 5.0);
}

// Light from all around: without shadows in the first frame, later along one ray.
fn ambient(surface: Surface, n: vec3<f32>, pixel: vec2<u32>) -> vec3<f32> {
    if look.frame == 0u {
        return mix(ground_light(), SKY / PI, 0.5 + 0.5 * n.y) * 0.8;
    }
    let dir = around_normal(n, random_pair(pixel, 1u));
    if is_blocked(surface.outside, dir) {
        // As much as the surface around sends on average.
        return look.color * 0.3 * (SKY / PI + ground_light());
    }
    return surroundings(dir);
}

fn surface_light(surface: Surface, dir: vec3<f32>, pixel: vec2<u32>) -> vec3<f32> {
    let n = world_normal(surface.gradient, dir);
    let to_sun = to_sun_point(random_pair(pixel, 0u));
    let facing = dot(n, to_sun);
    var light = look.color * ambient(surface, n, pixel);
    // Light that the coat reflects does not reach the material below.
    let reflected = fresnel(saturate(-dot(n, dir)));
    let mirrored = reflect(dir, n);
    let around = surroundings(mirrored);
    if facing > 0.0 && visibility(surface.outside, to_sun) > 0.0 {
        light += facing * SUN * (look.color / PI + highlight(n, -dir, to_sun));
    }
    return mix(light, around, 0.5 * reflected);
}

// Light of the surface, or what is behind it.
fn radiance(eye: Eye) -> vec3<f32> {
    if eye.start < FAR {
        let surface = first_surface(eye.ray, eye.start);
        if surface.found {
            return surface_light(surface, normalize(eye.dir), eye.pixel);
        }
    }
    return background(eye);
}

// The colour of a voxel, by its place in index space; black for none. With smooth surfaces, the normal.
fn data(eye: Eye) -> vec3<f32> {
    if eye.start >= FAR {
        return vec3(0.0);
    }
    let surface = first_surface(eye.ray, eye.start);
    if !surface.found {
        return vec3(0.0);
    }
#ifdef VDB_SMOOTH
    return 0.5 + 0.5 * world_normal(surface.gradient, normalize(eye.dir));
#else
    let at = bitcast<vec3<u32>>(surface.cell + view.base);
    let bits = pcg(at.x + pcg(at.y + pcg(at.z)));
    // Never black.
    return vec3<f32>((vec3(bits) >> vec3(0u, 8u, 16u)) & vec3(255u) | vec3(32u)) / 255.0;
#endif
}
#endif

var<workgroup> tile_start: f32;

@compute @workgroup_size(8, 8)
fn trace(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) index: u32,
) {
    let tile = vec2(group.x, group.y + look.first_row);
    // All rays of a tile skip the empty space before it together.
    if index == 0u {
        tile_start = beam_start_t(grids[0], beam_of(grids[0], view.rays, tile, look.size, 0.0));
    }
    workgroupBarrier();
    let pixel = 8u * tile + local.xy;
    if any(pixel >= look.size) {
        return;
    }
    let uv = (vec2<f32>(pixel) + 0.5 + pixel_offset()) / vec2<f32>(look.size);
    let ndc = vec2(2.0 * uv.x - 1.0, 1.0 - 2.0 * uv.y);
    let dir = view.dir + ndc.x * view.dir_x + ndc.y * view.dir_y;
    let eye = Eye(ray_through(view.rays, ndc, 0.0, FAR), dir, tile_start, pixel);
    let place = pixel.y * look.size.x + pixel.x;
    if look.shows_data == 1u {
        first_frame[place] = vec4(data(eye), 1.0);
        return;
    }
    let light = vec4(radiance(eye), 0.0);
    if look.frame == 0u {
        first_frame[place] = light;
    } else if look.frame == 1u {
        frame_sum[place] = light;
    } else {
        frame_sum[place] += light;
    }
}
