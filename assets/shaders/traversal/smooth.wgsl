// The first root of the trilinear interpolant: where a ray crosses the iso-surface.
#define_import_path bevy_vdb::traversal::smooth

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::cubic::first_sign_change
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_at}
#import bevy_vdb::traversal::exact::{MirroredRay, T_ERROR}
#import bevy_vdb::traversal::samples::{Corners, control_points, surface_corners, trilinear, trilinear_gradient}
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

fn no_hit() -> SurfaceHit {
    var none: SurfaceHit;
    return none;
}

// Refines a root s of the cubic along a path through a cell. Computing the cubic's coefficients amplifies rounding; one
// Newton step on the interpolant itself removes most of that error.
fn refined_root(c: Corners, start: vec3<f32>, path: vec3<f32>, s: f32) -> f32 {
    let first_guess = saturate(start + s * path);
    let slope = dot(trilinear_gradient(c, first_guess), path);
    let correction = trilinear(c, first_guess) / select(slope, 1.0, slope == 0.0);
    return saturate(s - select(0.0, correction, slope != 0.0 && abs(correction) < 0.01));
}

// The sign of the interpolant along a mirrored ray through a cell, -1 or 1, if it is certain to be the same all the way;
// otherwise 0. Positions in f32 suffice: a coordinate is off by less than half of T_ERROR times its distance from the
// ray's origin, which is at most `rel` + 1 cells, and no partial derivative of the interpolant exceeds twice the largest
// corner. The other half of the margin covers rounding in `control_points`.
fn certain_sign(mirrored: MirroredRay, rel: vec3<u32>, c: Corners) -> i32 {
    let distance = vec3<f32>(rel);
    let origin = mirrored.frac - distance;
    let enters = -origin * mirrored.inverse;
    let leaves = enters + mirrored.inverse;
    let t_start = max(max(enters.x, enters.y), enters.z);
    let t_end = min(min(leaves.x, leaves.y), leaves.z);
    let local_origin = unmirrored(mirrored, origin);
    let dir = select(mirrored.speed, -mirrored.speed, mirrored.mirror != vec3(0));
    // Far away, errors are larger than the cell, outside which the interpolant may have any value.
    let b = control_points(c, saturate(local_origin + t_start * dir), saturate(local_origin + t_end * dir));
    let corners = max(abs(c.low), abs(c.high));
    let largest_corner = max(max(corners.x, corners.y), max(corners.z, corners.w));
    let margin = (distance.x + distance.y + distance.z + 3.0) * (2.0 * T_ERROR) * largest_corner;
    let lowest = min(min(b.x, b.y), min(b.z, b.w));
    let highest = max(max(b.x, b.y), max(b.z, b.w));
    return select(select(0, -1, highest < -margin), 1, lowest > margin);
}

// A walk along a ray to the cells in which the interpolant may have a root.
struct Walk {
    dda: Dda,
    // The sign of the interpolant where the ray left the previous cell; 0 if there was none, or if it was empty. A sign
    // change exactly between two cells is also a root, which rounding must not lose.
    sign: i32,
    found: bool,
    // The cell that was found, its samples, and where the walk goes on.
    cell: vec3<i32>,
    corners: Corners,
    next: Dda,
#ifdef VDB_CLIP
    is_first: bool,         // whether no cell that the surface may pass through has been examined yet
    begins_inside: bool,    // known from the first such cell
#endif
}

// The initial sign of a ray that is known to begin outside. Unlike -1 and 1, it is kept through empty cells, because a
// first sample inside then counts as a hit.
const OUTSIDE: i32 = 2;

