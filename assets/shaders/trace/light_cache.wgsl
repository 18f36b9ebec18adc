// Optical depths towards lights from the light cache, interpolated.
#define_import_path bevy_vdb::trace::light_cache

#import bevy_vdb::light_cache::bricks::{BRICK_INTERVALS, brick_texel, bricks_per_light}
#import bevy_vdb::view::scene::volumes

@group(2) @binding(12) var light_atlas: texture_3d<f32>;
@group(2) @binding(13) var light_sampler: sampler;

const NOT_CACHED: u32 = 0xffffffffu;

fn has_light_cache(volume: u32) -> bool {
    return volumes[volume].light_brick != NOT_CACHED;
}

// Optical depth towards a cached light at a point in a fog, given by its local cell and its position in that
// cell; 0 if the fog is not in the cache, which happens only until the variant with `VDB_UNCACHED_FOGS` is
// compiled.
fn cached_depth(volume: u32, light: u32, cell: vec3<i32>, frac: vec3<f32>) -> f32 {
    if !has_light_cache(volume) {
        return 0.0;
    }
    let bricks = volumes[volume].light_bricks;
    let from_origin = vec3<f32>(cell - volumes[volume].light_origin) + frac;
    let sample = max(from_origin * exp2(-f32(volumes[volume].light_log)), vec3(0.0));
    let at = min(vec3<u32>(sample) / BRICK_INTERVALS, bricks - 1u);
    let brick = (at.z * bricks.y + at.y) * bricks.x + at.x;
    let first = brick_texel(volumes[volume].light_brick + light * bricks_per_light(bricks) + brick);
    let in_brick = min(sample - vec3<f32>(at * BRICK_INTERVALS), vec3(f32(BRICK_INTERVALS)));
    let texel = vec3<f32>(first) + in_brick + 0.5;
    let size = vec3<f32>(textureDimensions(light_atlas));
    return textureSampleLevel(light_atlas, light_sampler, texel / size, 0.0).x;
}
