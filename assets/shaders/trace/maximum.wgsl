// Maximum intensity projection: the largest value of all fogs along a ray.
#define_import_path bevy_vdb::trace::maximum

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::KIND_FOG
#import bevy_vdb::trace::candidates::{next_candidate, start_t, volume_end}
#import bevy_vdb::trace::segment::{NONE, Segment, lattice_ray}
#import bevy_vdb::traversal::hdda::{enter_at, mirrored_ray}
#import bevy_vdb::traversal::maximum::largest_value
#import bevy_vdb::view::scene::{view, volumes}

struct Brightest {
    value: f32,
    t: f32,
    volume: u32,    // the fog that has it, or NONE
}

// The largest value of the fogs on a segment before `t_max`.
fn brightest(segment: Segment, pixel: vec2<u32>, t_max: f32) -> Brightest {
    var found = Brightest(0.0, 0.0, NONE);
    let end = volume_end(segment);
    var i = next_candidate(segment, pixel, view.volume_first, t_max);
    for (; i < end; i = next_candidate(segment, pixel, i + 1u, t_max)) {
        if volumes[i].kind != KIND_FOG {
            continue;
        }
        let grid = grids[volumes[i].grid];
        let mirrored = mirrored_ray(grid, lattice_ray(segment, i, t_max));
        let own = largest_value(grid, mirrored, enter_at(mirrored, start_t(segment, i, pixel)), found.value);
        if own.value > found.value {
            found = Brightest(own.value, own.t, i);
        }
    }
    return found;
}
