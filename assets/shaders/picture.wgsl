// Pixels, rays and depths of a picture.
#define_import_path bevy_vdb::picture

#import bevy_vdb::hdda::FAR

// The pixel, of a picture of so many, in the middle of those that a ray of a view of so many rays stands for.
fn pixel_of(ray: vec2<u32>, rays: vec2<u32>, picture: vec2<u32>) -> vec2<u32> {
    return (2u * ray + 1u) * picture / (2u * rays);
}

// The t of a value in the depth buffer, by `View::t_from_depth`.
fn t_of_depth(m: vec4<f32>, depth: f32) -> f32 {
    let w = m.z * depth + m.w;
    return select(-(m.x * depth + m.y) / w, FAR, abs(w) < 1e-30);
}