// Walks on to the next cell in which the interpolant may have a root. Most cells that the surface may pass through are
// rejected without exact arithmetic, so that neighbouring rays look for their roots together.
fn walk_on(grid: Grid, mirrored: MirroredRay, accessor: ptr<function, Accessor>, so_far: Walk) -> Walk {
    var walk = so_far;
    var dda = so_far.dda;
    var sign = so_far.sign;
    var found = false;
    while dda.inside && !found {
        count_step();
        let cell = local_cell(mirrored, dda.rel);
        let span = locate(grid, cell, mirrored.octant, accessor);
        if span_occupied(span) {
            let corners = surface_corners(grid, span, cell);
            let own_sign = certain_sign(mirrored, dda.rel, corners);
            let next = advance(mirrored, dda, empty_cell());
            found = own_sign == 0 || own_sign * sign < 0;
            if found {
                walk.cell = cell;
                walk.corners = corners;
                walk.next = next;
            } else {
                sign = own_sign;
                dda = next;
#ifdef VDB_CLIP
                walk.begins_inside = select(walk.begins_inside, sign < 0, walk.is_first);
                walk.is_first = false;
#endif
            }
        } else {
            sign = select(0, OUTSIDE, sign == OUTSIDE);
            dda = advance(mirrored, dda, span);
        }
    }
    walk.dda = dda;
    walk.sign = sign;
    walk.found = found;
    return walk;
}

// Where a mirrored ray leaves a cell through a face of `axis` at the parameter `exit`, or where it ends in the cell, at
// `t_length` from where it enters. The face is exact, because what lies just behind it may be a different cell.
fn end_in_cell(rebased: Rebased, mirrored: MirroredRay, t_length: f32, exit: f32, axis: u32) -> vec3<f32> {
    let end = saturate(rebased.frac + t_length * mirrored.speed);
    return select(end, vec3(1.0), (vec3(0u, 1u, 2u) == vec3(axis)) & vec3(exit <= rebased.end));
}

// The first root of the interpolant on a mirrored ray. Values are relative to the iso-value.
//
// With `begins_outside`, a finer level of detail or another page has shown that the ray begins outside the solid. If
// it begins inside that of this grid, because the two differ, its first point counts as a hit.
fn first_root(grid: Grid, mirrored: MirroredRay, entry: Dda, begins_outside: bool) -> SurfaceHit {
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    var walk = Walk();
    walk.dda = entry;
    walk.sign = select(0, OUTSIDE, begins_outside);
#ifdef VDB_CLIP
    walk.is_first = true;
#endif
    while walk.dda.inside {
        walk = walk_on(grid, mirrored, &accessor, walk);
        if !walk.found {
            break;
        }
        let confirmed = confirm(mirrored, walk.dda);
        walk.dda = walk.next;
        if !confirmed.inside {
            continue;
        }
        let c = walk.corners;
        let rebased = rebased_at(mirrored, confirmed.rel, confirmed.axis, confirmed.t);
        let exit = rebased_exit(rebased, mirrored, confirmed.rel + 1u, walk.dda.axis);
        let t_length = max(min(exit, rebased.end), 0.0);
        let start = unmirrored(mirrored, rebased.frac);
        let end = unmirrored(mirrored, end_in_cell(rebased, mirrored, t_length, exit, walk.dda.axis));
        let path = end - start;
        let b = control_points(c, start, end);
#ifdef VDB_CLIP
        walk.begins_inside = select(walk.begins_inside, b.x < 0.0, walk.is_first);
        walk.is_first = false;
#endif
        var s = 0.0;
        if walk.sign * select(1, -1, b.x < 0.0) >= 0 {
            s = first_sign_change(b);
        }
        if s <= 1.0 {
            s = refined_root(c, start, path, s);
            let root = saturate(start + s * path);
            return SurfaceHit(
                true,
                clamp_to_ray(mirrored, confirmed.t + s * t_length),
                walk.cell,
                root,
                grid.scale * trilinear_gradient(c, root),
                confirmed.axis,
                c,
                accessor,
#ifdef VDB_CLIP
                walk.begins_inside,
#endif
            );
        }
        walk.sign = select(1, -1, b.w < 0.0);
    }
    return no_hit();
}
