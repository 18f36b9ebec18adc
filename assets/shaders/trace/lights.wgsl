// Lighting of volumes by the lights and environment maps that Bevy has prepared for the view, in Bevy's
// units (lux, candela, cd/m²) and with Bevy's functions, so that a volume matches a mesh with the same
// material.
#define_import_path bevy_vdb::trace::lights

#import bevy_pbr::ambient::ambient_light
#import bevy_pbr::clustered_forward::{ClusterableObjectIndexRanges, get_clusterable_object_id}
#import bevy_pbr::clustered_forward::{unpack_clusterable_object_index_ranges, view_fragment_cluster_index}
#import bevy_pbr::lighting
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#import bevy_pbr::mesh_view_types::{POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT, POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT}
#import bevy_pbr::mesh_view_types::{ClusteredLight, POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE}
#import bevy_render::maths::PI
#ifdef ENVIRONMENT_MAP
#import bevy_pbr::environment_map::{environment_map_light, quat_rotate}
#endif
#ifdef DISTANCE_FOG
#import bevy_pbr::fog
#import bevy_pbr::mesh_view_types::{FOG_MODE_ATMOSPHERIC, FOG_MODE_EXPONENTIAL, FOG_MODE_EXPONENTIAL_SQUARED}
#import bevy_pbr::mesh_view_types::FOG_MODE_LINEAR
#endif
#ifdef VDB_SHADOWS
#import bevy_pbr::shadows
#import bevy_vdb::trace::occlusion::transmittance
#endif
#ifdef VDB_LIGHT_CACHE
#import bevy_vdb::trace::light_cache::NOT_CACHED
#import bevy_vdb::trace::occlusion::is_occluded
#import bevy_vdb::traversal::fog::SamplePoint
#ifdef VDB_CACHED_LAMPS
#import bevy_vdb::gpu::types::MAX_CACHED_LAMPS
#import bevy_vdb::trace::light_cache::{cached_depth, lamp_group_bricks, lattice_point}
#endif
#endif

#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::gpu::types::{MAX_SUNS, NO_RECEIVER}
#ifdef VDB_SOFT_SUNS
#import bevy_vdb::view::scene::frame_random
#endif
#import bevy_vdb::view::scene::{target_pixel, view, volumes}
#import bevy_vdb::trace::segment::{NONE, Point, world_position}
#import bevy_vdb::trace::scattering::{OCTAVES, octave_anisotropies, octaves_of_depth}

// A point to be lit, in the form that Bevy's functions require.
struct ShadingPoint {
    position: vec3<f32>,    // world space
    normal: vec3<f32>,      // world space, unit length; zero in fog
    // Pixel coordinates in the render target.
    coord: vec2<f32>,
    // Whether the point is visible at the pixel itself; reflected points may be anywhere.
    on_view_ray: bool,
}

// The point to be lit at a pixel of the view's rays. `normal` is zero in fog.
fn shading_point(point: Point, normal: vec3<f32>, pixel: vec2<u32>, on_view_ray: bool) -> ShadingPoint {
    let coord = vec2<f32>(target_pixel(pixel)) + 0.5;
    return ShadingPoint(world_position(point), normal, coord, on_view_ray);
}

// The Bevy lights that can reach a point: directional lights first, then clustered lights.
struct LightList {
    suns: u32,
    end: u32,
    // Index of the first light of the point's cluster, or NO_CLUSTER to use all clustered lights.
    cluster_first: u32,
}

const NO_CLUSTER: u32 = 0xffffffffu;

fn view_z(at: vec3<f32>) -> f32 {
    let m = bevy::view.view_from_world;
    return dot(vec4(m[0].z, m[1].z, m[2].z, m[3].z), vec4(at, 1.0));
}

fn lights_at(at: ShadingPoint) -> LightList {
    let suns = bevy::lights.n_directional_lights;
#ifdef VDB_LOCAL_LIGHTS
    if !at.on_view_ray {
        return LightList(suns, suns + arrayLength(&bevy::clustered_lights.data), NO_CLUSTER);
    }
    let parallel = bevy::view.clip_from_view[3].w == 1.0;
    let cluster = view_fragment_cluster_index(at.coord, view_z(at.position), parallel);
    let ranges = unpack_clusterable_object_index_ranges(cluster);
    let first = ranges.first_point_light_index_offset;
    return LightList(suns, suns + ranges.first_reflection_probe_index_offset - first, first);
#else
    return LightList(suns, suns, 0u);
#endif
}

