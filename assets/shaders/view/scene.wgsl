// A view, the volumes in it, and the volumes that cast shadows into it.
#define_import_path bevy_vdb::view::scene

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::{Grid, View, Volume}
#ifdef VDB_FOG_MATERIALS
#import bevy_vdb::gpu::types::MATERIAL_SHIFT
#endif
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

// The grid of a fog, with its ramp or the app's own material. A fog has one of them.
fn fog_grid(volume: u32) -> Grid {
    var grid = grids[volumes[volume].grid];
#ifdef VDB_RAMPS
    grid.ramp = volumes[volume].ramp;
    grid.ramp_low = volumes[volume].ramp_low;
    grid.ramp_scale = volumes[volume].ramp_scale;
#endif
#ifdef VDB_FOG_MATERIALS
    grid.ramp |= (volumes[volume].flags >> MATERIAL_SHIFT) << MATERIAL_SHIFT;
    grid.records = volume;
#endif
    return grid;
}

// A number in [0, 1) that is evenly distributed over accumulated or jittered frames: the fractional part of
// a multiple of an irrational number. For other frames it is 0.
fn frame_random(irrational: f32) -> f32 {
    return fract(f32(view.frame & 4095u) * irrational);
}

// A number in [0, 1) that is evenly distributed among neighbouring pixels: Jimenez's interleaved gradient
// noise (2014, "Next generation post processing in Call of Duty: Advanced Warfare").
fn interleaved_gradient_noise(pixel: vec2<f32>) -> f32 {
    return fract(52.9829189 * fract(dot(pixel, vec2(0.06711056, 0.00583715))));
}

// One past the last volume in the view.
fn visible_end() -> u32 {
    return view.volume_first + view.volume_count;
}

// One past the last volume that shadows and reflections consider; volumes outside the view come last.
fn scene_end() -> u32 {
    return visible_end() + view.offscreen_count;
}
