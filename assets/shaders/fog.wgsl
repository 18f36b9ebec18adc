// What a fog does to a ray. Twin of the walk: `optical_length` in `pack/walk.rs`.
#define_import_path bevy_vdb::fog

#import bevy_vdb::types::Grid
#import bevy_vdb::exact::Course
#import bevy_vdb::samples::{fog_corners, tile_value, trilinear}
#import bevy_vdb::tree::{Span, empty_cell, locate, nowhere, span_constant, span_occupied}
#import bevy_vdb::anchor::{Anchor, anchor_exit, anchored}
#import bevy_vdb::hdda::{Walk, advance, begin_of, confirm, count_step, local_cell, planes_behind, unturned}

// Half the distance between the two points of Gauss and Legendre on an interval of length 1.
const GAUSS: f32 = 0.28867513;

// The mean density between two parameters from the anchor on, within the cube of a span.
fn mean_density(
    grid: Grid,
    course: Course,
    near: Anchor,
    walk: Walk,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> f32 {
    if span_constant(span) {
        return tile_value(grid, span.word);
    }
    let c = fog_corners(grid, span, local_cell(course, walk.rel));
    let origin = near.frac - vec3<f32>(walk.rel - near.cell);
    let first = saturate(origin + mix(t_from, t_to, 0.5 - GAUSS) * course.speed);
    let second = saturate(origin + mix(t_from, t_to, 0.5 + GAUSS) * course.speed);
    return 0.5 * (trilinear(c, unturned(course, first)) + trilinear(c, unturned(course, second)));
}

// Cells that a walk may be away from its anchor before it gets a new one.
const ANCHOR_RANGE: u32 = 64u;

// ∫ density dt along the course, up to `enough`. Within one trilinear cell the density is a cubic in
// t, which the two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
//
// Anchors stand where a run of cells with a density begins: a place that does not depend on how the tree
// cuts the void into cubes, so that a grid looks the same, bit for bit, wherever it stands.
fn optical_length(grid: Grid, course: Course, enters: Walk, enough: f32) -> f32 {
    var walk = enters;
    var place = nowhere(local_cell(course, walk.rel));
    var near = Anchor(vec3(0u), vec3(0.0), 0.0);
    var in_run = false;
    var t_from = 0.0;
    var sum = 0.0;
    while walk.inside && sum < enough {
        count_step();
        var span = locate(grid, local_cell(course, walk.rel), course.octant, &place);
        let here = walk;
        if !span_occupied(span) {
            walk = advance(course, here, span);
            in_run = false;
            continue;
        }
        if !in_run || any(here.rel - near.cell > vec3(ANCHOR_RANGE)) {
            let own = confirm(course, here, begin_of(enters));
            if !own.inside {
                walk = advance(course, here, empty_cell());
                continue;
            }
            near = anchored(course, own.rel, own.axis, own.t);
            t_from = 0.0;
        }
        walk = advance(course, here, span);
        let plane = planes_behind(course, here.rel, span);
        let t_to = max(anchor_exit(near, course, plane, walk.axis, walk.t), t_from);
        let t_end = min(t_to, course.t_max - near.t);
        let mean = mean_density(grid, course, near, here, span, t_from, t_end);
        sum += (t_end - t_from) * mean;
        t_from = t_to;
        // Of a mixed tile, cells without density count as void.
        in_run = mean > 0.0 && !span_constant(span);
    }
    return sum;
}
