// How much of a light reaches a point, through the shadows of meshes and volumes.
#define_import_path bevy_vdb::trace::visibility

#import bevy_vdb::trace::light_list::{LightList, ShadingPoint}
#import bevy_vdb::trace::segment::Point
#ifdef VDB_SHADOWS
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#import bevy_pbr::mesh_view_types::{POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#import bevy_vdb::gpu::types::NO_RECEIVER
#import bevy_vdb::trace::light_list::{local_light, to_light}
#import bevy_vdb::trace::mesh_shadows::{lamp_past_meshes, sun_past_meshes}
#import bevy_vdb::trace::occlusion::transmittance
#import bevy_vdb::trace::segment::NONE
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::volumes
#ifdef VDB_SOFT_SUNS
#import bevy_render::maths::PI
#import bevy_vdb::gpu::types::MAX_SUNS
#import bevy_vdb::view::scene::{random_pair, view}
#endif
#endif

#ifdef VDB_SOFT_SUNS
// The angular size that `VdbSun` sets for a light, as stored in `View`.
fn sun_disk(lights: LightList, light: u32) -> vec4<f32> {
    var disk = vec4(0.0);
    if light < lights.suns {
        let direction = bevy::lights.directional_lights[light].direction_to_light;
        for (var i = 0u; i < min(view.sun_count, MAX_SUNS); i++) {
            disk = select(disk, view.disks[i], all(view.suns[i].xyz == direction));
        }
    }
    return disk;
}

// The dimension of `random_pair` for suns. The bounces of a pixel's first ray have lower ones.
const SUN_DIMENSION: u32 = 31u;

// Mean transmittance towards a sun with an angular diameter. Samples are spread evenly over its disk after
// Vogel 1979, "A better way to construct the sunflower head", and rotated per pixel.
fn soft_transmittance(at: ShadingPoint, point: Point, to_sun: vec3<f32>, tangent: f32, samples: u32) -> f32 {
    let helper = select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), abs(to_sun.x) > 0.5);
    let right = normalize(cross(helper, to_sun));
    let up = cross(to_sun, right);
    let random = random_pair(vec2<u32>(at.coord), SUN_DIMENSION, view.frame);
    let rotation = 2.0 * PI * random.x;
    var sum = 0.0;
    for (var k = 0u; k < samples; k++) {
        let radius = tangent * sqrt((f32(k) + random.y) / f32(samples));
        let angle = rotation + 2.39996323 * f32(k);
        let direction = normalize(to_sun + radius * (cos(angle) * right + sin(angle) * up));
        if dot(direction, at.normal) > 0.0 {
            sum += transmittance(point, direction, FAR, false);
        }
    }
    return sum / f32(samples);
}
#endif

// Fraction of a light that reaches a point: Bevy's shadow maps for meshes, times the transmittance of
// volumes.
fn visibility(at: ShadingPoint, point: Point, lights: LightList, i: u32) -> f32 {
#ifdef VDB_SHADOWS
    let light_vector = to_light(at, lights, i);
    if any(at.normal != vec3(0.0)) && dot(at.normal, light_vector) <= 0.0 {
        return 0.0;
    }
    if point.volume != NONE && (volumes[point.volume].flags & NO_RECEIVER) != 0u {
        return 1.0;
    }
    var visible = 1.0;
    var distance = FAR;
    var direction = light_vector;
    if i < lights.suns {
        let flags = bevy::lights.directional_lights[i].flags;
        if (flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) == 0u {
            return 1.0;
        }
        visible = sun_past_meshes(at, i);
    } else {
#ifdef VDB_LOCAL_LIGHTS
        let light = local_light(lights, i);
        if (bevy::clustered_lights.data[light].flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) == 0u {
            return 1.0;
        }
        distance = length(light_vector);
        direction = light_vector / max(distance, 1e-30);
        visible = lamp_past_meshes(at, light);
#endif
    }
    if visible > 0.0 {
        let in_fog = !any(at.normal != vec3(0.0));
#ifdef VDB_SOFT_SUNS
        let disk = sun_disk(lights, i);
        if disk.x > 0.0 && !in_fog {
            return visible * soft_transmittance(at, point, direction, disk.x, u32(disk.y));
        }
#endif
        visible *= transmittance(point, direction, distance, in_fog);
    }
    return visible;
#else
    return 1.0;
#endif
}
