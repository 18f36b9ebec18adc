// Illuminance by Bevy's lights, in lux, without shadows.
#define_import_path bevy_vdb::trace::illuminance

#import bevy_pbr::lighting
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{ClusteredLight, POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT}
#import bevy_pbr::mesh_view_types::POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE
#import bevy_vdb::gpu::types::MAX_SUNS
#import bevy_vdb::trace::light_list::{LightList, ShadingPoint, local_light}
#import bevy_vdb::view::scene::view

// The factor that `VdbSun` sets for a directional light.
fn sun_factor(light: u32) -> f32 {
    let direction = bevy::lights.directional_lights[light].direction_to_light;
    var factor = 1.0;
    for (var i = 0u; i < min(view.sun_count, MAX_SUNS); i++) {
        factor = select(factor, view.suns[i].w, all(view.suns[i].xyz == direction));
    }
    return factor;
}

#ifdef VDB_LOCAL_LIGHTS
// Stretches shorter than this fraction of the distance to a lamp are represented by their midpoint.
const NEAR_LAMP: f32 = 0.25;

// The square of the effective distance of a lamp at a distance. In a lamp with a radius, as in a fire, light
// is finite: an even ball sheds three times its intensity over the square of its radius on its middle.
fn softened(distance_squared: f32, radius: f32) -> f32 {
    return distance_squared + radius * radius / 3.0;
}

// Mean of 1/d² over a stretch of a ray, divided by its value in the middle, where the vector to the lamp is
// `to_lamp`.
fn mean_falloff(to_lamp: vec3<f32>, radius: f32, ray: vec3<f32>, extent: f32) -> f32 {
    // Bevy's falloff stops growing within 0.01 world units.
    let least = 1e-4;
    let distance_squared = max(softened(dot(to_lamp, to_lamp), radius), least);
    if extent * extent < NEAR_LAMP * NEAR_LAMP * distance_squared {
        return 1.0;
    }
    // The integral is an angle as seen from the lamp.
    let along = dot(to_lamp, ray);
    let across = sqrt(max(distance_squared - along * along, least));
    let ends = (along + 0.5 * extent) * (along - 0.5 * extent);
    let angle = atan2(extent * across, across * across + ends);
    return distance_squared * angle / (across * extent);
}

// Mean illuminance in lux over a stretch of a ray around a point, on surfaces that face a point or spot
// light, to which the vector in the middle is `to_lamp`.
fn lamp_illuminance(data: ClusteredLight, to_lamp: vec3<f32>, ray: vec3<f32>, extent: f32) -> vec3<f32> {
    let distance_squared = dot(to_lamp, to_lamp);
    var cone = 1.0;
    if (data.flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT) != 0u {
        var axis = vec3(data.light_custom_data.x, 0.0, data.light_custom_data.y);
        axis.y = sqrt(max(0.0, 1.0 - axis.x * axis.x - axis.z * axis.z));
        axis.y = select(axis.y, -axis.y, (data.flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE) != 0u);
        let cosine = dot(-axis, to_lamp * inverseSqrt(max(distance_squared, 1e-30)));
        cone = saturate(cosine * data.light_custom_data.z + data.light_custom_data.w);
    }
    let radius = data.position_radius.w;
    let effective_squared = softened(distance_squared, radius);
    let falloff = lighting::getDistanceAttenuation(effective_squared, data.color_inverse_square_range.w);
    let mean = mean_falloff(to_lamp, radius, ray, extent);
    return data.color_inverse_square_range.rgb * (mean * falloff * cone * cone);
}
#endif

// Mean illuminance in lux, on a surface that faces the light, over a stretch of a ray (world space, unit
// length) centred on a point.
fn illuminance_of(at: ShadingPoint, lights: LightList, i: u32, ray: vec3<f32>, extent: f32) -> vec3<f32> {
    if i < lights.suns {
        return sun_factor(i) * bevy::lights.directional_lights[i].color.rgb;
    }
#ifdef VDB_LOCAL_LIGHTS
    let data = bevy::clustered_lights.data[local_light(lights, i)];
    return lamp_illuminance(data, data.position_radius.xyz - at.position, ray, extent);
#else
    return vec3(0.0);
#endif
}
