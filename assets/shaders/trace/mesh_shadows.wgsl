// Shadows of meshes on points in volumes, from Bevy's shadow maps.
#define_import_path bevy_vdb::trace::mesh_shadows

#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::shadows
#import bevy_vdb::trace::light_list::{ShadingPoint, is_spot, view_z}

// Fraction of a directional light that meshes let through.
fn sun_past_meshes(at: ShadingPoint, sun: u32) -> f32 {
    let position = vec4(at.position, 1.0);
    return shadows::fetch_directional_shadow(sun, position, at.normal, view_z(at.position), at.coord);
}

// Fraction of a point or spot light that meshes let through.
fn lamp_past_meshes(at: ShadingPoint, lamp: u32) -> f32 {
    let position = vec4(at.position, 1.0);
    if is_spot(lamp) {
        let near = bevy::clustered_lights.data[lamp].shadow_map_near_z;
        return shadows::fetch_spot_shadow(lamp, position, at.normal, near, at.coord);
    }
    return shadows::fetch_point_shadow(lamp, position, at.normal, at.coord);
}
