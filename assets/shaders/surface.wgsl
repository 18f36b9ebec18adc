// The look of surfaces.
#define_import_path bevy_vdb::surface

#import bevy_vdb::types::{Grid, Ray, Volume}
#import bevy_vdb::anchor::anchored
#import bevy_vdb::tree::{corners, trilinear_gradient}
#import bevy_vdb::hdda::Walk

// Index-space gradient of the trilinear interpolant where a ray enters a voxel.
fn voxel_gradient(grid: Grid, ray: Ray, hit: Walk) -> vec3<f32> {
    // Voxels are centred on their samples: half a voxel back to sample coordinates.
    let at = anchored(ray, hit.cell, hit.axis, hit.t).ray.frac - 0.5;
    let base = floor(at);
    return trilinear_gradient(corners(grid, hit.cell + vec3<i32>(base)), at - base);
}

// World-space unit normal: along a gradient, or the face by which the ray came where there is none.
fn surface_normal(volume: Volume, ray: Ray, axis: u32, index_gradient: vec3<f32>) -> vec3<f32> {
    let gradient = to_world(volume, index_gradient);
    // Scaled first: its square can be more, or less, than f32 holds.
    let largest = max(max(abs(gradient.x), abs(gradient.y)), abs(gradient.z));
    if largest > 1e-30 {
        return normalize(gradient / largest);
    }
    let across = vec3(axis == 0u, axis == 1u, axis >= 2u);
    let face = to_world(volume, select(vec3(0.0), -sign(ray.dir), across));
    return face * inverseSqrt(max(dot(face, face), 1e-30));
}

fn to_world(volume: Volume, gradient: vec3<f32>) -> vec3<f32> {
    return volume.normal_x * gradient.x + volume.normal_y * gradient.y + volume.normal_z * gradient.z;
}
