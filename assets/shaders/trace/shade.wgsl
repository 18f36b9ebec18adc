// Shading of surfaces by Bevy's lights and environment maps, with Bevy's functions, so that a volume matches
// a mesh with the same material.
#define_import_path bevy_vdb::trace::shade

#import bevy_pbr::ambient::ambient_light
#import bevy_pbr::lighting
#ifdef ENVIRONMENT_MAP
#import bevy_pbr::environment_map::environment_map_light
#endif
#ifdef IRRADIANCE_VOLUME
#import bevy_pbr::irradiance_volume::irradiance_volume_light
#endif
#import bevy_vdb::material::VdbSurface
#import bevy_vdb::trace::illuminance::sun_factor
#import bevy_vdb::trace::light_list::{ShadingPoint, is_spot, lights_at, local_light, probes_at}
#ifdef VDB_FIRE_LIGHTS
#import bevy_vdb::trace::light_list::is_fire_light
#endif
#ifdef VDB_RECT_LIGHTS
#import bevy_vdb::trace::rect_lights::reflected_rect_lights
#endif
#import bevy_vdb::trace::segment::Point
#import bevy_vdb::trace::visibility::visibility

// Light from a surface towards the viewer, cd/m².
struct Shaded {
    radiance: vec3<f32>,            // emission, direct light and diffuse ambient light
    ambient_specular: vec3<f32>,    // specular light from environment maps and the ambient light
    specular_weight: vec3<f32>,     // reflectance for light from other surfaces
}

// What lights add to the radiance of a surface. See `shade` for `reflects`.
fn direct_light(
    input: lighting::LightingInput,
    at: ShadingPoint,
    point: Point,
    reflects: bool,
) -> vec3<f32> {
    var direct_input = input;
#ifdef VDB_DIFFUSE_ONLY
    direct_input.F0_dielectric = vec3(0.0);
    direct_input.F0_metallic = vec3(0.0);
#endif
#ifdef VDB_GLOSSY_ONLY
    direct_input.diffuse_color = vec3(0.0);
#endif

#ifdef VDB_FIRE_LIGHTS
    var diffuse_input = direct_input;
    diffuse_input.F0_dielectric = vec3(0.0);
    diffuse_input.F0_metallic = vec3(0.0);
#endif

    var light = vec3(0.0);
    let lights = lights_at(at);
    for (var i = 0u; i < lights.end; i++) {
        let visible = visibility(at, point, lights, i);
        if visible > 0.0 {
            if i < lights.suns {
                light +=
                    (visible * sun_factor(i)) * lighting::directional_light(i, &direct_input, true);
            } else {
#ifdef VDB_LOCAL_LIGHTS
                let local = local_light(lights, i);
#ifdef VDB_FIRE_LIGHTS
                if reflects && is_fire_light(local) {
                    light += visible * lighting::point_light(local, &diffuse_input, true, true);
                    continue;
                }
#endif
                if is_spot(local) {
                    light += visible * lighting::spot_light(local, &direct_input, true);
                } else {
                    light += visible * lighting::point_light(local, &direct_input, true, true);
                }
#endif
            }
        }
    }

#ifdef VDB_RECT_LIGHTS
    light += reflected_rect_lights(direct_input);
#endif
    return light;
}

// What a surface reflects of environment maps, irradiance volumes and the ambient light.
struct Ambient {
    diffuse: vec3<f32>,
    specular: vec3<f32>,
}

