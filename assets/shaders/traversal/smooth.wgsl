// The first root of the trilinear interpolant: where a ray crosses the iso-surface.
#define_import_path bevy_vdb::traversal::smooth

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::cubic::{cubic_through, first_sign_change}
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

fn no_hit() -> SurfaceHit {
    var none: SurfaceHit;
    return none;
}

// Refines a root s of the cubic along a path through a cell. The cubic's coefficients amplify the rounding of the four
// values; one Newton step on the interpolant itself removes most of that error.
fn refined_root(c: Corners, start: vec3<f32>, path: vec3<f32>, s: f32) -> f32 {
    let first_guess = saturate(start + s * path);
    let slope = dot(trilinear_gradient(c, first_guess), path);
    let correction = trilinear(c, first_guess) / select(slope, 1.0, slope == 0.0);
    return saturate(s - select(0.0, correction, slope != 0.0 && abs(correction) < 0.01));
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
        let f = vec4(
            trilinear(c, start),
            trilinear(c, saturate(start + path / 3.0)),
            trilinear(c, saturate(start + path * (2.0 / 3.0))),
            trilinear(c, saturate(start + path)),
        );
#ifdef VDB_CLIP
        begins_inside = select(begins_inside, f.x < 0.0, is_first);
        is_first = false;
#endif
        var s = 2.0;
        if (has_previous && was_negative != (f.x < 0.0)) || (expects_outside && f.x < 0.0) {
            s = 0.0;
        } else {
            s = first_sign_change(cubic_through(f), f.x, f.w);
        }
        if s <= 1.0 {
            s = refined_root(c, start, path, s);
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
        was_negative = f.w < 0.0;
    }
    return no_hit();
}
