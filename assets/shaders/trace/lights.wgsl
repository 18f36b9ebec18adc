// Light that fog scatters towards the viewer, from the lights and environment maps that Bevy has prepared for
// the view, by rays to the lights, in Bevy's units (lux, candela, cd/m²).
#define_import_path bevy_vdb::trace::lights

#import bevy_pbr::mesh_view_bindings as bevy
#ifdef ENVIRONMENT_MAP
#import bevy_pbr::environment_map::quat_rotate
#endif
#import bevy_vdb::trace::illuminance::illuminance_of
#import bevy_vdb::trace::light_list::{ShadingPoint, casts_shadows, lights_at, to_light}
#import bevy_vdb::trace::scattering::{InScattered, Scatterer, add_attenuated, add_unattenuated}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattering::add_occlusion
#endif
#import bevy_vdb::trace::segment::{Point, world_position}
#import bevy_vdb::trace::visibility::visibility
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::target_pixel
#ifdef VDB_RECT_LIGHTS
#import bevy_vdb::trace::rect_lights::scattered_rect_lights
#endif

// The point to be lit at a pixel of the view's rays. `normal` is zero in fog.
fn shading_point(point: Point, normal: vec3<f32>, pixel: vec2<u32>, on_view_ray: bool) -> ShadingPoint {
    let coord = vec2<f32>(target_pixel(pixel)) + 0.5;
    return ShadingPoint(world_position(point), normal, coord, on_view_ray);
}

// Optical depth that lets a fraction of light through.
fn depth_of(visible: f32) -> f32 {
    return select(FAR, -log(max(visible, 1e-37)), visible > 0.0);
}

// The cosine of the angle between a ray (world space, unit length) and the direction to a light. Forward scattering
// is towards the viewer from a light straight ahead.
fn light_cosine(light_vector: vec3<f32>, ray: vec3<f32>) -> f32 {
    let inverse_length = inverseSqrt(max(dot(light_vector, light_vector), 1e-30));
    return clamp(dot(light_vector, ray) * inverse_length, -1.0, 1.0);
}

// Adds the light that is scattered along a ray (world space, unit length) from a light, given its illuminance and
// how much of it is visible.
fn add_scattered(
    light: ptr<function, InScattered>,
    light_vector: vec3<f32>,
    illuminance: vec3<f32>,
    visible: f32,
    has_shadows: bool,
    ray: vec3<f32>,
    scatterer: Scatterer,
) {
    let cosine = light_cosine(light_vector, ray);
    if !has_shadows {
        // No optical depth towards the light is known.
        add_unattenuated(light, visible * illuminance, cosine, scatterer.anisotropy);
        return;
    }
#ifdef VDB_SCATTERED
    // Fog alone leaves some of it.
    add_occlusion(light, illuminance, select(0.0, 1.0, visible > 0.0));
#endif
    add_attenuated(light, illuminance, depth_of(visible), cosine, scatterer);
}

// Light scattered over a stretch of a ray (world space, unit length) around a point in fog with an albedo of
// 1, cd/m².
fn in_scattered(
    at: ShadingPoint,
    point: Point,
    ray: vec3<f32>,
    extent: f32,
    scatterer: Scatterer,
) -> InScattered {
    var light = InScattered();
    let lights = lights_at(at);
    for (var i = 0u; i < lights.end; i++) {
        let illuminance = illuminance_of(at, lights, i, ray, extent);
        if any(illuminance > vec3(0.0)) {
            let visible = visibility(at, point, lights, i);
            let has_shadows = casts_shadows(lights, i);
            add_scattered(&light, to_light(at, lights, i), illuminance, visible, has_shadows, ray, scatterer);
        }
    }
#ifdef VDB_RECT_LIGHTS
    light.whole += scattered_rect_lights(at.position, ray, extent, scatterer.anisotropy).light;
#endif
    return light;
}

// The first two orders of the light from the environment, cd/m².
struct EnvironmentLight {
    mean: vec3<f32>,
    // The linear term in the forward direction: radiance is about `mean + forward·cos θ`. The
    // Henyey–Greenstein phase function scales this order by the anisotropy.
    forward: vec3<f32>,
}

// The environment as seen along a ray (world space, unit length).
fn environment_light(ray: vec3<f32>) -> EnvironmentLight {
    var light = EnvironmentLight(bevy::lights.ambient_color.rgb, vec3(0.0));
#ifdef ENVIRONMENT_MAP
    if bevy::light_probes.view_cubemap_index >= 0 {
        var direction = quat_rotate(bevy::light_probes.view_rotation, ray);
        // As in Bevy: cube maps are left-handed.
        direction.z = -direction.z;
        // Each texel is a cosine-weighted mean over a hemisphere; the mean of six such texels is that of the
        // sphere. For radiance proportional to the cosine, a hemisphere's mean is 2/3.
        var mean = vec3(0.0);
        var forward = vec3(0.0);
        for (var i = 0u; i < 6u; i++) {
            let sign = select(1.0, -1.0, i >= 3u);
            let axis = select(vec3(0.0), vec3(sign), vec3(0u, 1u, 2u) == vec3(i % 3u));
#ifdef MULTIPLE_LIGHT_PROBES_IN_ARRAY
            let map = bevy::diffuse_environment_maps[bevy::light_probes.view_cubemap_index];
#else
            let map = bevy::diffuse_environment_map;
#endif
            let hemisphere = textureSampleLevel(map, bevy::environment_map_sampler, axis, 0.0).rgb;
            mean += hemisphere / 6.0;
            forward += hemisphere * (0.75 * dot(axis, direction));
        }
        light.mean += mean * bevy::light_probes.intensity_for_view;
        light.forward += forward * bevy::light_probes.intensity_for_view;
    }
#endif
    return light;
}
