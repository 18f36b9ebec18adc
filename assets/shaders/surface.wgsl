// The look of surfaces.
#define_import_path bevy_vdb::surface

#import bevy_vdb::types::Volume
#import bevy_vdb::exact::Course

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
