// Light that has been scattered twice or more outside of the forward peak, from coarse lattices through fogs:
// `scattered_light/solve.wgsl`.
#define_import_path bevy_vdb::trace::scattered_light

#import bevy_render::maths::PI
#import bevy_vdb::gpu::types::MAX_SCATTERED_LIGHTS
#import bevy_vdb::trace::scattering::{forward_part, rest_anisotropy}
#import bevy_vdb::trace::segment::{Segment, point_at, position_from_eye}
#import bevy_vdb::view::scene::{view, volumes}

@group(2) @binding(20) var scattered_light: texture_3d<f32>;
@group(2) @binding(21) var scattered_sampler: sampler;

// A ray in the lattice of a fog.
struct ScatteredRay {
    origin: vec3<f32>,          // as a fraction of the texture's size
    dir: vec3<f32>,             // the same per t
    anisotropy: vec3<f32>,      // factors of the flux, for light that is scattered towards the viewer
    layer: f32,                 // from one channel to the next, as a fraction of the texture's size; 0 if all are alike
}

// The lattice of a fog, or of another one if it has none: see `scattered_factor`.
fn scattered_slot(volume: u32) -> u32 {
    return min(volumes[volume].scattered - 1u, MAX_SCATTERED_LIGHTS - 1u);
}

// A segment in the lattice of a fog. Every t is counted from `t_zero`.
fn scattered_ray(segment: Segment, t_zero: f32, volume: u32) -> ScatteredRay {
    let slot = scattered_slot(volume);
    let x = view.scattered[slot].x;
    let y = view.scattered[slot].y;
    let z = view.scattered[slot].z;
    let from_eye = vec4(position_from_eye(point_at(segment, t_zero)), 1.0);
    // Around each channel, there is a border of one texel.
    let first = vec3(1.0, 1.0, view.scattered[slot].first + 1.0);
    let inverse_size = 1.0 / vec3<f32>(textureDimensions(scattered_light));
    let dir = segment.dir;
    let is_even = view.scattered[slot].channels == 1u;
    return ScatteredRay(
        (vec3(dot(x, from_eye), dot(y, from_eye), dot(z, from_eye)) + first) * inverse_size,
        vec3(dot(x.xyz, dir), dot(y.xyz, dir), dot(z.xyz, dir)) * inverse_size,
        (-3.0 * rest_anisotropy(volumes[volume].anisotropy)) * normalize(dir),
        select((view.scattered[slot].size.z + 2.0) * inverse_size.z, 0.0, is_even),
    );
}

// Light that is scattered towards the viewer at a t of a ray, outside of the forward peak; up to `scattered_factor`.
fn scattered_light_at(ray: ScatteredRay, t: f32) -> vec3<f32> {
    var texel = ray.origin + t * ray.dir;
    let first = textureSampleLevel(scattered_light, scattered_sampler, texel, 0.0);
    var light = vec3(first.x + dot(ray.anisotropy, first.yzw));
    if ray.layer > 0.0 {
        for (var i = 1u; i < 3u; i++) {
            texel.z += ray.layer;
            let other = textureSampleLevel(scattered_light, scattered_sampler, texel, 0.0);
            light[i] = other.x + dot(ray.anisotropy, other.yzw);
        }
    }
    return max(light, vec3(0.0));
}

// The factor of light from the lattice of a fog, for an albedo of 1. 0 if it has none.
fn scattered_factor(volume: u32) -> vec3<f32> {
    let part = (1.0 - forward_part(volumes[volume].anisotropy)) / (4.0 * PI);
    let has_lattice = volumes[volume].scattered - 1u < MAX_SCATTERED_LIGHTS;
    return select(vec3(0.0), part * view.scattered[scattered_slot(volume)].scale, has_lattice);
}
