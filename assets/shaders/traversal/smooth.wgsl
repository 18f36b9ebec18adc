// The first root of the trilinear interpolant: where a ray crosses the iso-surface.
#define_import_path bevy_vdb::traversal::smooth

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::rebase::{rebased_exit, rebased_at}
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::samples::{Corners, surface_corners, trilinear, trilinear_gradient}
#import bevy_vdb::traversal::tree::{Accessor, empty_cell, locate, new_accessor, span_occupied}
#import bevy_vdb::traversal::hdda::{Dda, advance, confirm, count_step, local_cell, unmirrored, clamp_to_ray}

struct SurfaceHit {
    found: bool,
    t: f32,
    // The cell, and the position within it, 0 to 1 on each axis.
    cell: vec3<i32>,
    frac: vec3<f32>,
    // In index space, not normalised.
    gradient: vec3<f32>,
    // Axis of the face through which the ray entered the cell; 3 if it began inside.
    axis: u32,
    // The samples at the corners of the cell, and the path to it.
    corners: Corners,
    accessor: Accessor,
#ifdef VDB_CLIP
    begins_inside: bool,    // whether the ray began inside the solid
#endif
}

// The root finder stops when its step is below this fraction of the path through the cell: Newton's method
// converges quadratically.
const ROOT_TOLERANCE: f32 = 0.000003814697265625;   // 2^-18

// A cubic from its coefficients: a.x + s·(a.y + s·(a.z + s·a.w)).
fn cubic_at(a: vec4<f32>, s: f32) -> f32 {
    return a.x + s * (a.y + s * (a.z + s * a.w));
}

// The root between two points where a cubic has the values f_low and f_high of opposite signs.
fn bracketed_root(a: vec4<f32>, s_low: f32, s_high: f32, f_low: f32, f_high: f32) -> f32 {
    var low = s_low;
    var high = s_high;
    let negative = f_low < 0.0;
    // Start with linear interpolation, but not at an end, which may itself be a root and would be taken for
    // the one sought. Then take Newton steps, or bisect where a step would leave the bracket.
    var s = low + (high - low) * clamp(f_low / (f_low - f_high), 0.0625, 0.9375);
    for (var i = 0u; i < 16u; i++) {
        let f = cubic_at(a, s);
        if (f < 0.0) == negative {
            low = s;
        } else {
            high = s;
        }
        let slope = a.y + s * (2.0 * a.z + s * 3.0 * a.w);
        let newton = s - f / select(slope, 1.0, slope == 0.0);
        let inside = newton > low && newton < high && slope != 0.0;
        let next = select(0.5 * (low + high), newton, inside);
        let done = abs(next - s) <= ROOT_TOLERANCE;
        s = next;
        if done {
            break;
        }
    }
    return s;
}

// The first sign change of a cubic in [0, 1], or 2 if there is none. f_start and f_end are its values at the
// ends.
fn first_sign_change(a: vec4<f32>, f_start: f32, f_end: f32) -> f32 {
    // Bézier control points: the cubic changes sign at most as often as they do.
    let second_point = f_start + a.y / 3.0;
    let third_point = f_end - (a.y + 2.0 * a.z + 3.0 * a.w) / 3.0;
    let is_negative = vec4(f_start, second_point, third_point, f_end) < vec4(0.0);
    let changes = vec3<u32>(is_negative.xyz != is_negative.yzw);
    let count = changes.x + changes.y + changes.z;
    if count == 0u {
        return 2.0;
    }
    if count == 1u {
        return bracketed_root(a, 0.0, 1.0, f_start, f_end);
    }
    return first_sign_change_of_several(a, f_start, f_end);
}

// The same where there may be several sign changes. Between its extrema, a cubic has at most one.
fn first_sign_change_of_several(a: vec4<f32>, f_start: f32, f_end: f32) -> f32 {
    // 3·a.w·s² + 2·a.z·s + a.y = 0, without cancellation.
    let b = a.z;
    let root = b * b - 3.0 * a.w * a.y;
    var ends = vec3(2.0, 2.0, 1.0);
    if root > 0.0 {
        let q = -(b + select(-sqrt(root), sqrt(root), b >= 0.0));
        let r_0 = select(2.0, q / (3.0 * a.w), abs(a.w) > 1e-30);
        let r_1 = select(2.0, a.y / q, abs(q) > 1e-30);
        ends = vec3(min(r_0, r_1), max(r_0, r_1), 1.0);
    }
    var low = 0.0;
    var f_low = f_start;
    for (var i = 0u; i < 3u; i++) {
        let high = select(select(ends.z, ends.y, i == 1u), ends.x, i == 0u);
        if high > 0.0 && (high < 1.0 || i == 2u) {
            let f_high = select(cubic_at(a, high), f_end, i == 2u);
            if (f_high < 0.0) != (f_low < 0.0) {
                return bracketed_root(a, low, high, f_low, f_high);
            }
            low = high;
            f_low = f_high;
        }
    }
    return 2.0;
}

