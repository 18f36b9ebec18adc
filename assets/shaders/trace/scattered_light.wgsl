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
    origin: vec3<f32>,      // in cells
    dir: vec3<f32>,         // cells per t
    volume: u32,
}

// A segment in the lattice of a fog. Every t is counted from `t_zero`.
fn scattered_ray(segment: Segment, t_zero: f32, volume: u32) -> ScatteredRay {
    let place = view.scattered[min(volumes[volume].scattered - 1u, MAX_SCATTERED_LIGHTS - 1u)];
    let from_eye = position_from_eye(point_at(segment, t_zero));
    let to_cells = mat3x3(place.x.xyz, place.y.xyz, place.z.xyz);
    let origin = from_eye * to_cells + vec3(place.x.w, place.y.w, place.z.w);
    return ScatteredRay(origin, segment.dir * to_cells, volume);
}

// Light that is scattered towards the viewer at a t of a ray (its direction in world space, of unit length), outside
// of the forward peak, for an albedo of 1.
fn scattered_light_at(ray: ScatteredRay, t: f32, direction: vec3<f32>) -> vec3<f32> {
    let slot = volumes[ray.volume].scattered - 1u;
    if slot >= MAX_SCATTERED_LIGHTS {
        return vec3(0.0);
    }
    let size = view.scattered[slot].size;
    let first = view.scattered[slot].first;
    let inverse_size = 1.0 / vec3<f32>(textureDimensions(scattered_light));
    var texel = clamp(ray.origin + t * ray.dir, vec3(0.5), size - 0.5);
    texel.z += first;
    let anisotropy = volumes[ray.volume].anisotropy;
    let towards_viewer = vec4(1.0, -3.0 * rest_anisotropy(anisotropy) * direction);
    let channel = textureSampleLevel(scattered_light, scattered_sampler, texel * inverse_size, 0.0);
    var light = vec3(dot(channel, towards_viewer));
    if view.scattered[slot].channels > 1u {
        for (var i = 1u; i < 3u; i++) {
            texel.z += size.z;
            let other = textureSampleLevel(scattered_light, scattered_sampler, texel * inverse_size, 0.0);
            light[i] = dot(other, towards_viewer);
        }
    }
    let part = (1.0 - forward_part(anisotropy)) / (4.0 * PI);
    return max(light, vec3(0.0)) * (part * view.scattered[slot].scale);
}
