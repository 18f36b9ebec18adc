// The fraction of a light that fog lets through to a point, from the shadow maps with fog and without: means over as many
// texels as there are thresholds (see `shadow_maps/cast.wgsl`), which leave no grain.
#define_import_path bevy_vdb::fog_shadows::maps

#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE
#import bevy_pbr::shadows::{get_cascade_index, world_to_directional_light_local}
#import bevy_render::maths::orthonormalize
#import bevy_vdb::trace::light_list::{ShadingPoint, is_spot, view_z}

// The maps of directional and spot lights.
@group(2) @binding(3) var maps_with_fog: texture_depth_2d_array;
@group(2) @binding(4) var maps_without_fog: texture_depth_2d_array;
#ifdef VDB_LOCAL_LIGHTS
// The maps of point lights: the six faces of a cube each.
@group(2) @binding(5) var faces_with_fog: texture_depth_2d_array;
@group(2) @binding(6) var faces_without_fog: texture_depth_2d_array;
#endif

// Texels between the middle of a mean and its border. Weights fall linearly from the middle, so those of each place
// in a square of 8×8 texels add up to the same. The thresholds at one place differ by less than 1/64.
const REACH: f32 = 8.0;

// Where the map of a light shows a point.
struct Place {
    uv: vec2<f32>,
    layer: i32,
    depth: f32,
    is_inside: bool,
}

const OUTSIDE: Place = Place(vec2(0.0), 0, 0.0, false);

// The first of the texels that a mean takes, along both axes, and its middle.
struct Window {
    first: vec2<f32>,
    middle: vec2<f32>,
}

fn window_at(uv: vec2<f32>, size: vec2<f32>) -> Window {
    let middle = uv * size;
    return Window(floor(middle - REACH + 0.5), middle);
}

// The weight of a texel of a window along both axes.
fn weight(window: Window, texel: vec2<f32>) -> vec2<f32> {
    return max(REACH - abs(window.first + texel + 0.5 - window.middle), vec2(0.0));
}

// The weighted sum of a square of 2×2 texels, in the order of `textureGather`.
fn square_sum(window: Window, square: vec2<f32>, texels: vec4<f32>) -> f32 {
    let near = weight(window, 2.0 * square);
    let far = weight(window, 2.0 * square + 1.0);
    return dot(texels, vec4(near.x * far.y, far.x * far.y, far.x * near.y, near.x * near.y));
}

// The squares of texels along each edge of a window.
const SQUARES: u32 = 8u;

// The fraction of light that fog lets through around a place, by maps with fog and without.
fn past_fog(
    with_fog: texture_depth_2d_array,
    without_fog: texture_depth_2d_array,
    compare: sampler_comparison,
    place: Place,
) -> f32 {
    if !place.is_inside {
        return 1.0;
    }
    let size = vec2<f32>(textureDimensions(with_fog));
    let window = window_at(place.uv, size);
    var left = 0.0;
    var whole = 0.0;
    for (var i = 0u; i < SQUARES * SQUARES; i++) {
        let square = vec2(f32(i % SQUARES), f32(i / SQUARES));
        let uv = (window.first + 2.0 * square + 1.0) / size;
        let past_all = textureGatherCompare(with_fog, compare, uv, place.layer, place.depth);
        // What passes the fog passes without it, too.
        var past_meshes = past_all;
        if any(past_all < vec4(1.0)) {
            past_meshes = textureGatherCompare(without_fog, compare, uv, place.layer, place.depth);
        }
        left += square_sum(window, square, past_all);
        whole += square_sum(window, square, past_meshes);
    }
    // Where meshes leave nothing, nothing is left for fog to take.
    return select(1.0, left / whole, whole > 0.0);
}

// The place in a cascade of a directional light, displaced as Bevy does against shadows of surfaces on themselves.
fn sun_place(at: ShadingPoint, sun: u32, cascade: u32) -> Place {
    let light = &bevy::lights.directional_lights[sun];
    let by_normal = (*light).shadow_normal_bias * (*light).cascades[cascade].texel_size * at.normal;
    let by_depth = (*light).shadow_depth_bias * (*light).direction_to_light;
    let place = world_to_directional_light_local(sun, cascade, vec4(at.position + by_normal + by_depth, 1.0));
    let layer = i32((*light).depth_texture_base_index + cascade);
    return Place(place.xy, layer, place.z, place.w != 0.0);
}