fn no_hit() -> SurfaceHit {
    var none: SurfaceHit;
    return none;
}

// The first root of the interpolant on a mirrored ray. Values are relative to the iso-value.
//
// With `begins_outside`, a finer level of detail or another page has shown that the ray begins outside the solid. If
// it begins inside that of this grid, because the two differ, its first point counts as a hit.
fn first_root(grid: Grid, mirrored: MirroredRay, entry: Dda, begins_outside: bool) -> SurfaceHit {
    var expects_outside = begins_outside;
    var dda = entry;
    var accessor = new_accessor(local_cell(mirrored, dda.rel));
    // Whether the interpolant was negative at the end of the previous cell. A sign change exactly between
    // two cells is also a root, which rounding must not lose.
    var has_previous = false;
    var was_negative = false;
#ifdef VDB_CLIP
    // Known from the first cell that the surface may pass through.
    var is_first = true;
    var begins_inside = false;
#endif
    while dda.inside {
        count_step();
        var cell = local_cell(mirrored, dda.rel);
        var span = locate(grid, cell, mirrored.octant, &accessor);
#ifdef VDB_IN_STEP
        // First advance each ray to an occupied cell: what follows is expensive, and threads of a subgroup
        // should run it together.
        while !span_occupied(span) && dda.inside {
            dda = advance(mirrored, dda, span);
            has_previous = false;
            if dda.inside {
                count_step();
                cell = local_cell(mirrored, dda.rel);
                span = locate(grid, cell, mirrored.octant, &accessor);
            }
        }
        if !dda.inside {
            break;
        }
#else
        if !span_occupied(span) {
            dda = advance(mirrored, dda, span);
            has_previous = false;
            continue;
        }
#endif
        let confirmed = confirm(mirrored, dda);
        dda = advance(mirrored, dda, empty_cell());
        if !confirmed.inside {
            continue;
        }
        let c = surface_corners(grid, span, cell);
        let rebased = rebased_at(mirrored, confirmed.rel, confirmed.axis, confirmed.t);
        let exit = rebased_exit(rebased, mirrored, confirmed.rel + 1u, dda.axis);
        let t_length = max(min(exit, rebased.end), 0.0);
        let start = unmirrored(mirrored, rebased.frac);
        let path = t_length * select(mirrored.speed, -mirrored.speed, mirrored.mirror != vec3(0));
        // Four values of the cubic, then its coefficients.
        let f_0 = trilinear(c, start);
        let f_1 = trilinear(c, saturate(start + path / 3.0));
        let f_2 = trilinear(c, saturate(start + path * (2.0 / 3.0)));
        let f_3 = trilinear(c, saturate(start + path));
        let d_1 = f_1 - f_0;
        let d_2 = f_2 - 2.0 * f_1 + f_0;
        let d_3 = f_3 - 3.0 * f_2 + 3.0 * f_1 - f_0;
        let a = vec4(
            f_0,
            3.0 * d_1 - 1.5 * d_2 + d_3,
            4.5 * (d_2 - d_3),
            4.5 * d_3,
        );
#ifdef VDB_CLIP
        begins_inside = select(begins_inside, f_0 < 0.0, is_first);
        is_first = false;
#endif
        var s = 2.0;
        if (has_previous && was_negative != (f_0 < 0.0)) || (expects_outside && f_0 < 0.0) {
            s = 0.0;
        } else {
            s = first_sign_change(a, f_0, f_3);
        }
        if s <= 1.0 {
            // The coefficients amplify the rounding of the four values. One Newton step on the interpolant
            // itself removes most of that error.
            let first_guess = saturate(start + s * path);
            let slope = dot(trilinear_gradient(c, first_guess), path);
            let correction = trilinear(c, first_guess) / select(slope, 1.0, slope == 0.0);
            s = saturate(s - select(0.0, correction, slope != 0.0 && abs(correction) < 0.01));
            let root = saturate(start + s * path);
            return SurfaceHit(
                true,
                clamp_to_ray(mirrored, confirmed.t + s * t_length),
                cell,
                root,
                grid.scale * trilinear_gradient(c, root),
                confirmed.axis,
                c,
                accessor,
#ifdef VDB_CLIP
                begins_inside,
#endif
            );
        }
        expects_outside = false;
        has_previous = true;
        was_negative = f_3 < 0.0;
    }
    return no_hit();
}
