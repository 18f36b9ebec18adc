// One thread a pixel: primary rays of a picture, or the same in an order without neighbours.

#import bevy_vdb::gpu::types::Rays
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::rays::{ndc_of, ray_through}
#import bevy_vdb::traversal::beam::{beam_of, beam_start_t}
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray, enter_at, first_hit}
#ifdef VDB_COUNT_STEPS
#import bevy_vdb::traversal::hdda::steps
#endif
#import bevy_vdb::traversal::smooth::first_root
#ifdef VDB_SMOOTH_NORMALS
#import bevy_vdb::traversal::normals::smooth_gradient
#endif
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}

struct Setup {
    size: vec2<u32>,
    // Of pixels' numbers, if they are shuffled.
    bits: u32,
    // Extinction per unit of density and voxel.
    density_scale: f32,
}

@group(2) @binding(4) var<uniform> setup: Setup;
@group(2) @binding(5) var<uniform> view: Rays;
@group(2) @binding(6) var<storage, read_write> out: array<f32>;
@group(2) @binding(7) var<storage, read_write> normals: array<vec4<f32>>;

// For each tile of 8×8 pixels, the t before which nothing can stop its rays.
@group(2) @binding(8) var<storage, read_write> starts: array<f32>;

@compute @workgroup_size(8, 8)
fn beams(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = (setup.size + 7u) / 8u;
    if any(id.xy >= tiles) {
        return;
    }
    let beam = beam_of(grids[0], view, id.xy, setup.size, 0.0);
    starts[id.y * tiles.x + id.x] = beam_start_t(grids[0], beam);
}

#ifdef VDB_SHUFFLED
// A permutation of the numbers below 2^bits: odd multiplications and shifts to the right, each of which
// can be undone.
fn boundary(x: u32) -> u32 {
    let all = (1u << setup.bits) - 1u;
    var y = (x * 0x9e3779b1u) & all;
    y ^= y >> (setup.bits / 2u);
    y = (y * 0x85ebca6bu) & all;
    y ^= y >> (setup.bits / 2u);
    return (y * 0xc2b2ae35u) & all;
}
#endif

const NONE: u32 = 0xffffffffu;

// The number of the pixel that a thread works on; too large where it has none.
fn number_of(id: vec3<u32>) -> u32 {
    if any(id.xy >= setup.size) {
        return NONE;
    }
    let own = id.y * setup.size.x + id.x;
#ifdef VDB_SHUFFLED
    let count = setup.size.x * setup.size.y;
    var number = boundary(own);
    // The cycle that a number lies on comes back below the count.
    while number >= count {
        number = boundary(number);
    }
    return number;
#else
    return own;
#endif
}

fn pixel_of(number: u32, id: vec3<u32>) -> vec2<u32> {
#ifdef VDB_SHUFFLED
    return vec2(number % setup.size.x, number / setup.size.x);
#else
    return id.xy;
#endif
}

// The t before which nothing can stop a pixel's ray; shuffled rays have no neighbours to share it with.
fn start_t(id: vec3<u32>) -> f32 {
#ifdef VDB_BEAMS
    return starts[(id.y / 8u) * ((setup.size.x + 7u) / 8u) + id.x / 8u];
#else
    return 0.0;
#endif
}

#ifdef VDB_FOG
const MISS: f32 = 1.0;
#else
const MISS: f32 = -1.0;
#endif

fn put(number: u32, value: f32) {
#ifdef VDB_COUNT_STEPS
    out[number] = f32(steps);
#else
    out[number] = value;
#endif
}

// Two tiles a group: half as many groups to start. With four, one long ray keeps too many waiting.
//
// t of the first voxel; with SMOOTH t and normal of the first root; with FOG the transmittance.
@compute @workgroup_size(8, 16)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let number = number_of(id);
    if number == NONE {
        return;
    }
    let start = start_t(id);
    if start == FAR {
        put(number, MISS);
        return;
    }
    let ray = ray_through(view, ndc_of(pixel_of(number, id), setup.size), 0.0, FAR);
    let mirrored = mirrored_ray(grids[0], ray);
    let enter = enter_at(mirrored, start);
#ifdef VDB_FOG
    // In voxels, not in t.
    let scale = setup.density_scale * length(ray.dir);
#ifdef VDB_STEP
    // In quarters of a voxel. Beyond 9, less than a 8,000th of the light is left.
    let depth = scale
        * stepped_length(grids[0], mirrored, start, 9.0 / scale, 0.25 * f32(#{VDB_STEP}u), scale);
#else
    // Beyond 16, a transmittance is below that of 16 bits beside 1.
    let depth = scale * optical_length(grids[0], mirrored, enter, 16.0 / scale);
#endif
    put(number, exp(-depth));
#else ifdef VDB_SMOOTH
    let hit = first_root(grids[0], mirrored, enter, false);
    put(number, select(MISS, hit.t, hit.found));
#ifndef VDB_COUNT_STEPS
    if hit.found {
#ifdef VDB_SMOOTH_NORMALS
        let gradient = smooth_gradient(grids[0], hit);
#else
        let gradient = hit.gradient;
#endif
        normals[number] = vec4(normalize(gradient), 0.0);
    }
#endif
#else
    let hit = first_hit(grids[0], mirrored, enter);
    put(number, select(MISS, hit.t, hit.found));
#endif
}