#ifdef VDB_LOCAL_LIGHTS
// The same for a spot light.
fn spot_place(at: ShadingPoint, lamp: u32) -> Place {
    let light = &bevy::clustered_lights.data[lamp];
    let to_light = (*light).position_radius.xyz - at.position;
    var axis = vec3((*light).light_custom_data.x, 0.0, (*light).light_custom_data.y);
    axis.y = sqrt(max(0.0, 1.0 - axis.x * axis.x - axis.z * axis.z));
    if ((*light).flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE) != 0u {
        axis.y = -axis.y;
    }
    let by_normal = (*light).shadow_normal_bias * dot(-axis, to_light) * at.normal;
    let by_depth = (*light).shadow_depth_bias * normalize(to_light);
    let place = (by_normal + by_depth - to_light) * orthonormalize(-axis);
    if place.z >= 0.0 {
        return OUTSIDE;
    }
    let ndc = place.xy / ((*light).spot_light_tan_angle * -place.z);
    let depth = (*light).shadow_map_near_z / -place.z;
    let layer = i32(lamp) + bevy::lights.spot_light_shadowmap_offset;
    return Place(ndc * vec2(0.5, -0.5) + 0.5, layer, depth, all(abs(ndc) < vec2(1.0)));
}

// The same for a point light.
fn point_place(at: ShadingPoint, lamp: u32) -> Place {
    let light = &bevy::clustered_lights.data[lamp];
    let to_light = (*light).position_radius.xyz - at.position;
    let distance = max(abs(to_light.x), max(abs(to_light.y), abs(to_light.z)));
    let by_normal = (*light).shadow_normal_bias * distance * at.normal;
    let by_depth = (*light).shadow_depth_bias * normalize(to_light);
    // Cube maps are left-handed.
    let place = (by_normal + by_depth - to_light) * vec3(1.0, 1.0, -1.0);
    let size = abs(place);
    let major = max(size.x, max(size.y, size.z));
    if major <= 0.0 {
        return OUTSIDE;
    }
    var face = 0;
    var right_down = vec2(0.0);
    if size.x == major {
        face = select(1, 0, place.x > 0.0);
        right_down = vec2(-sign(place.x) * place.z, -place.y);
    } else if size.y == major {
        face = select(3, 2, place.y > 0.0);
        right_down = vec2(place.x, sign(place.y) * place.z);
    } else {
        face = select(5, 4, place.z > 0.0);
        right_down = vec2(sign(place.z) * place.x, -place.y);
    }
    // Faces are filtered on their own.
    let texels = vec2<f32>(textureDimensions(faces_with_fog));
    let reach = min(REACH / texels, vec2(0.5));
    let uv = clamp(0.5 * right_down / major + 0.5, reach, 1.0 - reach);
    let zw = -major * (*light).light_custom_data.xy + (*light).light_custom_data.zw;
    return Place(uv, 6 * i32(lamp) + face, zw.x / zw.y, true);
}
#endif

// The same by the maps of directional and spot lights.
fn past_fog_in_maps(place: Place) -> f32 {
    return past_fog(
        maps_with_fog,
        maps_without_fog,
        bevy::directional_shadow_textures_comparison_sampler,
        place,
    );
}

// The fraction of a directional light that fog lets through to a point.
fn sun_past_fog(at: ShadingPoint, sun: u32) -> f32 {
    let light = &bevy::lights.directional_lights[sun];
    let distance = -view_z(at.position);
    let cascade = get_cascade_index(sun, -distance);
    if cascade >= (*light).num_cascades {
        return 1.0;
    }
    let past = past_fog_in_maps(sun_place(at, sun, cascade));
    // Cascades overlap, and are blended there as Bevy does.
    let far = (*light).cascades[cascade].far_bound;
    let near = (1.0 - (*light).cascades_overlap_proportion) * far;
    if distance < near || cascade + 1u >= (*light).num_cascades {
        return past;
    }
    return mix(past, past_fog_in_maps(sun_place(at, sun, cascade + 1u)), (distance - near) / (far - near));
}

#ifdef VDB_LOCAL_LIGHTS
// The same for a point or spot light.
fn lamp_past_fog(at: ShadingPoint, lamp: u32) -> f32 {
    if is_spot(lamp) {
        return past_fog_in_maps(spot_place(at, lamp));
    }
    return past_fog(
        faces_with_fog,
        faces_without_fog,
        bevy::point_shadow_textures_comparison_sampler,
        point_place(at, lamp),
    );
}
#endif
