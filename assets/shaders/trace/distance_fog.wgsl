// Bevy's distance fog in front of volumes.
#define_import_path bevy_vdb::trace::distance_fog

#ifdef DISTANCE_FOG
#import bevy_pbr::fog
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_pbr::mesh_view_types::{DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT}
#import bevy_pbr::mesh_view_types::{FOG_MODE_ATMOSPHERIC, FOG_MODE_EXPONENTIAL, FOG_MODE_EXPONENTIAL_SQUARED}
#import bevy_pbr::mesh_view_types::FOG_MODE_LINEAR
#ifdef VDB_SHADOWS
#import bevy_pbr::shadows
#import bevy_vdb::trace::light_list::view_z
#endif
#import bevy_vdb::gpu::types::MAX_SUNS
#import bevy_vdb::trace::light_list::ShadingPoint

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
