// The look of surfaces.
#define_import_path bevy_vdb::surface

#import bevy_vdb::types::{Grid, Volume}
#import bevy_vdb::exact::Course
#import bevy_vdb::anchor::anchored
#import bevy_vdb::tree::{corners, trilinear_gradient}
#import bevy_vdb::hdda::{Hit, unturned}

// Index-space gradient of the trilinear interpolant where a ray enters a voxel.
fn voxel_gradient(grid: Grid, course: Course, hit: Hit) -> vec3<f32> {
    let rel = bitcast<vec3<u32>>((hit.cell ^ course.flip) - course.cell);
    // Voxels are centred on their samples: half a voxel back to sample coordinates.
    let at = unturned(course, anchored(course, rel, hit.axis, hit.t).frac) - 0.5;
    let base = min(floor(at), vec3(0.0));
    return trilinear_gradient(corners(grid, hit.cell + vec3<i32>(base)), at - base);
}

// World-space unit normal: along a gradient, or the face by which the ray came where there is none.
fn surface_normal(volume: Volume, course: Course, axis: u32, index_gradient: vec3<f32>) -> vec3<f32> {
    let gradient = to_world(volume, index_gradient);
    // Scaled first: its square can be more, or less, than f32 holds.
    let largest = max(max(abs(gradient.x), abs(gradient.y)), abs(gradient.z));
    if largest > 1e-30 {
        return normalize(gradient / largest);
    }
    let across = vec3(axis == 0u, axis == 1u, axis >= 2u);
    let outwards = select(vec3(-1.0), vec3(1.0), course.flip != vec3(0));
    let face = to_world(volume, select(vec3(0.0), outwards, across));
    return face * inverseSqrt(max(dot(face, face), 1e-30));
}

fn to_world(volume: Volume, gradient: vec3<f32>) -> vec3<f32> {
    return volume.normal_x * gradient.x + volume.normal_y * gradient.y + volume.normal_z * gradient.z;
}
