// Light on volumes: the lights and environment maps that Bevy has prepared for the view, in its units
// (lux, candela, cd/m²), through its own functions, so that a volume looks as a mesh of the same
// material does.
#define_import_path bevy_vdb::trace::lights

#import bevy_pbr::ambient::ambient_light
#import bevy_pbr::clustered_forward::{ClusterableObjectIndexRanges, get_clusterable_object_id, unpack_clusterable_object_index_ranges, view_fragment_cluster_index}
#import bevy_pbr::lighting
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT, POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT, POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT, POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE}
#import bevy_render::maths::PI
#ifdef ENVIRONMENT_MAP
#import bevy_pbr::environment_map::{environment_map_light, quat_rotate}
#endif
#ifdef DISTANCE_FOG
#import bevy_pbr::fog
#import bevy_pbr::mesh_view_types::{FOG_MODE_ATMOSPHERIC, FOG_MODE_EXPONENTIAL, FOG_MODE_EXPONENTIAL_SQUARED, FOG_MODE_LINEAR}
#endif
#ifdef VDB_SHADOWS
#import bevy_pbr::shadows
#import bevy_vdb::trace::occlusion::transmittance
#endif

#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::gpu::types::{MOST_SUNS, NO_RECEIVER}
#ifdef VDB_SOFT_SUNS
#import bevy_vdb::view::scene::chance_of_frame
#endif
#import bevy_vdb::view::scene::{view, volumes}
#import bevy_vdb::trace::segment::{NONE, Point}
#import bevy_vdb::trace::scattering::{OCTAVES, ROUNDER}

// A place that is lit, as Bevy's functions ask for it.
struct Lit {
    position: vec3<f32>,    // world space
    normal: vec3<f32>,      // world space, unit; zero in fog
    // Of the pixel, in the target.
    coord: vec2<f32>,
    // Whether the place is in the pixel; a reflected one is anywhere.
    in_pixel: bool,
}

// Which of Bevy's lights can reach a place: the directional ones, then those with a position.
struct Reaching {
    suns: u32,
    end: u32,
    // Where the second kind begins in the list of the place's cluster, or NO_CLUSTER: all there are.
    first: u32,
}

const NO_CLUSTER: u32 = 0xffffffffu;

fn view_z(at: vec3<f32>) -> f32 {
    let m = bevy::view.view_from_world;
    return dot(vec4(m[0].z, m[1].z, m[2].z, m[3].z), vec4(at, 1.0));
}

fn reaching(at: Lit) -> Reaching {
    let suns = bevy::lights.n_directional_lights;
#ifdef VDB_LOCAL_LIGHTS
    if !at.in_pixel {
        return Reaching(suns, suns + arrayLength(&bevy::clustered_lights.data), NO_CLUSTER);
    }
    let parallel = bevy::view.clip_from_view[3].w == 1.0;
    let cluster = view_fragment_cluster_index(at.coord, view_z(at.position), parallel);
    let ranges = unpack_clusterable_object_index_ranges(cluster);
    let first = ranges.first_point_light_index_offset;
    return Reaching(suns, suns + ranges.first_reflection_probe_index_offset - first, first);
#else
    return Reaching(suns, suns, 0u);
#endif
}

// The index in Bevy's list of a light that is not directional.
fn local_light(lights: Reaching, i: u32) -> u32 {
#ifdef VDB_LOCAL_LIGHTS
    if lights.first != NO_CLUSTER {
        return get_clusterable_object_id(lights.first + i - lights.suns);
    }
#endif
    return i - lights.suns;
}

fn is_spot(light: u32) -> bool {
    return (bevy::clustered_lights.data[light].flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT) != 0u;
}

// What VdbSun says of a directional light.
fn sun_factor(light: u32) -> f32 {
    let direction = bevy::lights.directional_lights[light].direction_to_light;
    var factor = 1.0;
    for (var i = 0u; i < min(view.sun_count, MOST_SUNS); i++) {
        factor = select(factor, view.suns[i].w, all(view.suns[i].xyz == direction));
    }
    return factor;
}

