// What a fog does to a ray. Twin of the walk: `optical_length` in `pack/walk.rs`.
#define_import_path bevy_vdb::fog

#import bevy_vdb::types::{Grid, Ray}
#import bevy_vdb::tree::{Span, corners, locate, span_constant, span_occupied, tile_value, trilinear}
#import bevy_vdb::hdda::{Walk, advance, count_step, enter}

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

// ∫ density dt along the ray, up to `enough`. Within one trilinear cell the density is a cubic in
// t, which the two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
fn optical_length(grid: Grid, ray: Ray, enough: f32) -> f32 {
    var sum = 0.0;
    var walk = enter(grid, ray);
    while walk.inside && sum < enough {
        count_step();
        let span = locate(grid, walk.cell);
        let next = advance(grid, ray, walk, span.log_dim);
        if span_occupied(span) {
            let t_to = min(next.t, walk.t_end);
            sum += (t_to - walk.t) * mean_density(grid, ray, walk.cell, span, walk.t, t_to);
        }
        walk = next;
    }
    return sum;
}
