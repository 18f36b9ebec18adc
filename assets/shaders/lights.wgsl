// Light that falls on volumes, in Bevy's physical units: illuminance in lux, luminance in cd/m².
#define_import_path bevy_vdb::lights

#import bevy_vdb::types::View

const PI: f32 = 3.14159265;

// Luminance of a Lambertian surface under the sun and a uniform sky:
// albedo · (E·cos θ / π + L_sky).
fn lambert(view: View, albedo: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    let cosine = max(dot(normal, view.sun_direction), 0.0);
    return albedo * (view.sun_illuminance * cosine / PI + view.ambient);
}

// Luminance that a fog of the given single-scattering albedo sends on per unit of optical depth,
// if light reaches it unhindered and scatters evenly: albedo · (E / 4π + L_sky).
fn isotropic(view: View, albedo: vec3<f32>) -> vec3<f32> {
    return albedo * (view.sun_illuminance / (4.0 * PI) + view.ambient);
}
