// The points that are lit, and the lights of Bevy that can reach them.
#define_import_path bevy_vdb::trace::light_list

#import bevy_pbr::clustered_forward::{get_clusterable_object_id, unpack_clusterable_object_index_ranges}
#import bevy_pbr::clustered_forward::{ClusterableObjectIndexRanges, view_fragment_cluster_index}
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#import bevy_pbr::mesh_view_types::{POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT, POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT}
#ifdef VDB_FIRE_LIGHTS
#import bevy_vdb::gpu::types::MAX_FIRE_LIGHTS
#import bevy_vdb::view::scene::view
#endif

// A point to be lit, in the form that Bevy's functions require.
struct ShadingPoint {
    position: vec3<f32>,    // world space
    normal: vec3<f32>,      // world space, unit length; zero in fog
    // Pixel coordinates in the render target.
    coord: vec2<f32>,
    // Whether the point is visible at the pixel itself; reflected points may be anywhere.
    on_view_ray: bool,
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

// Bevy's cluster of a point on a view ray.
fn cluster_at(at: ShadingPoint) -> u32 {
    let is_parallel = bevy::view.clip_from_view[3].w == 1.0;
    return view_fragment_cluster_index(at.coord, view_z(at.position), is_parallel);
}

fn lights_at(at: ShadingPoint) -> LightList {
    let suns = bevy::lights.n_directional_lights;
#ifdef VDB_LOCAL_LIGHTS
    if !at.on_view_ray {
        return LightList(suns, suns + arrayLength(&bevy::clustered_lights.data), NO_CLUSTER);
    }
    let ranges = unpack_clusterable_object_index_ranges(cluster_at(at));
    let first = ranges.first_point_light_index_offset;
    return LightList(suns, suns + ranges.first_reflection_probe_index_offset - first, first);
#else
    return LightList(suns, suns, 0u);
#endif
}

// Where the light probes are listed that can reach a point: nowhere for reflected points, which are in no cluster.
fn probes_at(at: ShadingPoint) -> ClusterableObjectIndexRanges {
    if !at.on_view_ray {
        return ClusterableObjectIndexRanges();
    }
    return unpack_clusterable_object_index_ranges(cluster_at(at));
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

#ifdef VDB_FIRE_LIGHTS
// Whether a point light stands for a fire.
fn is_fire_light(light: u32) -> bool {
    var is_fire = false;
    for (var i = 0u; i < min(view.fire_light_count, MAX_FIRE_LIGHTS); i++) {
        is_fire |= view.fire_lights[i / 4u][i % 4u] == light;
    }
    return is_fire;
}
#endif

fn is_spot(light: u32) -> bool {
    return (bevy::clustered_lights.data[light].flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT) != 0u;
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
