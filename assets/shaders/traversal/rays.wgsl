// View rays of pixels (twin: `GpuRays` in `crates/vdb_core/src/view.rs`), and the origins of rays from a surface.
#define_import_path bevy_vdb::traversal::rays

#import bevy_vdb::gpu::types::{Ray, Rays}

// Rounds fractions of a cell down to multiples of 2^-24, as the traversal requires.
fn quantise_frac(frac: vec3<f32>) -> vec3<f32> {
    return clamp(floor(frac * 16777216.0), vec3(0.0), vec3(16777215.0)) / 16777216.0;
}

// Normalises a vector of any magnitude.
fn safe_normalize(v: vec3<f32>) -> vec3<f32> {
    // Scale first, since the squared length may overflow or underflow f32.
    let largest = max(max(abs(v.x), abs(v.y)), abs(v.z));
    return normalize(v / max(largest, 1e-30));
}

// Distance, in cells, by which secondary rays are offset from a smooth surface. The trilinear interpolant of
// a surface with a radius of curvature of R cells has bumps of 1 / 4R cells, which would cast shadows in
// grazing light. This offset clears the bumps of every surface with R ≥ 2.5.
const RAY_OFFSET: f32 = 0.1;
// Additional offset for each cell that the ray has travelled, to cover f32 rounding of the position.
const RAY_OFFSET_PER_CELL: f32 = 4.76837158203125e-7;   // 2^-21

// Offset of the origin of a secondary ray from a smooth surface, in cells, towards the side from which a ray
// has arrived at t.
fn surface_offset(gradient: vec3<f32>, ray_dir: vec3<f32>, t: f32) -> vec3<f32> {
    let distance_in_cells = max(max(abs(ray_dir.x), abs(ray_dir.y)), abs(ray_dir.z)) * t;
    let gradient_dir = safe_normalize(gradient);
    let offset_dir = select(gradient_dir, -gradient_dir, dot(gradient_dir, ray_dir) > 0.0);
    return (RAY_OFFSET + RAY_OFFSET_PER_CELL * distance_in_cells) * offset_dir;
}

// Normalised device coordinates of a pixel's centre.
fn ndc_of(pixel: vec2<u32>, size: vec2<u32>) -> vec2<f32> {
    return ndc_at(vec2<f32>(pixel) + 0.5, size);
}

// Normalised device coordinates of a place in the image, in pixels from its upper left corner.
fn ndc_at(place: vec2<f32>, size: vec2<u32>) -> vec2<f32> {
    let uv = place / vec2<f32>(size);
    return vec2(2.0 * uv.x - 1.0, 1.0 - 2.0 * uv.y);
}

// The ray through a point of the image.
fn ray_through(rays: Rays, ndc: vec2<f32>, t_min: f32, t_max: f32) -> Ray {
    let eye = rays.eye_frac + (ndc.x * rays.eye_x + ndc.y * rays.eye_y);
    let whole = floor(eye);
    // 24 bits, because the traversal compares planes in units of 2^-24 cells. Just below an integer, the
    // difference rounds up to 1.
    let frac = min(floor((eye - whole) * 16777216.0), vec3(16777215.0)) / 16777216.0;
    // The large term is added last, so that only this sum has a rounding error of its size.
    let dir_offset = rays.dir_rest + ndc.x * rays.dir_x + ndc.y * rays.dir_y;
    return Ray(rays.eye_cell + vec3<i32>(whole), frac, rays.dir + dir_offset, t_min, t_max);
}
