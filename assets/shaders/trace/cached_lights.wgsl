// Light that fog scatters towards the viewer from suns and lamps whose optical depths are in the light cache, and
// from the others of views that have one, in Bevy's units (lux, candela, cd/m²).
#define_import_path bevy_vdb::trace::cached_lights

#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#ifdef VDB_MESH_CASTERS
#import bevy_vdb::trace::mesh_shadows::{lamp_past_meshes, sun_past_meshes}
#endif
#import bevy_vdb::trace::illuminance::sun_factor
#import bevy_vdb::trace::light_cache::NOT_CACHED
#import bevy_vdb::trace::light_list::ShadingPoint
#import bevy_vdb::trace::lights::light_cosine
#ifdef VDB_OTHER_LIGHTS
#import bevy_vdb::trace::lights::add_scattered
#endif
#import bevy_vdb::trace::occlusion::is_occluded
#import bevy_vdb::trace::scattering::{InScattered, Scatterer, add_attenuated}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattering::add_occlusion
#endif
#import bevy_vdb::trace::segment::Point
#import bevy_vdb::traversal::fog::SamplePoint
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::view
#ifdef VDB_CACHED_LAMPS
#import bevy_pbr::mesh_view_types::{POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#import bevy_vdb::gpu::types::MAX_CACHED_LAMPS
#import bevy_vdb::trace::illuminance::lamp_illuminance
#import bevy_vdb::trace::light_cache::{cached_lamp_depth, lamp_group_lattices, lattice_point}
#import bevy_vdb::trace::light_list::local_light
#ifdef VDB_LAMP_LIGHT
#import bevy_pbr::mesh_view_types::{ClusteredLight, POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT}
#import bevy_vdb::trace::light_cache::{far_from_eye, far_from_lamps, lamp_light_lattice}
#endif
#endif
#ifdef VDB_OTHER_LIGHTS
#import bevy_vdb::trace::illuminance::illuminance_of
#import bevy_vdb::trace::light_list::{casts_shadows, lights_at, to_light}
#ifdef VDB_RECT_LIGHTS
#import bevy_vdb::trace::rect_lights::scattered_rect_lights
#endif
#ifdef VDB_UNCACHED_LIGHTS
#import bevy_vdb::trace::visibility::visibility
#endif
#endif

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
}

// The light in a slot.
fn cached_sun(slot: u32) -> CachedSun {
    var sun = CachedSun(0u, vec3(0.0));
    for (var i = 0u; i < bevy::lights.n_directional_lights; i++) {
        if cached_slot(i) == slot {
            sun.light = i;
            sun.illuminance += sun_factor(i) * bevy::lights.directional_lights[i].color.rgb;
        }
    }
    return sun;
}

// Fraction of a cached sun that meshes and surfaces let through to a point in fog.
fn unoccluded(at: ShadingPoint, point: Point, light: u32) -> f32 {
#ifdef VDB_MESH_CASTERS
    let visible = sun_past_meshes(at, light);
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
    visible = lamp_past_meshes(at, lamp);
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
    light: InScattered,
    nearest: f32,
}

#ifdef VDB_CACHED_LAMPS
#ifdef VDB_LAMP_LIGHT
// The edge of a spot light's cone widens with the distance, so it can be interpolated from a distance on that
// is proportional to its steepness, relative to that of point lights.
const FAR_FROM_CONE: f32 = 0.58;

// The distance from a lamp at which its light begins to be interpolated; `far` is that for point lights.
fn far_distance(data: ClusteredLight, far: f32) -> f32 {
    let is_spot = (data.flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_BIT) != 0u;
    return far * max(1.0, FAR_FROM_CONE * select(0.0, data.light_custom_data.z, is_spot));
}

// The fraction of the light scattered from a point (world space) that is interpolated, as far as its distance
// from the eye goes: all of it from twice a distance on. Around the eye, rays come from all directions.
fn interpolated_near_eye(volume: u32, position: vec3<f32>) -> f32 {
    let far = far_from_eye(volume);
    if far <= 0.0 {
        return 1.0;
    }
    return smoothstep(far, 2.0 * far, length(position - view.eye));
}

// The fraction of a lamp's light that is interpolated: all of it from twice that distance on.
fn interpolated_part(data: ClusteredLight, distance_squared: f32, far: f32) -> f32 {
    let begin = far_distance(data, far);
    return smoothstep(begin, 2.0 * begin, sqrt(distance_squared));
}

// The union of a range of distances along a ray (world space, unit length) with that within a sphere.
fn with_sphere(range: vec2<f32>, ray: vec3<f32>, to_center: vec3<f32>, radius: f32) -> vec2<f32> {
    let along = dot(to_center, ray);
    let across = to_center - along * ray;
    let half_squared = radius * radius - dot(across, across);
    if half_squared <= 0.0 {
        return range;
    }
    let half = sqrt(half_squared);
    return vec2(min(range.x, along - half), max(range.y, along + half));
}

