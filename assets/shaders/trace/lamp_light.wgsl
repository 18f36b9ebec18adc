// The light of cached lamps that a fog scatters towards the view's eye, at the samples of the light cache.
// Where lamps are far compared with the distance between samples, rays interpolate it instead of asking each
// lamp.

#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT
#import bevy_vdb::gpu::types::{MAX_CACHED_LAMPS, MAX_HALF}
#import bevy_vdb::light_cache::lattice::{NO_FOG, first_texel}
#import bevy_vdb::trace::illuminance::lamp_illuminance
#import bevy_vdb::trace::light_cache::{NOT_CACHED, lamp_group_lattices, lamp_light_lattice, light_atlas}
#import bevy_vdb::trace::light_cache::far_from_lamps
#import bevy_vdb::trace::cached_lights::{interpolated_near_eye, interpolated_part}
#import bevy_vdb::trace::lights::light_cosine
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattering::{forward_part, split_phases}
#else
#import bevy_vdb::trace::scattering::phase
#endif
#import bevy_vdb::view::scene::{view, volumes}

// Where the samples of a fog are.
struct Samples {
    origin: vec3<f32>,      // first sample, world space, relative to the view's eye
    volume: u32,            // in the volumes of the view
    axis_x: vec3<f32>,      // world units per cell of the volume's lattice
    axis_y: vec3<f32>,
    axis_z: vec3<f32>,
    count: vec3<u32>,       // along each axis
}

@group(2) @binding(6) var<uniform> samples: Samples;
@group(2) @binding(7) var gathered: texture_storage_3d<rgba16float, write>;

// The direction of the view ray through a point relative to the eye, of unit length.
fn view_direction(from_eye: vec3<f32>) -> vec3<f32> {
    let is_parallel = any(view.eye_x != vec3(0.0));
    return normalize(select(from_eye, view.dir, is_parallel || all(from_eye == vec3(0.0))));
}

// Light of an albedo of 1 that is scattered towards the eye. All of it is attenuated by what fog does not scatter in
// the forward peak, because 16 bits hold that far into the fog.
struct LampLight {
    once: vec3<f32>,    // scattered in the peak once
#ifdef VDB_SCATTERED
    twice: vec3<f32>,
    often: vec3<f32>,   // three times or more
    rest: vec3<f32>,    // scattered otherwise
    depth: f32,         // of fog towards the lamps, times the brightness of `twice`
#endif
}

fn gather_lamps(
    volume: u32,
    from_eye: vec3<f32>,
    sample: vec3<u32>,
) -> LampLight {
    var light = LampLight();
    let position = view.eye + from_eye;
    let ray = view_direction(from_eye);
    let anisotropy = volumes[volume].anisotropy;
    let far = far_from_lamps(volume);
    let near_eye = interpolated_near_eye(volume, position);
    let groups = (min(view.cached_lamp_count, MAX_CACHED_LAMPS) + 3u) / 4u;
    for (var group = 0u; group < groups; group++) {
        let lamps = view.cached_lamps[group];
        let lattices = lamp_group_lattices(volume, group);
        for (var i = 0u; i < 4u; i++) {
            if lattices[i] == NOT_CACHED {
                continue;
            }
            let depth = textureLoad(light_atlas, first_texel(lattices[i]) + sample, 0).x;
            if depth == NO_FOG {
                return light;
            }
            let data = bevy::clustered_lights.data[lamps[i]];
            let to_lamp = data.position_radius.xyz - position;
            let part = near_eye * interpolated_part(data, dot(to_lamp, to_lamp), far);
            let illuminance = part * lamp_illuminance(data, to_lamp, ray, 0.0);
            let has_shadows = (data.flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u;
            if has_shadows && any(illuminance > vec3(0.0)) {
                let cosine = light_cosine(to_lamp, ray);
#ifdef VDB_SCATTERED
                let phases = split_phases(anisotropy, cosine);
                let peak = depth * forward_part(anisotropy) * saturate(volumes[volume].base_color);
                let arriving = illuminance * exp(peak - depth);
                light.once += phases.x * arriving;
                light.twice += phases.y * arriving;
                light.often += phases.z * arriving;
                light.rest += phases.w * arriving;
                light.depth += depth * dot(phases.y * arriving, vec3(1.0));
#else
                light.once += illuminance * (exp(-depth) * phase(anisotropy, cosine));
#endif
            }
        }
    }
    return light;
}

fn store_light(texel: vec3<u32>, light: vec3<f32>, other: f32) {
    let exposed = clamp(light * view.exposure, vec3(-MAX_HALF), vec3(MAX_HALF));
    textureStore(gathered, texel, vec4(exposed, clamp(other, -MAX_HALF, MAX_HALF)));
}

@compute @workgroup_size(4, 4, 4)
fn gather(@builtin(global_invocation_id) sample: vec3<u32>) {
    if any(sample >= samples.count) {
        return;
    }
    let volume = view.volume_first + samples.volume;
    let from_origin = vec3<f32>(sample) / volumes[volume].light_scale;
    let from_eye = samples.origin
        + from_origin.x * samples.axis_x
        + from_origin.y * samples.axis_y
        + from_origin.z * samples.axis_z;
    let light = gather_lamps(volume, from_eye, sample);
    let first = first_texel(lamp_light_lattice(volume)) + sample;
#ifdef VDB_SCATTERED
    let kinds = vec3(0u, 0u, samples.count.z);
    let brightness = dot(light.twice, vec3(1.0));
    let is_bright = abs(brightness) > 1e-30;
    let safe = select(1.0, brightness, is_bright);
    store_light(first, light.once, select(0.0, light.depth / safe, is_bright));
    store_light(first + kinds, light.twice, select(0.0, dot(light.often, vec3(1.0)) / safe, is_bright));
    store_light(first + 2u * kinds, light.rest, 0.0);
#else
    store_light(first, light.once, 0.0);
#endif
}
