// Marches a ray through one fog, in intervals that share one lighting sample.
#define_import_path bevy_vdb::traversal::march

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::tree::{Accessor, empty_cell, locate, span_constant, span_occupied}
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_at}
#import bevy_vdb::traversal::fog::{REBASE_RANGE, mean_density}
#ifdef VDB_RAMPS
#import bevy_vdb::traversal::fog::stretch_values
#import bevy_vdb::traversal::ramps::{has_ramp, mean_extinction}
#endif
#import bevy_vdb::traversal::hdda::{FAR, Dda, advance, confirm, count_step, enter, local_cell, exit_planes}

// Step length in voxels: `step`, and proportionally longer if the longest edge of the fog's box exceeds
// `edge`, which bounds the cost of large fogs.
fn scaled_step(grid: Grid, step: f32, edge: f32) -> f32 {
    let size = vec3<f32>(grid.occupied_max) - vec3<f32>(grid.occupied_min) + 1.0;
    return step * max(1.0, max(max(size.x, size.y), size.z) / edge);
}

struct March {
    dda: Dda,       // the next cell
    rebased: Rebased,
    t_done: f32,    // how much of a partly marched cell is done, from the rebased origin
    is_begun: bool,
    in_run: bool,
    // Intervals end at multiples of the step from where the ray enters the grid's box. These points do not
    // depend on the tree, so neighbouring pixels sample the lighting at neighbouring points.
    t_box: f32,
    t_step: f32,
}

// `step` is in voxels.
fn begin_march(mirrored: MirroredRay, entry: Dda, step: f32) -> March {
    return March(
        entry,
        Rebased(vec3(0u), vec3(0.0), 0.0, FAR),
        0.0,
        false,
        false,
        enter(mirrored).t,
        step / length(mirrored.speed),
    );
}

struct Interval {
    density_integral: f32,  // ∫ density dt; 0 if the ray is finished
    t_first: f32,           // where its density begins
    t_mean: f32,            // mean t, weighted by density
#ifdef VDB_RAMPS
    // Of a grid with a ramp, whose intervals are single stretches within a cell, with or without extinction.
    values: vec3<f32>,      // at the start, in the middle and at the end
    width: f32,             // in t; 0 if the ray is finished
#endif
}

// Where an interval that begins at `t` ends: at the next multiple of the step.
fn interval_end(march: ptr<function, March>, t: f32) -> f32 {
    let steps = floor((t - (*march).t_box) / (*march).t_step) + 1.0;
    return (*march).t_box + steps * (*march).t_step;
}

// Rebases the march to a cell. False, and nothing happens, if the ray misses the cell.
fn rebase_to(mirrored: MirroredRay, cell: Dda, march: ptr<function, March>) -> bool {
    let confirmed = confirm(mirrored, cell);
    if confirmed.inside {
        (*march).rebased = rebased_at(mirrored, confirmed.rel, confirmed.axis, confirmed.t);
        (*march).t_done = 0.0;
    }
    return confirmed.inside;
}

// The next interval that contains density. Each iteration either moves to the next cell or takes part of the
// current one, so the loop ends with the traversal. `max_integral` prevents overflow.
fn next_interval(
    grid: Grid,
    mirrored: MirroredRay,
    march: ptr<function, March>,
    accessor: ptr<function, Accessor>,
    max_integral: f32,
) -> Interval {
    var interval = Interval();
    var moment = 0.0;
    var t_out = 0.0;
    while (*march).dda.inside {
        count_step();
        let current = (*march).dda;
        let span = locate(grid, local_cell(mirrored, current.rel), mirrored.octant, accessor);
        if !span_occupied(span) {
            (*march).dda = advance(mirrored, current, span);
            (*march).in_run = false;
            continue;
        }
        let is_far = any(current.rel - (*march).rebased.cell > vec3(REBASE_RANGE));
        if !(*march).is_begun && (!(*march).in_run || is_far) {
            if !rebase_to(mirrored, current, march) {
                (*march).dda = advance(mirrored, current, empty_cell());
                continue;
            }
        }
        let rebased = (*march).rebased;
        let t_done = (*march).t_done;
        let next = advance(mirrored, current, span);
        let plane = exit_planes(mirrored, current.rel, span);
        let t_cell = max(rebased_exit(rebased, mirrored, plane, next.axis), t_done);
        let t_last = max(min(t_cell, rebased.end), t_done);
        if interval.density_integral == 0.0 {
            t_out = interval_end(march, rebased.t + t_done);
        }
        var t_end = min(t_last, t_out - rebased.t);
        if t_end <= t_done {
            if interval.density_integral > 0.0 {
                (*march).is_begun = true;
                break;
            }
            // Due to rounding.
            t_end = min(t_last, t_done + (*march).t_step);
        }
#ifdef VDB_RAMPS
        var mean = 0.0;
        if has_ramp(grid) {
            interval.values = stretch_values(grid, mirrored, rebased, current, span, t_done, t_end);
            interval.width = t_end - t_done;
            interval.t_first = rebased.t + t_done;
            mean = mean_extinction(grid, interval.values);
        } else {
            mean = mean_density(grid, mirrored, rebased, current, span, t_done, t_end);
        }
#else
        let mean = mean_density(grid, mirrored, rebased, current, span, t_done, t_end);
#endif
        let contribution = min((t_end - t_done) * mean, max_integral);
        if contribution > 0.0 {
            if interval.density_integral == 0.0 {
                interval.t_first = rebased.t + t_done;
            }
            interval.density_integral += contribution;
            moment += contribution * (rebased.t + 0.5 * (t_done + t_end) - interval.t_first);
        }
        (*march).is_begun = t_end < t_last;
        if (*march).is_begun {
            (*march).t_done = t_end;
            if interval.density_integral > 0.0 {
                break;
            }
        } else {
            (*march).t_done = t_cell;
            (*march).dda = next;
            // In a boundary tile, cells without density count as empty.
            (*march).in_run = mean > 0.0 && !span_constant(span);
        }
#ifdef VDB_RAMPS
        if has_ramp(grid) && interval.width > 0.0 {
            break;
        }
#endif
    }
    interval.t_mean = interval.t_first + moment / max(interval.density_integral, 1e-30);
    return interval;
}

// Mean t of the light that an interval of an optical depth sends to the viewer; its front contributes more.
// Exact if density is constant, or if the optical depth is small.
fn visible_mean_t(interval: Interval, optical_depth: f32) -> f32 {
    // Mean of x in [0, 1], weighted by e^(-depth·x).
    let x = max(optical_depth, 1e-2);
    let homogeneous = 1.0 / x - exp(-x) / (1.0 - exp(-x));
    let weight = select(homogeneous, 0.5 - optical_depth / 12.0, optical_depth < 1e-2);
    return interval.t_first + 2.0 * weight * (interval.t_mean - interval.t_first);
}
