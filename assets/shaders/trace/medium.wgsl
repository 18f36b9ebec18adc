// A fog or an emission grid along a segment, as it is marched together with others.
#define_import_path bevy_vdb::trace::medium

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::trace::fog_march::MAX_DEPTH_OF_STEP
#ifdef VDB_VARYING_ALBEDO
#import bevy_vdb::trace::scattering::Tint
#else
#import bevy_vdb::trace::scattering::{Tint, tint}
#endif
#import bevy_vdb::trace::segment::{Segment, lattice_ray}
#import bevy_vdb::traversal::fog::{SampledRay, sampled_ray}
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray}
#import bevy_vdb::traversal::tree::{Accessor, new_accessor}
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

// A medium along a segment. Every t is relative to where the march begins.
struct Medium {
    volume: u32,
    extinction: f32,    // per unit of density and of t
    max_density: f32,   // keeps products with a step within f32
    albedo: Tint,       // 1 where it varies
    ray: SampledRay,
    accessor: Accessor,
    t_step: f32,        // the longest step
    t_next: f32,        // there is nothing before this t; FAR if there is nothing left
    t_last: f32,        // there is nothing after this t
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

// A slot for which there is no medium.
fn no_medium() -> Medium {
    var medium = Medium();
    medium.t_step = FAR;
    medium.t_next = FAR;
    return medium;
}

// A medium before it is known where the march begins. Steps are at most `step` voxels.
fn new_medium(segment: Segment, volume: u32, step: f32, t_max: f32) -> Medium {
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let ray = sampled_ray(mirrored);
    let t_step = step / max(length(mirrored.speed), 1e-30);
    var medium = Medium();
    medium.volume = volume;
    medium.extinction = volumes[volume].density_scale * length(segment.dir);
    medium.max_density = MAX_DEPTH_OF_STEP / max(medium.extinction * t_step, 1e-30);
#ifdef VDB_VARYING_ALBEDO
    medium.albedo = Tint(vec3(1.0));
#else
    medium.albedo = tint(volumes[volume].base_color);
#endif
    medium.ray = ray;
    medium.accessor = new_accessor(ray.cell);
    medium.t_step = t_step;
    medium.t_next = FAR;
    medium.t_last = FAR;
#ifdef VDB_RAMPS
    medium.t_known = -FAR;
#endif
    return medium;
}

// The medium when it is known that the march begins at `t_zero`.
fn begun(medium: Medium, segment: Segment, pixel: vec2<u32>, t_zero: f32) -> Medium {
    var moved = medium;
    let t_origin = medium.ray.t_origin - t_zero;
    let t_begin = max(t_origin + medium.ray.t_first, start_t(segment, medium.volume, pixel) - t_zero);
    moved.ray.t_origin = t_origin;
    moved.t_last = t_origin + medium.ray.t_last;
    moved.t_next = select(FAR, t_begin, t_begin < moved.t_last);
    return moved;
}

// The longest step from `t_low` that suits a medium: it is there, or begins after the step.
fn suitable_step(medium: Medium, t_low: f32, t_end: f32, t_base: f32, inverse_base: f32) -> f32 {
    return max(medium.t_step, floor((min(medium.t_next, t_end) - t_low) * inverse_base) * t_base);
}

// The first step that may contain something, in base steps, if it begins at `next`. Steps that may contain
// emission begin before it; for fog, it is enough that the middle does not.
fn first_step(next: f32) -> f32 {
#ifdef VDB_EMISSION
    return floor(next);
#else
    return ceil(next - 0.5);
#endif
}
