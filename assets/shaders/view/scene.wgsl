// A view, the volumes in it, and the volumes that cast shadows into it.
#define_import_path bevy_vdb::view::scene

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::{Grid, LEVEL_MASK, LEVEL_SHIFT, MATERIAL_SHIFT, View, Volume}
#ifdef VDB_SCALED
#import bevy_vdb::view::picture::pixel_of
#endif

@group(2) @binding(4) var<uniform> view: View;
@group(2) @binding(5) var<storage, read> volumes: array<Volume>;

// The pixel of the target that a view ray passes through.
fn target_pixel(pixel: vec2<u32>) -> vec2<u32> {
#ifdef VDB_SCALED
    return view.origin + pixel_of(pixel, view.size, view.picture, view.jitter);
#else
    return view.origin + pixel;
#endif
}

// The value in the depth buffer at t of the view's rays. In front of the near plane, it is that of the near plane.
fn depth_of_t(t: f32) -> f32 {
    let m = view.depth_from_t;
    return saturate((m.x * t + m.y) / (m.z * t + m.w));
}

// The number of a volume's custom material, or 0 for none.
fn material_number(volume: u32) -> u32 {
    return volumes[volume].flags >> MATERIAL_SHIFT;
}

// A point in a cell of a volume's lattice, in the index space of the grid itself, whatever its level of detail.
fn index_position(volume: u32, cell: vec3<i32>, frac: vec3<f32>) -> vec3<f32> {
    let level = (volumes[volume].flags >> LEVEL_SHIFT) & LEVEL_MASK;
    return (vec3<f32>(cell + volumes[volume].base) + frac) * f32(1u << level);
}

// The grid of a fog, with its ramp or the custom material. A fog has one of them.
fn fog_grid(volume: u32) -> Grid {
    var grid = grids[volumes[volume].grid];
#ifdef VDB_RAMPS
    grid.ramp = volumes[volume].ramp;
    grid.ramp_low = volumes[volume].ramp_low;
    grid.ramp_scale = volumes[volume].ramp_scale;
#endif
#ifdef VDB_FOG_MATERIALS
    grid.ramp |= material_number(volume) << MATERIAL_SHIFT;
    grid.records = volume;
#endif
    return grid;
}

// A number in [0, 1) that is evenly distributed over accumulated or jittered frames: the fractional part of
// a multiple of an irrational number. For other frames it is 0.
fn frame_random(irrational: f32) -> f32 {
    return random_of(view.frame, irrational);
}

fn random_of(frame: u32, irrational: f32) -> f32 {
    return fract(f32(frame & 4095u) * irrational);
}

// A number in [0, 1) that is evenly distributed among neighbouring pixels: Jimenez's interleaved gradient
// noise (2014, "Next generation post processing in Call of Duty: Advanced Warfare").
fn interleaved_gradient_noise(pixel: vec2<f32>) -> f32 {
    return fract(52.9829189 * fract(dot(pixel, vec2(0.06711056, 0.00583715))));
}

// The place of a pixel on a Hilbert curve through a tile of 64² pixels.
fn hilbert_index(pixel: vec2<u32>) -> u32 {
    var at = pixel & vec2(63u);
    var index = 0u;
    for (var size = 32u; size > 0u; size >>= 1u) {
        let is_far = (at & vec2(size)) != vec2(0u);
        index += size * size * select(select(0u, 1u, is_far.y), select(3u, 2u, is_far.y), is_far.x);
        if !is_far.y {
            at = select(at.yx, 63u - at.yx, is_far.x);
        }
    }
    return index;
}

// Two numbers in [0, 1) that are evenly distributed over a square among neighbouring pixels and, in another way,
// over frames: the R2 sequence (Roberts 2018, "The unreasonable effectiveness of
// quasirandom sequences") along a Hilbert curve, whose neighbours are neighbours in the image, too. `dimension` tells
// apart what a pixel needs several pairs for.
fn random_pair(pixel: vec2<u32>, dimension: u32, frame: u32) -> vec2<f32> {
    let index = hilbert_index(pixel) + 4096u * dimension;
    // In units of 2^-32, whose sums wrap as fractions do.
    let sequence = vec2<f32>((index * vec2(3242174889u, 2447445414u)) >> vec2(8u)) / 16777216.0;
    return fract(sequence + vec2(random_of(frame, 0.41421356), random_of(frame, 0.73205081)));
}

// One past the last volume in the view.
fn visible_end() -> u32 {
    return view.volume_first + view.volume_count;
}

// One past the last volume that shadows and reflections consider; volumes outside the view come last.
fn scene_end() -> u32 {
    return visible_end() + view.offscreen_count;
}