// The range of distances along a ray (world space, unit length) in which some of the light of cached lamps is
// not interpolated; its start is larger than its end if all is.
fn range_near_lamps(origin: vec3<f32>, ray: vec3<f32>, volume: u32) -> vec2<f32> {
    let is_interpolated = lamp_light_lattice(volume) != NOT_CACHED;
    let far = far_from_lamps(volume);
    var range = vec2(FAR, -FAR);
    var is_lit = false;
    let groups = (min(view.cached_lamp_count, MAX_CACHED_LAMPS) + 3u) / 4u;
    for (var group = 0u; group < groups; group++) {
        let lamps = view.cached_lamps[group];
        let lattices = lamp_group_lattices(volume, group);
        for (var i = 0u; i < 4u; i++) {
            if lattices[i] != NOT_CACHED {
                let data = bevy::clustered_lights.data[lamps[i]];
                let to_lamp = data.position_radius.xyz - origin;
                range = with_sphere(range, ray, to_lamp, 2.0 * far_distance(data, far));
                is_lit = true;
            }
        }
    }
    if !is_lit {
        return vec2(FAR, -FAR);
    }
    if !is_interpolated {
        return vec2(-FAR, FAR);
    }
    return with_sphere(range, ray, view.eye - origin, 2.0 * far_from_eye(volume));
}
#endif

// Adds the light of the lamps in the light cache that is scattered over a stretch of a ray around a point in
// a fog. `place` is that point in the lattice of the fog. Leaves out what is interpolated.
fn add_cached_lamps(
    light: ptr<function, LocalLight>,
    at: ShadingPoint,
    point: Point,
    ray: vec3<f32>,
    extent: f32,
    scatterer: Scatterer,
    volume: u32,
    place: SamplePoint,
) {
    let in_lattice = lattice_point(volume, place.cell, place.u);
#ifdef VDB_LAMP_LIGHT
    let is_interpolated = lamp_light_lattice(volume) != NOT_CACHED;
    let far = far_from_lamps(volume);
    let near_eye = interpolated_near_eye(volume, at.position);
#endif
    var own = (*light).light;
    var nearest_squared = FAR;
    let groups = (min(view.cached_lamp_count, MAX_CACHED_LAMPS) + 3u) / 4u;
    for (var group = 0u; group < groups; group++) {
        let lamps = view.cached_lamps[group];
        let lattices = lamp_group_lattices(volume, group);
        // The fractions of their light that are not interpolated.
        var parts = vec4(1.0);
#ifdef VDB_LAMP_LIGHT
        if is_interpolated {
            for (var i = 0u; i < 4u; i++) {
                let data = bevy::clustered_lights.data[lamps[i]];
                let to_lamp = data.position_radius.xyz - at.position;
                let distance_squared = dot(to_lamp, to_lamp);
                let part = 1.0 - near_eye * interpolated_part(data, distance_squared, far);
                parts[i] = select(0.0, part, lattices[i] != NOT_CACHED);
                // Of all lamps: the ray may come near this one between samples.
                if lattices[i] != NOT_CACHED {
                    nearest_squared = min(nearest_squared, distance_squared);
                }
            }
        }
#endif
        if any(parts > vec4(0.0)) {
            // Four samples at once, so that the GPU does not wait for each.
            var depths = vec4(0.0);
            for (var i = 0u; i < 4u; i++) {
                depths[i] = cached_lamp_depth(in_lattice, select(lattices[i], 0u, lattices[i] == NOT_CACHED));
            }
            for (var i = 0u; i < 4u; i++) {
                let data = bevy::clustered_lights.data[lamps[i]];
                let has_shadows = (data.flags & POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u;
                if has_shadows && lattices[i] != NOT_CACHED && parts[i] > 0.0 {
                    let to_lamp = data.position_radius.xyz - at.position;
                    let illuminance = parts[i] * lamp_illuminance(data, to_lamp, ray, extent);
                    // Of all lamps: the ray may meet the cone or the range of this one between samples.
                    nearest_squared = min(nearest_squared, dot(to_lamp, to_lamp));
                    if any(illuminance > vec3(0.0)) {
                        let visible = unoccluded_lamp(at, point, lamps[i], to_lamp);
                        let cosine = light_cosine(to_lamp, ray);
#ifdef VDB_SCATTERED
                        add_occlusion(&own, illuminance, visible);
#endif
                        add_attenuated(&own, visible * illuminance, depths[i], cosine, scatterer);
                    }
                }
            }
        }
    }
    (*light).light = own;
    (*light).nearest = min((*light).nearest, sqrt(nearest_squared));
}

// Whether a point or spot light has a lattice in a fog.
fn is_cached_lamp(volume: u32, lamp: u32) -> bool {
    var is_cached = false;
    for (var slot = 0u; slot < min(view.cached_lamp_count, MAX_CACHED_LAMPS); slot++) {
        if view.cached_lamps[slot / 4u][slot % 4u] == lamp {
            is_cached = lamp_group_lattices(volume, slot / 4u)[slot % 4u] != NOT_CACHED;
        }
    }
    return is_cached;
}
#endif

#ifdef VDB_OTHER_LIGHTS
// Adds the light of all suns, lamps and rectangle lights that have no shadows or are not in the light cache.
fn add_other_lights(
    light: ptr<function, LocalLight>,
    at: ShadingPoint,
    point: Point,
    ray: vec3<f32>,
    extent: f32,
    scatterer: Scatterer,
    volume: u32,
) {
    var own = (*light).light;
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
            add_scattered(&own, light_vector, illuminance, visible, has_shadows, ray, scatterer);
        }
    }
#ifdef VDB_RECT_LIGHTS
    let rects = scattered_rect_lights(at.position, ray, extent, scatterer.anisotropy);
    own.whole += rects.light;
    (*light).nearest = min((*light).nearest, rects.nearest);
#endif
    (*light).light = own;
}
#endif
