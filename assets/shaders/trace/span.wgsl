// The part of a segment along which several media are marched together, and its steps.
#define_import_path bevy_vdb::trace::span

#import bevy_vdb::trace::medium::{MAX_FOGS, Medium, MetMedia, begun, fog_step_voxels, new_medium}
#import bevy_vdb::trace::medium::step_of_voxels
#import bevy_vdb::trace::segment::Segment
#import bevy_vdb::traversal::fog::step_length
#import bevy_vdb::traversal::hdda::FAR
#ifdef VDB_EMISSION
#import bevy_vdb::trace::medium::{EMISSION_STEP, MAX_EMITTERS, missed_medium}
#endif

// Where media are, in t of the segment.
struct Extent {
    t_first: f32,
    t_last: f32,
    t_base: f32,    // the shortest step that suits one of them
}

// What is marched. Every t but `t_zero` is relative to `t_zero`.
struct Span {
    t_zero: f32,        // where the march begins, in t of the segment
    t_start: f32,       // there is nothing before this t
    t_end: f32,         // there is nothing after this t
    // The shortest step; all begin at its multiples from the segment's origin, so that neighbouring rays
    // sample neighbouring points.
    t_base: f32,
    inverse_base: f32,
}

// A step of the march.
struct Step {
    t_low: f32,
    t_middle: f32,
    t_high: f32,
    width: f32,
}

// Enlarges an extent to include a medium, which is sampled in steps of `step_voxels`.
fn extended(extent: Extent, medium: Medium, step_voxels: f32) -> Extent {
    return Extent(
        min(extent.t_first, medium.t_next),
        max(extent.t_last, medium.t_last),
        min(extent.t_base, step_of_voxels(medium, step_voxels)),
    );
}

// The march begins at the last multiple of the shortest step before the media.
fn new_span(extent: Extent) -> Span {
    let t_base = step_length(extent.t_base, extent.t_last - extent.t_first);
    let inverse_base = 1.0 / t_base;
    let t_zero = floor(extent.t_first * inverse_base) * t_base;
    return Span(t_zero, extent.t_first - t_zero, extent.t_last - t_zero, t_base, inverse_base);
}

// The step from `t_low` to a multiple of the shortest step.
fn step_to(span: Span, t_low: f32, k_high: f32) -> Step {
    let t_high = clamp(k_high * span.t_base, t_low, span.t_end);
    let width = t_high - t_low;
    return Step(t_low, t_low + 0.5 * width, t_high, width);
}

// Where to begin stepping if there is nothing before `t_next`, in multiples of the shortest step. The first step must
// contain `t_next` if there is emission. With fog alone it may begin later, as only the middle of a step is sampled.
fn first_step(span: Span, t_next: f32) -> f32 {
    let next = min(t_next, span.t_end) * span.inverse_base;
#ifdef VDB_EMISSION
    return floor(next);
#else
    return ceil(next - 0.5);
#endif
}

// The longest step from `t_low` that suits a medium: `step_voxels` inside it, as far as where it begins if that is
// farther ahead, and FAR if it has ended.
fn suitable_step(medium: Medium, step_voxels: f32, t_low: f32, span: Span) -> f32 {
    let t_longest = step_of_voxels(medium, step_voxels);
    let t_ahead = min(medium.t_next, span.t_end) - t_low;
    let steps_ahead = floor(t_ahead * span.inverse_base);
    return select(max(t_longest, steps_ahead * span.t_base), FAR, medium.t_next >= span.t_end);
}

// Fogs and emission grids have different numbers of slots, and a WGSL function takes arrays of one length only, so
// there is one for each kind.

// Fills the slots of fogs, and returns where they are.
fn meet_fogs(
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    met: MetMedia,
    segment: Segment,
    t_max: f32,
) -> Extent {
    var list = met.fogs;
    var extent = Extent(FAR, -FAR, FAR);
    for (var i = 0u; i < fog_count; i++) {
        let medium = new_medium(segment, list[i], t_max);
        (*fogs)[i] = medium;
        extent = extended(extent, medium, fog_step_voxels(list[i]));
    }
    return extent;
}

// The first t of a fog in a span.
fn begin_fogs(
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    segment: Segment,
    pixel: vec2<u32>,
    span: Span,
) -> f32 {
    var t_near = FAR;
    for (var i = 0u; i < fog_count; i++) {
        let medium = begun((*fogs)[i], segment, pixel, span.t_zero);
        (*fogs)[i] = medium;
        t_near = min(t_near, medium.t_next);
    }
    return t_near;
}

// The longest step from `t_low` that suits the fogs there and those that begin within it.
fn longest_fog_step(
    fogs: ptr<function, array<Medium, MAX_FOGS>>,
    fog_count: u32,
    span: Span,
    t_low: f32,
) -> f32 {
    var t_step = FAR;
    for (var i = 0u; i < fog_count; i++) {
        let step_voxels = fog_step_voxels((*fogs)[i].volume);
        t_step = min(t_step, suitable_step((*fogs)[i], step_voxels, t_low, span));
    }
    return t_step;
}

#ifdef VDB_EMISSION
// Fills the slots of emission grids, and returns where they and the fogs are.
fn meet_emitters(
    emitters: ptr<function, array<Medium, MAX_EMITTERS>>,
    emitter_count: u32,
    met: MetMedia,
    segment: Segment,
    t_max: f32,
    of_fogs: Extent,
) -> Extent {
    var list = met.emitters;
    var extent = of_fogs;
    for (var i = 0u; i < emitter_count; i++) {
        var medium = missed_medium(met.fogs[0]);
        if i < met.emitter_count {
            medium = new_medium(segment, list[i], t_max);
        }
        (*emitters)[i] = medium;
        extent = extended(extent, medium, EMISSION_STEP);
    }
    return extent;
}

// The first t of an emission grid in a span.
fn begin_emitters(
    emitters: ptr<function, array<Medium, MAX_EMITTERS>>,
    emitter_count: u32,
    segment: Segment,
    pixel: vec2<u32>,
    span: Span,
) -> f32 {
    var t_near = FAR;
    for (var i = 0u; i < emitter_count; i++) {
        let medium = begun((*emitters)[i], segment, pixel, span.t_zero);
        (*emitters)[i] = medium;
        t_near = min(t_near, medium.t_next);
    }
    return t_near;
}

// The longest step from `t_low` that suits the emission grids there and those that begin within it.
fn longest_emission_step(
    emitters: ptr<function, array<Medium, MAX_EMITTERS>>,
    emitter_count: u32,
    span: Span,
    t_low: f32,
) -> f32 {
    var t_step = FAR;
    for (var i = 0u; i < emitter_count; i++) {
        t_step = min(t_step, suitable_step((*emitters)[i], EMISSION_STEP, t_low, span));
    }
    return t_step;
}
#endif
