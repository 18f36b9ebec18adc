// A fog or an emission grid along a segment, as it is marched together with others.
#define_import_path bevy_vdb::trace::medium

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::trace::fog_march::MIN_STEP
#import bevy_vdb::trace::segment::{Segment, lattice_ray}
#import bevy_vdb::traversal::fog::{SampledRay, sampled_part}
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray}
#import bevy_vdb::view::scene::volumes

// The most fogs and emission grids that are marched together. Each kind has slots of its own, so that no slot
// has code for both.
const MAX_FOGS: u32 = #{VDB_FOG_SLOTS}u;
#ifdef VDB_EMISSION
const MAX_EMITTERS: u32 = #{VDB_EMITTER_SLOTS}u;
#endif

// The volumes that a segment meets.
struct MetMedia {
    fogs: array<u32, MAX_FOGS>,
    fog_count: u32,
#ifdef VDB_EMISSION
    emitters: array<u32, MAX_EMITTERS>,
    emitter_count: u32,
#endif
}

// A medium along a segment. Every t is relative to where the march begins. With several fogs, these are in memory
// rather than in registers, so they hold nothing that can be computed from the volume.
struct Medium {
    volume: u32,
    ray: SampledRay,
    t_next: f32,        // there is nothing before this t; FAR if there is nothing left
    t_last: f32,        // there is nothing after this t
#ifdef VDB_EMITS
    t_first: f32,       // where the ray enters the grid's box
#endif
#ifdef VDB_RAMPS
    t_known: f32,       // where the last sample at the end of a step was taken; its value
    value: f32,
#endif
}

// Otherwise there is a single fog, whose steps are all alike.
#ifdef VDB_EMISSION
const HAS_MANY_MEDIA: bool = true;
#else
const HAS_MANY_MEDIA: bool = MAX_FOGS > 1u;
#endif

// Voxels of a step through an emission grid.
const EMISSION_STEP: f32 = 2.0;

// A volume that a segment misses.
fn missed_medium(volume: u32) -> Medium {
    var medium = Medium();
    medium.volume = volume;
    medium.t_next = FAR;
    medium.t_last = -FAR;
    return medium;
}

// A volume along a segment, before it is known where the march begins: every t is that of the segment.
fn new_medium(segment: Segment, volume: u32, t_max: f32) -> Medium {
    let grid = grids[volumes[volume].grid];
    let part = sampled_part(mirrored_ray(grid, lattice_ray(segment, volume, t_max)));
    if part.t_last < part.t_first {
        return missed_medium(volume);
    }
    var medium = Medium();
    medium.volume = volume;
    medium.ray = part.ray;
    medium.t_next = part.ray.t_origin + part.t_first;
    medium.t_last = part.ray.t_origin + part.t_last;
#ifdef VDB_EMITS
    medium.t_first = medium.t_next;
#endif
#ifdef VDB_RAMPS
    medium.t_known = -FAR;
#endif
    return medium;
}

// The medium when it is known that the march begins at `t_zero`.
fn begun(medium: Medium, segment: Segment, pixel: vec2<u32>, t_zero: f32) -> Medium {
    var moved = medium;
    let t_begin = max(medium.t_next, start_t(segment, medium.volume, pixel));
    moved.ray.t_origin -= t_zero;
    moved.t_last -= t_zero;
#ifdef VDB_EMITS
    moved.t_first -= t_zero;
#endif
    moved.t_next = select(FAR, t_begin - t_zero, t_begin < medium.t_last);
    return moved;
}

// How far t advances over this many voxels of a medium.
fn step_of_voxels(medium: Medium, voxels: f32) -> f32 {
    return voxels / max(length(medium.ray.dir), 1e-30);
}

fn fog_step_voxels(volume: u32) -> f32 {
    return max(volumes[volume].fog_step, MIN_STEP);
}
