// Optical depths towards lights from the light cache, interpolated.
#define_import_path bevy_vdb::trace::light_cache

#import bevy_vdb::light_cache::bricks::{BRICK_INTERVALS, LOG_BRICK_INTERVALS, brick_texel}
#import bevy_vdb::light_cache::bricks::bricks_per_light
#import bevy_vdb::view::scene::{view, volumes}

@group(2) @binding(12) var light_atlas: texture_3d<f32>;
@group(2) @binding(13) var light_sampler: sampler;

const NOT_CACHED: u32 = 0xffffffffu;

fn has_light_cache(volume: u32) -> bool {
    return volumes[volume].light_brick != NOT_CACHED;
}

// Optical depth towards a cached light at a point in a fog that has a light cache, given by its local cell and
// its position in that cell.
fn cached_depth(volume: u32, light: u32, cell: vec3<i32>, frac: vec3<f32>) -> f32 {
    let bricks = volumes[volume].light_bricks;
    let log_size = volumes[volume].light_log;
    // Not negative, and within the bricks, because they cover the grid's box.
    let from_origin = vec3<u32>(cell - volumes[volume].light_origin);
    let at = from_origin >> vec3(log_size + LOG_BRICK_INTERVALS);
    let brick = (at.z * bricks.y + at.y) * bricks.x + at.x;
    let first = brick_texel(volumes[volume].light_brick + light * bricks_per_light(bricks) + brick);
    let cell_in_brick = from_origin & vec3((BRICK_INTERVALS << log_size) - 1u);
    let in_brick = (vec3<f32>(cell_in_brick) + frac) * exp2(-f32(log_size));
    let texel = vec3<f32>(first) + in_brick + 0.5;
    return textureSampleLevel(light_atlas, light_sampler, texel * view.light_texel, 0.0).x;
}