// Towards a light, in world units; of a directional one, unit.
fn to_light(at: Lit, lights: Reaching, i: u32) -> vec3<f32> {
    if i < lights.suns {
        return bevy::lights.directional_lights[i].direction_to_light;
    }
#ifdef VDB_LOCAL_LIGHTS
    return bevy::clustered_lights.data[local_light(lights, i)].position_radius.xyz - at.position;
#else
    return vec3(0.0);
#endif
}

#ifdef VDB_SOFT_SUNS
// What VdbSun says of the size of a light: as `View` has it.
fn sun_disk(lights: Reaching, light: u32) -> vec4<f32> {
    var disk = vec4(0.0);
    if light < lights.suns {
        let direction = bevy::lights.directional_lights[light].direction_to_light;
        for (var i = 0u; i < min(view.sun_count, MOST_SUNS); i++) {
            disk = select(disk, view.disks[i], all(view.suns[i].xyz == direction));
        }
    }
    return disk;
}

// The part of a round sun's light that comes to a place, by rays to places spread evenly over its disk, after
// Vogel 1979, "A better way to construct the sunflower head", turned by random numbers for each pixel: by the
// noise of Jorge Jimenez's that neighbours share evenly among them.
fn soft_transmittance(at: Lit, point: Point, to_sun: vec3<f32>, tangent: f32, samples: u32) -> f32 {
    let across = select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), abs(to_sun.x) > 0.5);
    let right = normalize(cross(across, to_sun));
    let up = cross(to_sun, right);
    let noise = fract(52.9829189 * fract(dot(at.coord, vec2(0.06711056, 0.00583715))));
    let turn = 2.0 * PI * fract(noise + view.turn);
    let ring = fract(0.5 + chance_of_frame(0.73205081));
    var lit = 0.0;
    for (var k = 0u; k < samples; k++) {
        let radius = tangent * sqrt((f32(k) + ring) / f32(samples));
        let angle = turn + 2.39996323 * f32(k);
        let way = normalize(to_sun + radius * (cos(angle) * right + sin(angle) * up));
        if dot(way, at.normal) > 0.0 {
            lit += transmittance(point, way, FAR, false);
        }
    }
    return lit / f32(samples);
}
#endif

// The part of a light's rays that come to a place: what meshes leave of it, as Bevy's shadow maps
// have it, then what volumes leave.
fn visibility(at: Lit, point: Point, lights: Reaching, i: u32) -> f32 {
#ifdef VDB_SHADOWS
    let way = to_light(at, lights, i);
    if any(at.normal != vec3(0.0)) && dot(at.normal, way) <= 0.0 {
        return 0.0;
    }
    if point.own != NONE && (volumes[point.own].flags & NO_RECEIVER) != 0u {
        return 1.0;
    }
    var lit = 1.0;
    var distance = FAR;
    var direction = way;
    if i < lights.suns {
        let flags = bevy::lights.directional_lights[i].flags;
        if (flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) == 0u {
            return 1.0;
        }
        lit = shadows::fetch_directional_shadow(i, vec4(at.position, 1.0), at.normal, view_z(at.position), at.coord);
    } else {
#ifdef VDB_LOCAL_LIGHTS
        let light = local_light(lights, i);
        if (bevy::clustered_lights.data[light].flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) == 0u {
            return 1.0;
        }
        distance = length(way);
        direction = way / max(distance, 1e-30);
        if is_spot(light) {
            let near = bevy::clustered_lights.data[light].shadow_map_near_z;
            lit = shadows::fetch_spot_shadow(light, vec4(at.position, 1.0), at.normal, near, at.coord);
        } else {
            lit = shadows::fetch_point_shadow(light, vec4(at.position, 1.0), at.normal, at.coord);
        }
#endif
    }
    if lit > 0.0 {
        let in_fog = !any(at.normal != vec3(0.0));
#ifdef VDB_SOFT_SUNS
        let disk = sun_disk(lights, i);
        if disk.x > 0.0 && !in_fog {
            return lit * soft_transmittance(at, point, direction, disk.x, u32(disk.y));
        }
#endif
        lit *= transmittance(point, direction, distance, in_fog);
    }
    return lit;
#else
    return 1.0;
#endif
}

