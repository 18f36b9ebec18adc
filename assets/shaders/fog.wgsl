// What a fog does to a ray. Twin of the walk: `optical_length` in `pack/walk.rs`.
#define_import_path bevy_vdb::fog

#import bevy_vdb::types::Grid
#import bevy_vdb::exact::Course
#import bevy_vdb::samples::{fog_corners, tile_value, trilinear}
#import bevy_vdb::tree::{CHILD, LEAF_NUMBER, MIXED, OCCUPIED, Span, empty_cell, empty_span, locate, locate_slot, nowhere, reach_of, span_constant, span_occupied}
#import bevy_vdb::anchor::{Anchor, anchor_exit, anchor_t, anchored}
#import bevy_vdb::hdda::{Walk, advance, begin_of, confirm, count_step, enter, local_cell, plane_t, planes_behind, unturned}

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

// The same by the density at even distances, `step` voxels, of which the first is half as far behind where
// the ray comes into the grid's box: places that do not depend on the tree. Nothing dims the ray before
// `start`.
fn stepped_length(grid: Grid, course: Course, start: f32, enough: f32, step: f32) -> f32 {
    let enters = enter(course);
    if !enters.inside {
        return 0.0;
    }
    let near = anchored(course, enters.rel, enters.axis, enters.t);
    let exits = plane_t(course, course.last + 1u);
    let t_end = min(min(min(exits.x, exits.y), exits.z), course.t_max) - near.t;
    let t_step = step / length(course.speed);
    // In cells of the lattice, from the anchor's on.
    let cell = local_cell(course, near.cell);
    let origin = unturned(course, near.frac);
    let way = select(course.speed, -course.speed, course.flip != vec3(0));
    var place = nowhere(cell);
    var sum = 0.0;
    var k = max(ceil((start - near.t) / t_step - 0.5), 0.0);
    while sum < enough {
        let t = (k + 0.5) * t_step;
        if t >= t_end {
            break;
        }
        count_step();
        k += 1.0;
        let at = origin + t * way;
        let whole = floor(at);
        // Rounding may lead a cell out of the box.
        let here = clamp(cell + vec3<i32>(whole), grid.occupied_min, grid.occupied_max);
        let slot = locate_slot(grid, here, &place);
        if (slot & (CHILD | OCCUPIED)) == 0u {
            let rel = bitcast<vec3<u32>>((here ^ course.flip) - course.cell);
            let span = empty_span(place.log_dim, reach_of(slot, course.octant));
            let out = anchor_t(near, course, planes_behind(course, rel, span));
            k = max(k, ceil(min(min(out.x, out.y), out.z) / t_step - 0.5));
        } else if (slot & (CHILD | MIXED)) == 0u {
            sum += t_step * tile_value(grid, slot);
        } else {
            let span = Span(0u, 0u, slot, place.head + (slot & LEAF_NUMBER));
            sum += t_step * trilinear(fog_corners(grid, span, here), at - whole);
        }
    }
    return sum;
}
