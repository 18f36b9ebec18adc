// Optical depths towards lights from the light cache, interpolated.
#define_import_path bevy_vdb::trace::light_cache

#import bevy_vdb::light_cache::bricks::{BRICK_INTERVALS, LOG_BRICK_INTERVALS, brick_texel}
#import bevy_vdb::light_cache::bricks::bricks_per_light
#import bevy_vdb::view::scene::{view, volumes}
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::gpu::types::MAX_CACHED_LAMPS
#endif

@group(2) @binding(12) var light_atlas: texture_3d<f32>;
@group(2) @binding(13) var light_sampler: sampler;

const NOT_CACHED: u32 = 0xffffffffu;

fn has_light_cache(volume: u32) -> bool {
    return volumes[volume].light_brick != NOT_CACHED;
}

#ifdef VDB_CACHED_LAMPS
// One row per volume of the view; each texel holds the first bricks of its lattices for four lamps, or NOT_CACHED.
@group(2) @binding(14) var lamp_bricks: texture_2d<u32>;

// The first bricks of a fog's lattices for four of the cached lamps.
fn lamp_group_bricks(volume: u32, lamps: u32) -> vec4<u32> {
    let at = vec2(lamps, volume - view.volume_first);
    if any(at >= textureDimensions(lamp_bricks)) {
        return vec4(NOT_CACHED);
    }
    return textureLoad(lamp_bricks, at, 0);
}
#endif

#ifdef VDB_LAMP_LIGHT
// Light of lamps that fog scatters towards the view's eye, times its exposure: a lattice for each octave.
@group(2) @binding(15) var lamp_light: texture_3d<f32>;

// The texel of `lamp_bricks` with the first brick of a fog's lattices of scattered light, and the distances from a
// point light and from the eye at which light begins to be interpolated.
const LAMP_LIGHT_TEXEL: u32 = MAX_CACHED_LAMPS / 4u;

// The first brick of a fog's lattices of scattered light, or NOT_CACHED.
fn lamp_light_brick(volume: u32) -> u32 {
    return lamp_group_bricks(volume, LAMP_LIGHT_TEXEL).x;
}

// The distance from a point light at which its light begins to be interpolated in a fog, world units.
fn far_from_lamps(volume: u32) -> f32 {
    return bitcast<f32>(lamp_group_bricks(volume, LAMP_LIGHT_TEXEL).y);
}

// The distance from the eye at which light scattered towards it begins to be interpolated in a fog, world units; 0 if
// it is interpolated everywhere.
fn far_from_eye(volume: u32) -> f32 {
    return bitcast<f32>(lamp_group_bricks(volume, LAMP_LIGHT_TEXEL).z);
}

// Light of an octave at a point; `light_brick` is the first of the fog's lattice for that octave.
fn cached_lamp_light(point: LatticePoint, light_brick: u32) -> vec3<f32> {
    let first = brick_texel(light_brick + point.brick);
    let texel = vec3<f32>(first) + point.in_brick + 0.5;
    return textureSampleLevel(lamp_light, light_sampler, texel / vec3<f32>(textureDimensions(lamp_light)), 0.0).rgb;
}
#endif

// The first brick of a fog's lattice for the sun in a slot.
fn sun_brick(volume: u32, slot: u32) -> u32 {
    return volumes[volume].light_brick + slot * bricks_per_light(volumes[volume].light_bricks);
}

// A point in the lattices of a fog.
struct LatticePoint {
    brick: u32,             // index among one light's bricks
    in_brick: vec3<f32>,    // in intervals between samples
}

// A point in a fog that has a light cache, given by its local cell and its position in that cell.
fn lattice_point(volume: u32, cell: vec3<i32>, frac: vec3<f32>) -> LatticePoint {
    let bricks = volumes[volume].light_bricks;
    let log_size = volumes[volume].light_log;
    // Not negative, and within the bricks, because they cover the grid's box.
    let from_origin = vec3<u32>(cell - volumes[volume].light_origin);
    let at = from_origin >> vec3(log_size + LOG_BRICK_INTERVALS);
    let cell_in_brick = from_origin & vec3((BRICK_INTERVALS << log_size) - 1u);
    let in_brick = (vec3<f32>(cell_in_brick) + frac) * exp2(-f32(log_size));
    return LatticePoint((at.z * bricks.y + at.y) * bricks.x + at.x, in_brick);
}

// Optical depth towards a light at a point; `light_brick` is the first of the fog's lattice for that light. The mean
// position of an interval may be between two clouds, where samples are NO_FOG; depths there count as 0.
fn cached_depth(point: LatticePoint, light_brick: u32) -> f32 {
    let first = brick_texel(light_brick + point.brick);
    let texel = vec3<f32>(first) + point.in_brick + 0.5;
    return max(textureSampleLevel(light_atlas, light_sampler, texel * view.light_texel, 0.0).x, 0.0);
}
