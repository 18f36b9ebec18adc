// What a fog does to a ray. Twin of the walk: `optical_length` in `pack/walk.rs`.
#define_import_path bevy_vdb::fog

#import bevy_vdb::types::{Grid, Ray}
#import bevy_vdb::tree::{Span, corners, locate, span_constant, span_occupied, tile_value, trilinear}
#import bevy_vdb::anchor::anchored
#import bevy_vdb::hdda::{Walk, advance, count_step, enter, plane_t}

// Half the distance between the two points of Gauss and Legendre on an interval of length 1.
const GAUSS: f32 = 0.28867513;

// The mean density between two parameters within the cube of a span.
fn mean_density(grid: Grid, ray: Ray, cell: vec3<i32>, span: Span, t_from: f32, t_to: f32) -> f32 {
    if span_constant(span) {
        return tile_value(grid, span.word);
    }
    let c = corners(grid, cell);
    let origin = vec3<f32>(ray.cell - cell) + ray.frac;
    let first = origin + mix(t_from, t_to, 0.5 - GAUSS) * ray.dir;
    let second = origin + mix(t_from, t_to, 0.5 + GAUSS) * ray.dir;
    return 0.5 * (trilinear(c, saturate(first)) + trilinear(c, saturate(second)));
}

// Where a ray that began before it leaves the cube of 2^log_dim cells that holds a cell. By
// whichever plane comes first for its own numbers: those of an anchor are rounded, and where the
// ray hardly moves along the axis that the walk crosses, its plane can be far off.
fn exit_t(ray: Ray, cell: vec3<i32>, log_dim: u32) -> f32 {
    let size = 1i << log_dim;
    let low = cell & vec3(-size);
    let exits = plane_t(ray, select(low, low + size, ray.dir > vec3(0.0)));
    return min(min(exits.x, exits.y), exits.z);
}

// Cells that a walk may be away from its anchor before it gets a new one.
const ANCHOR_RANGE: i32 = 64;

// ∫ density dt along the ray, up to `enough`. Within one trilinear cell the density is a cubic in
// t, which the two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
//
// Anchors stand where a run of cells with a density begins: a place that does not depend on how the tree
// cuts the void into cubes, so that a grid looks the same, bit for bit, wherever it stands.
fn optical_length(grid: Grid, ray: Ray, enough: f32) -> f32 {
    var walk = enter(grid, ray);
    var near = ray;
    var in_run = false;
    var t_from = 0.0;
    var sum = 0.0;
    while walk.inside && sum < enough {
        count_step();
        let span = locate(grid, walk.cell);
        let here = walk;
        walk = advance(grid, ray, walk, span.log_dim);
        if !span_occupied(span) {
            in_run = false;
            continue;
        }
        if !in_run || any(abs(here.cell - near.cell) > vec3(ANCHOR_RANGE)) {
            near = anchored(ray, here.cell, here.axis, here.t).ray;
            t_from = 0.0;
        }
        let t_to = max(exit_t(near, here.cell, span.log_dim), t_from);
        let t_end = min(t_to, near.t_max);
        let mean = mean_density(grid, near, here.cell, span, t_from, t_end);
        sum += (t_end - t_from) * mean;
        t_from = t_to;
        // Of a mixed tile, cells without density count as void.
        in_run = mean > 0.0 && !span_constant(span);
    }
    return sum;
}