fn ambient(shaded: lighting::LightingInput, at: ShadingPoint, specular_color: vec3<f32>) -> Ambient {
    var input = shaded;
    let to_viewer = input.V;
    let n_dot_v = input.layers[0].NdotV;
    let roughness = input.layers[0].perceptual_roughness;
    let position = vec4(at.position, 1.0);
    let black = vec3(0.0);
    let no_occlusion = vec3(1.0);
    var diffuse = ambient_light(
        position,
        at.normal,
        to_viewer,
        n_dot_v,
        input.diffuse_color,
        black,
        roughness,
        no_occlusion,
    );
    var specular = ambient_light(
        position,
        at.normal,
        to_viewer,
        n_dot_v,
        black,
        specular_color,
        roughness,
        no_occlusion,
    );
    // Bevy's approximation returns a small residue even for black; it is contained in both terms.
    let residue =
        ambient_light(position, at.normal, to_viewer, n_dot_v, black, black, roughness, no_occlusion);
    specular -= residue;
    var probes = probes_at(at);
    var has_irradiance = false;
#ifdef IRRADIANCE_VOLUME
    // As in Bevy, it takes the place of diffuse light from environment maps, also where there is none.
    if at.on_view_ray {
        diffuse += irradiance_volume_light(at.position, at.normal, &probes) * input.diffuse_color;
        has_irradiance = true;
    }
#endif
#ifdef ENVIRONMENT_MAP
    let environment = environment_map_light(&input, &probes, has_irradiance);
    diffuse += environment.diffuse;
    specular += environment.specular;
#endif
    return Ambient(diffuse, specular);
}

// Shades a surface. `roughness` is that of the path (see `trace_path`), not that of the material. `reflects` says
// whether a reflected ray follows, which sees fire itself.
fn shade(
    material: VdbSurface,
    at: ShadingPoint,
    point: Point,
    to_viewer: vec3<f32>,
    roughness: f32,
    reflects: bool,
) -> Shaded {
    let base_color = material.base_color;
    let metallic = material.metallic;
    let n_dot_v = max(dot(at.normal, to_viewer), 0.0001);
    let dielectric = vec3(0.16 * material.reflectance * material.reflectance);
    let specular_color = mix(dielectric, base_color, metallic);

    var lighting_input: lighting::LightingInput;
    lighting_input.layers[0].N = at.normal;
    lighting_input.layers[0].R = reflect(-to_viewer, at.normal);
    lighting_input.layers[0].NdotV = n_dot_v;
    lighting_input.layers[0].perceptual_roughness = roughness;
    lighting_input.layers[0].roughness = lighting::perceptualRoughnessToRoughness(roughness);
    lighting_input.P = at.position;
    lighting_input.V = to_viewer;
    lighting_input.diffuse_color = base_color * (1.0 - metallic);
    lighting_input.metallic = metallic;
    lighting_input.F0_dielectric = dielectric;
    lighting_input.F0_metallic = base_color;
    lighting_input.F_ab = lighting::F_AB(roughness, n_dot_v);

    let direct = direct_light(lighting_input, at, point, reflects);
    let around = ambient(lighting_input, at, specular_color);
    // As in Bevy's environment maps.
    let single_scattering = specular_color * lighting_input.F_ab.x + lighting_input.F_ab.y;
    let specular_weight = single_scattering * saturate(dot(specular_color, vec3(50.0 * 0.33)));
#ifdef VDB_DIFFUSE_ONLY
    return Shaded(material.emissive + direct + around.diffuse, vec3(0.0), vec3(0.0));
#else ifdef VDB_GLOSSY_ONLY
    return Shaded(direct, around.specular, specular_weight);
#else
    return Shaded(material.emissive + direct + around.diffuse, around.specular, specular_weight);
#endif
}

// Whether a surface reflects as a mirror: below this roughness, Bevy's own highlights do not become any smaller.
fn is_mirror(roughness: f32) -> bool {
    return roughness < 0.089;
}

// The direction of a reflected ray, sampled from the distribution of microfacet normals if the surface is
// rough. `random` is in [0, 1).
fn sample_reflection(
    roughness: f32,
    normal: vec3<f32>,
    to_viewer: vec3<f32>,
    random: vec2<f32>,
) -> vec3<f32> {
    let mirror_dir = reflect(-to_viewer, normal);
    if is_mirror(roughness) {
        return mirror_dir;
    }
    let alpha = lighting::perceptualRoughnessToRoughness(roughness);
    let direction = lighting::sample_visible_ggx(random, alpha, normal, to_viewer);
    return select(mirror_dir, normalize(direction), dot(direction, normal) > 1e-3);
}