// How rough a surface is to a ray that rough surfaces have sent there: no less than they are. By random
// numbers, such a ray meets a sharp highlight in one pixel of many, where all should see a little of it.
fn roughness_seen(volume: u32, so_far: f32) -> f32 {
    return max(volumes[volume].perceptual_roughness, so_far);
}

// What a surface sends to the viewer, cd/m².
struct Shaded {
    light: vec3<f32>,       // its own, and that of lights and of the diffuse surroundings
    mirrored: vec3<f32>,    // of the surroundings, as environment maps and the ambient light have them
    mirror: vec3<f32>,      // the part that it reflects of what stands there instead
}

fn shade(
    volume: u32,
    base_color: vec3<f32>,
    at: Lit,
    point: Point,
    to_viewer: vec3<f32>,
    roughness: f32,
) -> Shaded {
    let metallic = volumes[volume].metallic;
    let n_dot_v = max(dot(at.normal, to_viewer), 0.0001);
    let dielectric = vec3(0.16 * volumes[volume].reflectance * volumes[volume].reflectance);
    let specular_color = mix(dielectric, base_color, metallic);

    var layer: lighting::LightingInput;
    layer.layers[0].N = at.normal;
    layer.layers[0].R = reflect(-to_viewer, at.normal);
    layer.layers[0].NdotV = n_dot_v;
    layer.layers[0].perceptual_roughness = roughness;
    layer.layers[0].roughness = lighting::perceptualRoughnessToRoughness(roughness);
    layer.P = at.position;
    layer.V = to_viewer;
    layer.diffuse_color = base_color * (1.0 - metallic);
    layer.metallic = metallic;
    layer.F0_dielectric = dielectric;
    layer.F0_metallic = base_color;
    layer.F_ab = lighting::F_AB(roughness, n_dot_v);

    var direct = layer;
#ifdef VDB_DIFFUSE_ONLY
    direct.F0_dielectric = vec3(0.0);
    direct.F0_metallic = vec3(0.0);
#endif
#ifdef VDB_GLOSSY_ONLY
    direct.diffuse_color = vec3(0.0);
#endif

    var light = vec3(0.0);
    let lights = reaching(at);
    for (var i = 0u; i < lights.end; i++) {
        let lit = visibility(at, point, lights, i);
        if lit > 0.0 {
            if i < lights.suns {
                light += (lit * sun_factor(i)) * lighting::directional_light(i, &direct, true);
            } else {
#ifdef VDB_LOCAL_LIGHTS
                let local = local_light(lights, i);
                if is_spot(local) {
                    light += lit * lighting::spot_light(local, &direct, true);
                } else {
                    light += lit * lighting::point_light(local, &direct, true, true);
                }
#endif
            }
        }
    }

    let around = vec4(at.position, 1.0);
    let no_color = vec3(0.0);
    let v = to_viewer;
    let one = vec3(1.0);
    var diffuse = ambient_light(around, at.normal, v, n_dot_v, layer.diffuse_color, no_color, roughness, one);
    var mirrored = ambient_light(around, at.normal, v, n_dot_v, no_color, specular_color, roughness, one);
    // Of no colour at all, Bevy's approximation leaves a trace, which is in both.
    let trace = ambient_light(around, at.normal, v, n_dot_v, no_color, no_color, roughness, one);
    mirrored -= trace;
#ifdef ENVIRONMENT_MAP
    // Of use with reflection probes, which are not taken into account.
    var ranges: ClusterableObjectIndexRanges;
    let environment = environment_map_light(&layer, &ranges, false);
    diffuse += environment.diffuse;
    mirrored += environment.specular;
#endif

    // As Bevy has it for environment maps.
    let single = specular_color * layer.F_ab.x + layer.F_ab.y;
    let mirror = single * saturate(dot(specular_color, vec3(50.0 * 0.33)));
#ifdef VDB_DIFFUSE_ONLY
    return Shaded(volumes[volume].emissive + light + diffuse, vec3(0.0), vec3(0.0));
#else ifdef VDB_GLOSSY_ONLY
    return Shaded(light, mirrored, mirror);
#else
    return Shaded(volumes[volume].emissive + light + diffuse, mirrored, mirror);
#endif
}

