// Pixels, rays and depths of the traced image.
#define_import_path bevy_vdb::view::picture

#import bevy_vdb::traversal::hdda::FAR

// Just below the largest finite 16-bit float.
const MAX_COLOR: f32 = 65000.0;

// The pixel that a ray passes through: the middle of the pixels that the ray represents, offset by `jitter`.
// `rays` and `picture` are the numbers of rays and pixels along each axis.
fn pixel_of(ray: vec2<u32>, rays: vec2<u32>, picture: vec2<u32>, jitter: vec2<f32>) -> vec2<u32> {
#ifdef VDB_ACCUMULATED
    let position = (vec2<f32>(ray) + 0.5 + jitter) * vec2<f32>(picture) / vec2<f32>(rays);
    return min(vec2<u32>(position), picture - 1u);
#else
    return (2u * ray + 1u) * picture / (2u * rays);
#endif
}

#ifdef MULTISAMPLED
// Depth of the opaque meshes at a pixel of the target: the farthest of its samples, because the composite
// tests each sample's own depth again.
fn depth_of_meshes(scene_depth: texture_depth_multisampled_2d, at: vec2<u32>) -> f32 {
    var depth = 1.0;
    for (var i = 0u; i < textureNumSamples(scene_depth); i++) {
        depth = min(depth, textureLoad(scene_depth, at, i32(i)));
    }
    return depth;
}
#else
// Depth of the opaque meshes at a pixel of the target.
fn depth_of_meshes(scene_depth: texture_depth_2d, at: vec2<u32>) -> f32 {
    return textureLoad(scene_depth, at, 0);
}
#endif

// The t of a value in the depth buffer. `m` is `View::t_from_depth`.
fn t_of_depth(m: vec4<f32>, depth: f32) -> f32 {
    let w = m.z * depth + m.w;
    return select(-(m.x * depth + m.y) / w, FAR, abs(w) < 1e-30);
}

// Luminance of linear sRGB.
fn luminance_of(color: vec3<f32>) -> f32 {
    return dot(color, vec3(0.2126, 0.7152, 0.0722));
}
