// View rays of pixels. Twin: `GpuRays` in `crates/vdb_core/src/view.rs`.
#define_import_path bevy_vdb::traversal::rays

#import bevy_vdb::gpu::types::{Ray, Rays}

// Rounds fractions of a cell down to multiples of 2^-24, as the traversal requires.
fn quantise_frac(frac: vec3<f32>) -> vec3<f32> {
    return clamp(floor(frac * 16777216.0), vec3(0.0), vec3(16777215.0)) / 16777216.0;
}

// Normalised device coordinates of a pixel's centre.
fn ndc_of(pixel: vec2<u32>, size: vec2<u32>) -> vec2<f32> {
    let uv = (vec2<f32>(pixel) + 0.5) / vec2<f32>(size);
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