// A direction in which a surface reflects what is before it: of a rough one, one of many, by two numbers
// from 0 up to but not 1.
fn reflected(roughness: f32, normal: vec3<f32>, to_viewer: vec3<f32>, chance: vec2<f32>) -> vec3<f32> {
    let mirror = reflect(-to_viewer, normal);
    // Below this, Bevy's own highlights get no smaller.
    if roughness < 0.089 {
        return mirror;
    }
    let alpha = lighting::perceptualRoughnessToRoughness(roughness);
    let direction = lighting::sample_visible_ggx(chance, alpha, normal, to_viewer);
    return select(mirror, normalize(direction), dot(direction, normal) > 1e-3);
}

// The part of the light that a fog turns by an angle with this cosine when it scatters it, per
// steradian. Henyey and Greenstein 1941, "Diffuse radiation in the galaxy"; over all directions it is 1.
fn phase(anisotropy: f32, cosine: f32) -> f32 {
    // 1 + g² - 2·g·cos, from terms that do not cancel.
    let aside = 1.0 - anisotropy;
    let square = aside * aside + 2.0 * anisotropy * (1.0 - cosine);
    return (1.0 - anisotropy * anisotropy) / (4.0 * PI * square * sqrt(square));
}

// Whether a light throws shadows.
fn is_shadowed(lights: Reaching, i: u32) -> bool {
    if i < lights.suns {
        return (bevy::lights.directional_lights[i].flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u;
    }
#ifdef VDB_LOCAL_LIGHTS
    let flags = bevy::clustered_lights.data[local_light(lights, i)].flags;
    return (flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u;
#else
    return false;
#endif
}

// What a place in a fog of albedo 1 scatters back along a ray (world space, unit), of what comes to it
// straight from lights, and in octaves of what comes to it otherwise, cd/m².
fn scattered(at: Lit, point: Point, ray: vec3<f32>, anisotropy: f32) -> array<vec3<f32>, OCTAVES> {
    var light = array<vec3<f32>, OCTAVES>();
    let lights = reaching(at);
    for (var i = 0u; i < lights.end; i++) {
        let lit = visibility(at, point, lights, i);
        let way = to_light(at, lights, i);
        // Light that goes straight on comes from straight ahead.
        let cosine = clamp(dot(way, ray) * inverseSqrt(max(dot(way, way), 1e-30)), -1.0, 1.0);
        var illuminance = vec3(0.0);
        if i < lights.suns {
            illuminance = sun_factor(i) * bevy::lights.directional_lights[i].color.rgb;
        } else {
#ifdef VDB_LOCAL_LIGHTS
            illuminance = local_illuminance(at, local_light(lights, i));
#endif
        }
        var seen = lit;
        var rounder = anisotropy;
        for (var octave = 0u; octave < OCTAVES && seen > 0.0; octave++) {
            light[octave] += (seen * phase(rounder, cosine)) * illuminance;
            // Half the optical depth; of light that nothing dims, all is in the first octave.
            seen = select(0.0, sqrt(seen), is_shadowed(lights, i));
            rounder *= ROUNDER;
        }
    }
    return light;
}

#ifdef VDB_LOCAL_LIGHTS
// Lux on a surface that faces a point or spot light.
fn local_illuminance(at: Lit, light: u32) -> vec3<f32> {
    let data = bevy::clustered_lights.data[light];
    let way = data.position_radius.xyz - at.position;
    let square = dot(way, way);
    var cone = 1.0;
    if is_spot(light) {
        var axis = vec3(data.light_custom_data.x, 0.0, data.light_custom_data.y);
        axis.y = sqrt(max(0.0, 1.0 - axis.x * axis.x - axis.z * axis.z));
        axis.y = select(axis.y, -axis.y, (data.flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE) != 0u);
        let cosine = dot(-axis, way * inverseSqrt(max(square, 1e-30)));
        cone = saturate(cosine * data.light_custom_data.z + data.light_custom_data.w);
    }
    let falloff = lighting::getDistanceAttenuation(square, data.color_inverse_square_range.w);
    return data.color_inverse_square_range.rgb * (falloff * cone * cone);
}
#endif

// The first two orders of the light that surrounds everything, cd/m².
struct Surroundings {
    mean: vec3<f32>,
    // What there is more of it straight ahead, as far as it grows evenly from behind to there: of any light
    // around, Henyey and Greenstein's phase function leaves `anisotropy` times this.
    ahead: vec3<f32>,
}

// As seen along a ray (world space, unit).
fn surroundings(ray: vec3<f32>) -> Surroundings {
    var light = Surroundings(bevy::lights.ambient_color.rgb, vec3(0.0));
#ifdef ENVIRONMENT_MAP
    if bevy::light_probes.view_cubemap_index >= 0 {
        var way = quat_rotate(bevy::light_probes.view_rotation, ray);
        // As Bevy has it: cube maps are left-handed.
        way.z = -way.z;
        // Each is a mean over a hemisphere, weighted with the cosine; six of them make that of the sphere.
        // Of what grows evenly with the cosine, such a mean has 2/3.
        var mean = vec3(0.0);
        var ahead = vec3(0.0);
        for (var i = 0u; i < 6u; i++) {
            let sign = select(1.0, -1.0, i >= 3u);
            let axis = select(vec3(0.0), vec3(sign), vec3(0u, 1u, 2u) == vec3(i % 3u));
            let half = textureSampleLevel(bevy::diffuse_environment_map, bevy::environment_map_sampler, axis, 0.0).rgb;
            mean += half / 6.0;
            ahead += half * (0.75 * dot(axis, way));
        }
        light.mean += mean * bevy::light_probes.intensity_for_view;
        light.ahead += ahead * bevy::light_probes.intensity_for_view;
    }
#endif
    return light;
}

#ifdef DISTANCE_FOG
// What is seen of a place through Bevy's distance fog, as `bevy_pbr::pbr_functions::apply_fog` has it
// for meshes. `color` is in the camera's values, and multiplied with coverage.
fn through_distance_fog(color: vec3<f32>, coverage: f32, at: Lit) -> vec3<f32> {
    let way = at.position - bevy::view.world_position;
    let distance = max(length(way), 1e-30);
    var scattering = vec3(0.0);
    if bevy::fog.directional_light_color.a > 0.0 {
        for (var i = 0u; i < min(bevy::lights.n_directional_lights, MOST_SUNS); i++) {
            let toward = max(dot(way / distance, bevy::lights.directional_lights[i].direction_to_light), 0.0);
            var lit = pow(toward, bevy::fog.directional_light_exponent);
#ifdef VDB_SHADOWS
            let flags = bevy::lights.directional_lights[i].flags;
            if (flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u {
                let z = view_z(at.position);
                lit *= shadows::fetch_directional_shadow(i, vec4(at.position, 1.0), -way / distance, z, at.coord);
            }
#endif
            scattering += lit * bevy::view.exposure * bevy::lights.directional_lights[i].color.rgb;
        }
    }
    let straight = vec4(color / max(coverage, 1e-4), 1.0);
    var seen = straight;
    switch bevy::fog.mode {
        case FOG_MODE_LINEAR: {
            seen = fog::linear_fog(bevy::fog, straight, distance, scattering);
        }
        case FOG_MODE_EXPONENTIAL: {
            seen = fog::exponential_fog(bevy::fog, straight, distance, scattering);
        }
        case FOG_MODE_EXPONENTIAL_SQUARED: {
            seen = fog::exponential_squared_fog(bevy::fog, straight, distance, scattering);
        }
        case FOG_MODE_ATMOSPHERIC: {
            seen = fog::atmospheric_fog(bevy::fog, straight, distance, scattering);
        }
        default: {}
    }
    return coverage * seen.rgb;
}
#endif
