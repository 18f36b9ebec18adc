// A view and the volumes that it sees, or that throw shadows on what it sees.
#define_import_path bevy_vdb::view::scene

#import bevy_vdb::gpu::types::{View, Volume}
#ifdef VDB_SCALED
#import bevy_vdb::view::picture::pixel_of
#endif

@group(2) @binding(4) var<uniform> view: View;
@group(2) @binding(5) var<storage, read> volumes: array<Volume>;

// The pixel of the target that a ray of the view goes through.
fn target_pixel(pixel: vec2<u32>) -> vec2<u32> {
#ifdef VDB_SCALED
    return view.origin + pixel_of(pixel, view.size, view.picture, view.jitter);
#else
    return view.origin + pixel;
#endif
}

// A number from 0 up to but not 1 that the frames of a view share evenly among them, where they are put
// together: the fractional parts of multiples of an irrational one. Otherwise 0.
fn frame_random(irrational: f32) -> f32 {
    return fract(f32(view.frame & 4095u) * irrational);
}

// One past the volumes that the view sees.
fn visible_end() -> u32 {
    return view.volume_first + view.volume_count;
}

// One past those that shadows and reflections look at too: what is out of the picture comes last.
fn scene_end() -> u32 {
    return visible_end() + view.offscreen_count;
}
