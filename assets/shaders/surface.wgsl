// The look of a surface at the voxel that a ray enters.
#define_import_path bevy_vdb::surface

#import bevy_vdb::types::{Grid, Ray, Volume}
#import bevy_vdb::tree::{corners, trilinear_gradient}
#import bevy_vdb::hdda::Walk

// World-space unit normal: the gradient of the trilinear interpolant where the ray enters the
// voxel, or the face where there is no gradient.
fn surface_normal(grid: Grid, volume: Volume, ray: Ray, hit: Walk) -> vec3<f32> {
    // Cells of a surface are centred on their samples: half a cell back to sample coordinates.
    let at = ray.frac + hit.t * ray.dir - 0.5;
    let base = floor(at);
    let c = corners(grid, vec3<i32>(base) + ray.cell);
    let gradient = to_world(volume, trilinear_gradient(c, at - base));
    let length_2 = dot(gradient, gradient);
    if length_2 > 1e-30 {
        return gradient * inverseSqrt(length_2);
    }
    let across = vec3(hit.axis == 0u, hit.axis == 1u, hit.axis >= 2u);
    let face = to_world(volume, select(vec3(0.0), -sign(ray.dir), across));
    return face * inverseSqrt(max(dot(face, face), 1e-30));
}

fn to_world(volume: Volume, gradient: vec3<f32>) -> vec3<f32> {
    return volume.normal_x * gradient.x + volume.normal_y * gradient.y + volume.normal_z * gradient.z;
}
