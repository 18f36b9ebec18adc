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

// A ray in a lattice.
struct ScatteredRay {
    slot: u32,
    origin: vec3<f32>,  // as a fraction of the texture's size
    dir: vec3<f32>,     // the same per t
    layer: f32,         // from one channel to the next, as a fraction of the texture's size; 0 if all are alike
}

// Light at a point of a ray, for each channel.
struct ScatteredLight {
    mean: vec3<f32>,    // over all directions
    flux: vec3<f32>,    // along the ray
}

// The slot of the lattice of a fog; that of another lattice if it has none.
fn scattered_slot(volume: u32) -> u32 {
    return min(volumes[volume].scattered - 1u, MAX_SCATTERED_LIGHTS - 1u);
}

fn has_scattered_light(volume: u32) -> bool {
    return volumes[volume].scattered - 1u < MAX_SCATTERED_LIGHTS;
}

// A segment in the lattice of a slot. Every t is counted from `t_zero`.
fn scattered_ray(segment: Segment, t_zero: f32, slot: u32) -> ScatteredRay {
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
        slot,
        (vec3(dot(x, from_eye), dot(y, from_eye), dot(z, from_eye)) + first) * inverse_size,
        vec3(dot(x.xyz, dir), dot(y.xyz, dir), dot(z.xyz, dir)) * inverse_size,
        select((view.scattered[slot].size.z + 2.0) * inverse_size.z, 0.0, is_even),
    );
}

// The light at a t of a ray. `dir` is its direction in world space, of length 1.
fn scattered_light_at(ray: ScatteredRay, dir: vec3<f32>, t: f32) -> ScatteredLight {
    var texel = ray.origin + t * ray.dir;
    let first = textureSampleLevel(scattered_light, scattered_sampler, texel, 0.0);
    var light = ScatteredLight(vec3(first.x), vec3(dot(dir, first.yzw)));
    if ray.layer > 0.0 {
        for (var i = 1u; i < 3u; i++) {
            texel.z += ray.layer;
            let other = textureSampleLevel(scattered_light, scattered_sampler, texel, 0.0);
            light.mean[i] = other.x;
            light.flux[i] = dot(dir, other.yzw);
        }
    }
    let scale = view.scattered[ray.slot].scale;
    return ScatteredLight(scale * light.mean, scale * light.flux);
}

// What a fog scatters of this light towards the viewer, outside of the forward peak, for an albedo of 1. 0 if the fog
// has no lattice.
fn scattered_towards_viewer(light: ScatteredLight, volume: u32) -> vec3<f32> {
    let anisotropy = volumes[volume].anisotropy;
    let part = (1.0 - forward_part(anisotropy)) / (4.0 * PI);
    let factor = select(0.0, part, has_scattered_light(volume));
    return factor * max(light.mean - (3.0 * rest_anisotropy(anisotropy)) * light.flux, vec3(0.0));
}
