// Optical depths towards lights from the light cache, interpolated.
#define_import_path bevy_vdb::trace::light_cache

#import bevy_vdb::view::scene::{view, volumes}
#ifdef VDB_CACHED_LAMPS
#import bevy_vdb::light_cache::lattice::first_texel
#endif
#ifdef VDB_LAMP_LIGHT
#import bevy_vdb::gpu::types::MAX_CACHED_LAMPS
#endif

@group(2) @binding(12) var light_atlas: texture_3d<f32>;
@group(2) @binding(13) var light_sampler: sampler;

// In place of a lamp's lattice.
const NOT_CACHED: u32 = 0xffffffffu;

fn has_light_cache(volume: u32) -> bool {
    return volumes[volume].light_planes != 0u;
}

#ifdef VDB_CACHED_LAMPS
// One row per volume of the view; each texel holds the packed positions of its lattices for four lamps, or
// NOT_CACHED.
@group(2) @binding(14) var lamp_lattices: texture_2d<u32>;

// The packed positions of a fog's lattices for four of the cached lamps.
fn lamp_group_lattices(volume: u32, lamps: u32) -> vec4<u32> {
    let at = vec2(lamps, volume - view.volume_first);
    if any(at >= textureDimensions(lamp_lattices)) {
        return vec4(NOT_CACHED);
    }
    return textureLoad(lamp_lattices, at, 0);
}
#endif

#ifdef VDB_LAMP_LIGHT
// Light of lamps that fog scatters towards the view's eye, times its exposure: lattices for light of each kind, as
// `trace/lamp_light.wgsl` stores them.
@group(2) @binding(15) var lamp_light: texture_3d<f32>;

// The texel of `lamp_lattices` with the packed position of a fog's lattices of scattered light, and the
// distances from a point light and from the eye at which light begins to be interpolated.
const LAMP_LIGHT_TEXEL: u32 = MAX_CACHED_LAMPS / 4u;

// The packed position of a fog's lattices of scattered light, which follow each other along z, or NOT_CACHED.
fn lamp_light_lattice(volume: u32) -> u32 {
    return lamp_group_lattices(volume, LAMP_LIGHT_TEXEL).x;
}

// The distance from a point light at which its light begins to be interpolated in a fog, world units.
fn far_from_lamps(volume: u32) -> f32 {
    return bitcast<f32>(lamp_group_lattices(volume, LAMP_LIGHT_TEXEL).y);
}

// The distance from the eye at which light scattered towards it begins to be interpolated in a fog, world
// units; 0 if it is interpolated everywhere.
fn far_from_eye(volume: u32) -> f32 {
    return bitcast<f32>(lamp_group_lattices(volume, LAMP_LIGHT_TEXEL).z);
}

// Light of a kind at a point in a lattice of scattered light.
fn cached_lamp_light(point: vec3<f32>, lattice: u32, volume: u32, kind: u32) -> vec4<f32> {
    var texel = vec3<f32>(first_texel(lattice)) + 0.5 + point;
    texel.z += f32(kind * volumes[volume].light_planes);
    texel /= vec3<f32>(textureDimensions(lamp_light));
    return textureSampleLevel(lamp_light, light_sampler, texel, 0.0);
}
#endif

// A point in the lattices of a fog that has a light cache, in spacings from the first sample; the point is
// given by its local cell and its position in that cell. It lies between samples, because they cover the
// grid's box.
fn lattice_point(volume: u32, cell: vec3<i32>, frac: vec3<f32>) -> vec3<f32> {
    let from_origin = vec3<f32>(cell - volumes[volume].light_origin) + frac;
    return from_origin * volumes[volume].light_scale;
}

// Optical depth towards the sun in a slot at a point in a lattice.
fn cached_sun_depth(point: vec3<f32>, volume: u32, slot: u32) -> f32 {
    var texel = volumes[volume].light_texel + point;
    texel.z += f32(slot * volumes[volume].light_planes);
    return depth_at_texel(texel);
}

#ifdef VDB_CACHED_LAMPS
// Optical depth towards a lamp at a point in its lattice.
fn cached_lamp_depth(point: vec3<f32>, lattice: u32) -> f32 {
    return depth_at_texel(vec3<f32>(first_texel(lattice)) + 0.5 + point);
}
#endif

// The mean position of an interval may be between two clouds, where samples are NO_FOG; depths there count as
// 0.
fn depth_at_texel(texel: vec3<f32>) -> f32 {
    return max(textureSampleLevel(light_atlas, light_sampler, texel * view.light_texel, 0.0).x, 0.0);
}