// Index of a point or spot light in Bevy's list.
fn local_light(lights: LightList, i: u32) -> u32 {
#ifdef VDB_LOCAL_LIGHTS
    if lights.cluster_first != NO_CLUSTER {
        return get_clusterable_object_id(lights.cluster_first + i - lights.suns);
    }
#endif
    return i - lights.suns;
}

fn is_spot(light: u32) -> bool {
    return (bevy::clustered_lights.data[light].flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT) != 0u;
}

// The factor that `VdbSun` sets for a directional light.
fn sun_factor(light: u32) -> f32 {
    let direction = bevy::lights.directional_lights[light].direction_to_light;
    var factor = 1.0;
    for (var i = 0u; i < min(view.sun_count, MAX_SUNS); i++) {
        factor = select(factor, view.suns[i].w, all(view.suns[i].xyz == direction));
    }
    return factor;
}

// Vector to a light in world units; of unit length for directional lights.
fn to_light(at: ShadingPoint, lights: LightList, i: u32) -> vec3<f32> {
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

// Mean transmittance towards a sun with an angular diameter. Samples are spread evenly over its disk after
// Vogel 1979, "A better way to construct the sunflower head", and rotated per pixel by Jimenez's interleaved
// gradient noise, which is evenly distributed among neighbouring pixels.
fn soft_transmittance(at: ShadingPoint, point: Point, to_sun: vec3<f32>, tangent: f32, samples: u32) -> f32 {
    let helper = select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), abs(to_sun.x) > 0.5);
    let right = normalize(cross(helper, to_sun));
    let up = cross(to_sun, right);
    let noise = fract(52.9829189 * fract(dot(at.coord, vec2(0.06711056, 0.00583715))));
    let rotation = 2.0 * PI * fract(noise + view.random_offset);
    let radial_jitter = fract(0.5 + frame_random(0.73205081));
    var sum = 0.0;
    for (var k = 0u; k < samples; k++) {
        let radius = tangent * sqrt((f32(k) + radial_jitter) / f32(samples));
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
        visible = shadows::fetch_directional_shadow(
            i,
            vec4(at.position, 1.0),
            at.normal,
            view_z(at.position),
            at.coord,
        );
    } else {
#ifdef VDB_LOCAL_LIGHTS
        let light = local_light(lights, i);
        if (bevy::clustered_lights.data[light].flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) == 0u {
            return 1.0;
        }
        distance = length(light_vector);
        direction = light_vector / max(distance, 1e-30);
        if is_spot(light) {
            let near = bevy::clustered_lights.data[light].shadow_map_near_z;
            visible = shadows::fetch_spot_shadow(light, vec4(at.position, 1.0), at.normal, near, at.coord);
        } else {
            visible = shadows::fetch_point_shadow(light, vec4(at.position, 1.0), at.normal, at.coord);
        }
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

// Roughness of a surface to a path: at least that of the surfaces hit before. A path scattered by a rough
// surface would otherwise find a sharp highlight in a few pixels only, instead of a little of it in all.
fn path_roughness(volume: u32, roughness_so_far: f32) -> f32 {
    return max(volumes[volume].perceptual_roughness, roughness_so_far);
}

// Light from a surface towards the viewer, cd/m².
struct Shaded {
    radiance: vec3<f32>,            // emission, direct light and diffuse ambient light
    ambient_specular: vec3<f32>,    // specular light from environment maps and the ambient light
    specular_weight: vec3<f32>,     // reflectance for light from other surfaces
}

fn shade(
    volume: u32,
    base_color: vec3<f32>,
    at: ShadingPoint,
    point: Point,
    to_viewer: vec3<f32>,
    roughness: f32,
) -> Shaded {
    let metallic = volumes[volume].metallic;
    let n_dot_v = max(dot(at.normal, to_viewer), 0.0001);
    let dielectric = vec3(0.16 * volumes[volume].reflectance * volumes[volume].reflectance);
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

    var direct_input = lighting_input;
#ifdef VDB_DIFFUSE_ONLY
    direct_input.F0_dielectric = vec3(0.0);
    direct_input.F0_metallic = vec3(0.0);
#endif
#ifdef VDB_GLOSSY_ONLY
    direct_input.diffuse_color = vec3(0.0);
#endif

    var direct_light = vec3(0.0);
    let lights = lights_at(at);
    for (var i = 0u; i < lights.end; i++) {
        let visible = visibility(at, point, lights, i);
        if visible > 0.0 {
            if i < lights.suns {
                direct_light +=
                    (visible * sun_factor(i)) * lighting::directional_light(i, &direct_input, true);
            } else {
#ifdef VDB_LOCAL_LIGHTS
                let local = local_light(lights, i);
                if is_spot(local) {
                    direct_light += visible * lighting::spot_light(local, &direct_input, true);
                } else {
                    direct_light += visible * lighting::point_light(local, &direct_input, true, true);
                }
#endif
            }
        }
    }

    let position = vec4(at.position, 1.0);
    let black = vec3(0.0);
    let view_dir = to_viewer;
    let no_occlusion = vec3(1.0);
    var diffuse = ambient_light(
        position,
        at.normal,
        view_dir,
        n_dot_v,
        lighting_input.diffuse_color,
        black,
        roughness,
        no_occlusion,
    );
    var ambient_specular = ambient_light(
        position,
        at.normal,
        view_dir,
        n_dot_v,
        black,
        specular_color,
        roughness,
        no_occlusion,
    );
    // Bevy's approximation returns a small residue even for black; it is contained in both terms.
    let residue =
        ambient_light(position, at.normal, view_dir, n_dot_v, black, black, roughness, no_occlusion);
    ambient_specular -= residue;
#ifdef ENVIRONMENT_MAP
    // Only used by reflection probes, which are not supported.
    var ranges: ClusterableObjectIndexRanges;
    let environment = environment_map_light(&lighting_input, &ranges, false);
    diffuse += environment.diffuse;
    ambient_specular += environment.specular;
#endif

    // As in Bevy's environment maps.
    let single_scattering = specular_color * lighting_input.F_ab.x + lighting_input.F_ab.y;
    let specular_weight = single_scattering * saturate(dot(specular_color, vec3(50.0 * 0.33)));
#ifdef VDB_DIFFUSE_ONLY
    return Shaded(volumes[volume].emissive + direct_light + diffuse, vec3(0.0), vec3(0.0));
#else ifdef VDB_GLOSSY_ONLY
    return Shaded(direct_light, ambient_specular, specular_weight);
#else
    return Shaded(volumes[volume].emissive + direct_light + diffuse, ambient_specular, specular_weight);
#endif
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
    // Below this roughness, Bevy's own highlights do not become any smaller.
    if roughness < 0.089 {
        return mirror_dir;
    }
    let alpha = lighting::perceptualRoughnessToRoughness(roughness);
    let direction = lighting::sample_visible_ggx(random, alpha, normal, to_viewer);
    return select(mirror_dir, normalize(direction), dot(direction, normal) > 1e-3);
}

// Henyey–Greenstein phase function per steradian, normalised over the sphere. Henyey and Greenstein 1941,
// "Diffuse radiation in the galaxy".
fn phase(anisotropy: f32, cosine: f32) -> f32 {
    // 1 + g² - 2·g·cos, from terms that do not cancel.
    let one_minus_g = 1.0 - anisotropy;
    let root = inverseSqrt(one_minus_g * one_minus_g + 2.0 * anisotropy * (1.0 - cosine));
    return (1.0 - anisotropy * anisotropy) / (4.0 * PI) * (root * root * root);
}

// Whether a light casts shadows.
fn casts_shadows(lights: LightList, i: u32) -> bool {
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

// Mean illuminance in lux, on a surface that faces the light, over a stretch of a ray (world space, unit length)
// centred on a point.
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

// Optical depth that lets a fraction of light through.
fn depth_of(visible: f32) -> f32 {
    return select(FAR, -log(max(visible, 1e-37)), visible > 0.0);
}

// How much of a light arrives in each octave, given how much of it is visible. The first octave is single
// scattering; the others estimate multiple scattering.
fn octaves_of(visible: f32, has_shadows: bool, anisotropy: f32) -> array<f32, OCTAVES> {
    if has_shadows {
        return octaves_of_depth(depth_of(visible), anisotropy);
    }
    // Without shadows, all light is in the first octave.
    var octaves = array<f32, OCTAVES>();
    octaves[0] = visible;
    return octaves;
}

// Adds the light that is scattered along a ray (world space, unit length) from a light, given its illuminance
// and how much of it arrives.
fn add_scattered(
    light: ptr<function, array<vec3<f32>, OCTAVES>>,
    light_vector: vec3<f32>,
    illuminance: vec3<f32>,
    visible: array<f32, OCTAVES>,
    ray: vec3<f32>,
    anisotropy: f32,
) {
    // Forward scattering is towards the viewer from a light straight ahead.
    let cosine = clamp(
        dot(light_vector, ray) * inverseSqrt(max(dot(light_vector, light_vector), 1e-30)),
        -1.0,
        1.0,
    );
    var visibilities = visible;
    var anisotropies = octave_anisotropies(anisotropy);
    for (var octave = 0u; octave < OCTAVES; octave++) {
        (*light)[octave] += (visibilities[octave] * phase(anisotropies[octave], cosine)) * illuminance;
    }
}

// Light scattered over a stretch of a ray (world space, unit length) around a point in fog with an albedo of 1,
// cd/m².
fn in_scattered(
    at: ShadingPoint,
    point: Point,
    ray: vec3<f32>,
    extent: f32,
    anisotropy: f32,
) -> array<vec3<f32>, OCTAVES> {
    var light = array<vec3<f32>, OCTAVES>();
    let lights = lights_at(at);
    for (var i = 0u; i < lights.end; i++) {
        let illuminance = illuminance_of(at, lights, i, ray, extent);
        if any(illuminance > vec3(0.0)) {
            let visible = octaves_of(visibility(at, point, lights, i), casts_shadows(lights, i), anisotropy);
            add_scattered(&light, to_light(at, lights, i), illuminance, visible, ray, anisotropy);
        }
    }
    return light;
}

#ifdef VDB_LIGHT_CACHE
// Slot of a directional light in the light cache; NOT_CACHED if it has none.
fn cached_slot(light: u32) -> u32 {
    let direction = bevy::lights.directional_lights[light].direction_to_light;
    let has_shadows =
        (bevy::lights.directional_lights[light].flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u;
    var slot = NOT_CACHED;
    for (var i = 0u; i < min(view.cached_sun_count, #{VDB_CACHED_SUNS}u); i++) {
        slot = select(slot, i, has_shadows && all(view.cached_suns[i].xyz == direction));
    }
    return slot;
}

// A slot of the light cache, as seen along a ray through fog.
struct CachedSun {
    light: u32,                     // Bevy's index
    illuminance: vec3<f32>,         // lux; 0 if the view does not have the light
    phases: array<f32, OCTAVES>,
}

// The light in a slot, without phases.
fn cached_sun(slot: u32) -> CachedSun {
    var sun = CachedSun(0u, vec3(0.0), array<f32, OCTAVES>());
    for (var i = 0u; i < bevy::lights.n_directional_lights; i++) {
        if cached_slot(i) == slot {
            sun.light = i;
            sun.illuminance += sun_factor(i) * bevy::lights.directional_lights[i].color.rgb;
        }
    }
    return sun;
}

// The phase function of each octave, per steradian, for the light in a slot along a ray (world space, unit
// length).
fn sun_phases(slot: u32, ray: vec3<f32>, anisotropy: f32) -> array<f32, OCTAVES> {
    var phases = array<f32, OCTAVES>();
    let cosine = clamp(dot(view.cached_suns[slot].xyz, ray), -1.0, 1.0);
    var anisotropies = octave_anisotropies(anisotropy);
    for (var octave = 0u; octave < OCTAVES; octave++) {
        phases[octave] = phase(anisotropies[octave], cosine);
    }
    return phases;
}

// Fraction of a cached sun that meshes and surfaces let through to a point in fog.
fn unoccluded(at: ShadingPoint, point: Point, light: u32) -> f32 {
#ifdef VDB_MESH_CASTERS
    let visible = shadows::fetch_directional_shadow(
        light,
        vec4(at.position, 1.0),
        at.normal,
        view_z(at.position),
        at.coord,
    );
#else
    let visible = 1.0;
#endif
    let to_sun = bevy::lights.directional_lights[light].direction_to_light;
    if visible > 0.0 && is_occluded(point, to_sun, FAR) {
        return 0.0;
    }
    return visible;
}

#ifdef VDB_CACHED_LAMPS
// Fraction of a point or spot light that meshes and surfaces let through to a point in fog.
fn unoccluded_lamp(at: ShadingPoint, point: Point, lamp: u32, to_lamp: vec3<f32>) -> f32 {
    var visible = 1.0;
#ifdef VDB_MESH_CASTERS
    if is_spot(lamp) {
        let near = bevy::clustered_lights.data[lamp].shadow_map_near_z;
        visible = shadows::fetch_spot_shadow(lamp, vec4(at.position, 1.0), at.normal, near, at.coord);
    } else {
        visible = shadows::fetch_point_shadow(lamp, vec4(at.position, 1.0), at.normal, at.coord);
    }
#endif
    let distance = length(to_lamp);
    if visible > 0.0 && is_occluded(point, to_lamp / max(distance, 1e-30), distance) {
        return 0.0;
    }
    return visible;
}
#endif

// Light scattered along a ray, and the distance to the nearest of the lamps that it comes from.
struct LocalLight {
    octaves: array<vec3<f32>, OCTAVES>,
    nearest: f32,
}

#ifdef VDB_CACHED_LAMPS
// Adds the light of the lamps in the light cache that is scattered over a stretch of a ray around a point in a
// fog. `place` is that point in the lattice of the fog.
fn add_cached_lamps(
    light: ptr<function, LocalLight>,
    at: ShadingPoint,
    point: Point,
    ray: vec3<f32>,
    extent: f32,
    anisotropy: f32,
    volume: u32,
    place: SamplePoint,
) {
    let in_lattice = lattice_point(volume, place.cell, place.u);
    var octaves = (*light).octaves;
    var nearest_squared = FAR;
    let groups = (min(view.cached_lamp_count, MAX_CACHED_LAMPS) + 3u) / 4u;
    for (var group = 0u; group < groups; group++) {
        let lamps = view.cached_lamps[group];
        let bricks = lamp_group_bricks(volume, group);
        // Four samples at once, so that the GPU does not wait for each.
        var depths = vec4(0.0);
        for (var i = 0u; i < 4u; i++) {
            depths[i] = cached_depth(in_lattice, select(bricks[i], 0u, bricks[i] == NOT_CACHED));
        }
        for (var i = 0u; i < 4u; i++) {
            let data = bevy::clustered_lights.data[lamps[i]];
            let has_shadows = (data.flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u;
            if has_shadows && bricks[i] != NOT_CACHED {
                let to_lamp = data.position_radius.xyz - at.position;
                let illuminance = lamp_illuminance(data, to_lamp, ray, extent);
                // Of all lamps: the ray may meet the cone or the range of this one between samples.
                nearest_squared = min(nearest_squared, dot(to_lamp, to_lamp));
                if any(illuminance > vec3(0.0)) {
                    let occlusion = depth_of(unoccluded_lamp(at, point, lamps[i], to_lamp));
                    let visible = octaves_of_depth(depths[i] + occlusion, anisotropy);
                    add_scattered(&octaves, to_lamp, illuminance, visible, ray, anisotropy);
                }
            }
        }
    }
    (*light).octaves = octaves;
    (*light).nearest = min((*light).nearest, sqrt(nearest_squared));
}

// Whether a point or spot light has a lattice in a fog.
fn is_cached_lamp(volume: u32, lamp: u32) -> bool {
    var is_cached = false;
    for (var slot = 0u; slot < min(view.cached_lamp_count, MAX_CACHED_LAMPS); slot++) {
        if view.cached_lamps[slot / 4u][slot % 4u] == lamp {
            is_cached = lamp_group_bricks(volume, slot / 4u)[slot % 4u] != NOT_CACHED;
        }
    }
    return is_cached;
}
#endif

#ifdef VDB_OTHER_LIGHTS
// Adds the light of all suns and lamps that have no shadows or are not in the light cache.
fn add_other_lights(
    light: ptr<function, LocalLight>,
    at: ShadingPoint,
    point: Point,
    ray: vec3<f32>,
    extent: f32,
    anisotropy: f32,
    volume: u32,
) {
    var octaves = (*light).octaves;
    let lights = lights_at(at);
    for (var i = 0u; i < lights.end; i++) {
        let has_shadows = casts_shadows(lights, i);
        var is_cached = false;
#ifdef VDB_UNCACHED_LIGHTS
        if i < lights.suns {
            is_cached = cached_slot(i) != NOT_CACHED;
        } else if has_shadows {
#ifdef VDB_CACHED_LAMPS
            is_cached = is_cached_lamp(volume, local_light(lights, i));
#endif
        }
#else
        // Those that are not in the cache are new, and wait for other shaders.
        is_cached = has_shadows;
#endif
        let light_vector = to_light(at, lights, i);
        if i >= lights.suns && !is_cached {
            (*light).nearest = min((*light).nearest, length(light_vector));
        }
        let illuminance = illuminance_of(at, lights, i, ray, extent);
        if !is_cached && any(illuminance > vec3(0.0)) {
            var visible = 1.0;
#ifdef VDB_UNCACHED_LIGHTS
            visible = visibility(at, point, lights, i);
#endif
            let visibilities = octaves_of(visible, has_shadows, anisotropy);
            add_scattered(&octaves, light_vector, illuminance, visibilities, ray, anisotropy);
        }
    }
    (*light).octaves = octaves;
}
#endif
#endif

#ifdef VDB_LOCAL_LIGHTS
// Stretches shorter than this fraction of the distance to a lamp are represented by their midpoint.
const NEAR_LAMP: f32 = 0.25;

// Mean of 1/d² over a stretch of a ray, divided by its value in the middle, where the vector to the lamp is
// `to_lamp`.
fn mean_falloff(to_lamp: vec3<f32>, ray: vec3<f32>, extent: f32) -> f32 {
    // Bevy's falloff stops growing within 0.01 world units.
    let least = 1e-4;
    let distance_squared = max(dot(to_lamp, to_lamp), least);
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

// Mean illuminance in lux over a stretch of a ray around a point, on surfaces that face a point or spot light,
// to which the vector in the middle is `to_lamp`.
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
    let falloff = lighting::getDistanceAttenuation(distance_squared, data.color_inverse_square_range.w);
    let mean = mean_falloff(to_lamp, ray, extent);
    return data.color_inverse_square_range.rgb * (mean * falloff * cone * cone);
}
#endif

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
            let hemisphere = textureSampleLevel(
                bevy::diffuse_environment_map,
                bevy::environment_map_sampler,
                axis,
                0.0,
            ).rgb;
            mean += hemisphere / 6.0;
            forward += hemisphere * (0.75 * dot(axis, direction));
        }
        light.mean += mean * bevy::light_probes.intensity_for_view;
        light.forward += forward * bevy::light_probes.intensity_for_view;
    }
#endif
    return light;
}

#ifdef DISTANCE_FOG
// Applies Bevy's distance fog as `bevy_pbr::pbr_functions::apply_fog` does for meshes. `color` is multiplied
// by the exposure and premultiplied by coverage.
fn apply_distance_fog(color: vec3<f32>, coverage: f32, at: ShadingPoint) -> vec3<f32> {
    let from_camera = at.position - bevy::view.world_position;
    let distance = max(length(from_camera), 1e-30);
    var scattering = vec3(0.0);
    if bevy::fog.directional_light_color.a > 0.0 {
        for (var i = 0u; i < min(bevy::lights.n_directional_lights, MAX_SUNS); i++) {
            let cosine = max(
                dot(from_camera / distance, bevy::lights.directional_lights[i].direction_to_light),
                0.0,
            );
            var weight = pow(cosine, bevy::fog.directional_light_exponent);
#ifdef VDB_SHADOWS
            let flags = bevy::lights.directional_lights[i].flags;
            if (flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u {
                let z = view_z(at.position);
                weight *= shadows::fetch_directional_shadow(
                    i,
                    vec4(at.position, 1.0),
                    -from_camera / distance,
                    z,
                    at.coord,
                );
            }
#endif
            scattering += weight * bevy::view.exposure * bevy::lights.directional_lights[i].color.rgb;
        }
    }
    let straight = vec4(color / max(coverage, 1e-4), 1.0);
    var fogged = straight;
    switch bevy::fog.mode {
        case FOG_MODE_LINEAR: {
            fogged = fog::linear_fog(bevy::fog, straight, distance, scattering);
        }
        case FOG_MODE_EXPONENTIAL: {
            fogged = fog::exponential_fog(bevy::fog, straight, distance, scattering);
        }
        case FOG_MODE_EXPONENTIAL_SQUARED: {
            fogged = fog::exponential_squared_fog(bevy::fog, straight, distance, scattering);
        }
        case FOG_MODE_ATMOSPHERIC: {
            fogged = fog::atmospheric_fog(bevy::fog, straight, distance, scattering);
        }
        default: {}
    }
    return coverage * fogged.rgb;
}
#endif
