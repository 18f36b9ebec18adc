// The largest value of fog along a ray.
#define_import_path bevy_vdb::traversal::maximum

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::cubic::{cubic_at, cubic_extrema, cubic_of_points}
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::samples::{Corners, control_points, fog_cell, tile_value}
#import bevy_vdb::traversal::tree::{empty_cell, locate, new_accessor, span_constant, span_occupied}
#import bevy_vdb::traversal::rebase::{rebased_at, rebased_exit}
#import bevy_vdb::traversal::hdda::{Dda, advance, confirm, count_step, exit_planes, local_cell, unmirrored}

struct Largest {
    value: f32,     // 0 if the ray meets no positive value
    t: f32,
}

// The largest value from 0 to 1 of the cubic with these Bézier control points, and where it is.
fn largest_of_cubic(b: vec4<f32>) -> vec2<f32> {
    let a = cubic_of_points(b);
    var largest = select(vec2(b.x, 0.0), vec2(b.w, 1.0), b.w > b.x);
    let extrema = cubic_extrema(a);
    for (var i = 0u; i < 2u; i++) {
        let s = select(extrema.y, extrema.x, i == 0u);
        let value = cubic_at(a, s);
        largest = select(largest, vec2(value, s), s > 0.0 && s < 1.0 && value > largest.x);
    }
    return largest;
}

fn highest_corner(c: Corners) -> f32 {
    let highest = max(c.low, c.high);
    return max(max(highest.x, highest.y), max(highest.z, highest.w));
}

// The largest value along a mirrored ray, if it is more than `least`. In each trilinear cell, the value is a cubic
// in t, so there is no step size to choose.
fn largest_value(grid: Grid, mirrored: MirroredRay, entry: Dda, least: f32) -> Largest {
    var largest = Largest(least, 0.0);
    var dda = entry;
    var accessor = new_accessor(local_cell(mirrored, dda.rel));
    while dda.inside {
        count_step();
        let cell = local_cell(mirrored, dda.rel);
        let span = locate(grid, cell, mirrored.octant, &accessor);
        let current = dda;
        if !span_occupied(span) {
            dda = advance(mirrored, current, span);
            continue;
        }
        let confirmed = confirm(mirrored, current);
        if !confirmed.inside {
            dda = advance(mirrored, current, empty_cell());
            continue;
        }
        dda = advance(mirrored, current, span);
        if span_constant(span) {
            let value = tile_value(grid, span.word);
            if value > largest.value {
                largest = Largest(value, confirmed.t);
            }
            continue;
        }
        let own = fog_cell(grid, span, cell);
        if own.offset + own.scale * highest_corner(own.corners) <= largest.value {
            continue;
        }
        let rebased = rebased_at(mirrored, confirmed.rel, confirmed.axis, confirmed.t);
        let plane = exit_planes(mirrored, current.rel, span);
        let exit = rebased_exit(rebased, mirrored, plane, dda.axis);
        let t_length = max(min(exit, rebased.end), 0.0);
        let start = unmirrored(mirrored, rebased.frac);
        let end = unmirrored(mirrored, saturate(rebased.frac + t_length * mirrored.speed));
        let found = largest_of_cubic(control_points(own.corners, start, end));
        let value = own.offset + own.scale * found.x;
        if value > largest.value {
            largest = Largest(value, confirmed.t + found.y * t_length);
        }
    }
    return largest;
}
