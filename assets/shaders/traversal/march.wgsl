// A ray's way through one fog, in stretches that are lit as one.
#define_import_path bevy_vdb::traversal::march

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::tree::{Accessor, empty_cell, locate, span_constant, span_occupied}
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_at}
#import bevy_vdb::traversal::fog::{REBASE_RANGE, mean_density}
#import bevy_vdb::traversal::hdda::{FAR, Dda, advance, confirm, count_step, enter, local_cell, planes_behind}

// Voxels between places where a fog is asked for something: `step`, and more the longer the longest edge of
// its box is than `edge`, so that what large fogs cost has a bound.
fn scaled_step(grid: Grid, step: f32, edge: f32) -> f32 {
    let size = vec3<f32>(grid.occupied_max) - vec3<f32>(grid.occupied_min) + 1.0;
    return step * max(1.0, max(max(size.x, size.y), size.z) / edge);
}

struct March {
    dda: Dda,         // the cell that comes next
    rebased: Rebased,
    t_done: f32,        // how far the cell is done, from the rebased origin on, if it is begun
    is_begun: bool,
    in_run: bool,
    // Stretches end at multiples of the step behind the place where the ray comes into the grid's box: places
    // that do not depend on the tree, so that neighbours in the picture see the light of neighbours.
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
    density_integral: f32,       // ∫ density dt; of none that is left, 0
    t_first: f32,       // where its first density is
    t_mean: f32,      // the mean t, by density
}

// The next stretch that has a density. Every step of the loop goes into the next cell or takes a part of
// this one, so that it ends where the traversal does. `most` is for what exceeds f32.
fn next_interval(
    grid: Grid,
    mirrored: MirroredRay,
    march: ptr<function, March>,
    accessor: ptr<function, Accessor>,
    max_integral: f32,
) -> Interval {
    var interval = Interval(0.0, 0.0, 0.0);
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
            let confirmed = confirm(mirrored, current);
            if !confirmed.inside {
                (*march).dda = advance(mirrored, current, empty_cell());
                continue;
            }
            (*march).rebased = rebased_at(mirrored, confirmed.rel, confirmed.axis, confirmed.t);
            (*march).t_done = 0.0;
        }
        let rebased = (*march).rebased;
        let t_done = (*march).t_done;
        let next = advance(mirrored, current, span);
        let plane = planes_behind(mirrored, current.rel, span);
        let t_cell = max(rebased_exit(rebased, mirrored, plane, next.axis), t_done);
        let t_last = max(min(t_cell, rebased.end), t_done);
        if interval.density_integral == 0.0 {
            let steps = floor((rebased.t + t_done - (*march).t_box) / (*march).t_step) + 1.0;
            t_out = (*march).t_box + steps * (*march).t_step;
        }
        var t_end = min(t_last, t_out - rebased.t);
        if t_end <= t_done {
            if interval.density_integral > 0.0 {
                (*march).is_begun = true;
                break;
            }
            // That is rounding.
            t_end = min(t_last, t_done + (*march).t_step);
        }
        let mean = mean_density(grid, mirrored, rebased, current, span, t_done, t_end);
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
            // Of a boundary tile, cells without density count as void.
            (*march).in_run = mean > 0.0 && !span_constant(span);
        }
    }
    interval.t_mean = interval.t_first + moment / max(interval.density_integral, 1e-30);
    return interval;
}

// The mean t of what a stretch of so much optical depth sends to the viewer: its front counts for more.
// Exact where the density is even, and where there is little of it.
fn visible_mean_t(interval: Interval, optical_depth: f32) -> f32 {
    // The mean of x from 0 to 1, weighted with e^(-depth·x).
    let x = max(optical_depth, 1e-2);
    let homogeneous = 1.0 / x - exp(-x) / (1.0 - exp(-x));
    let weight = select(homogeneous, 0.5 - optical_depth / 12.0, optical_depth < 1e-2);
    return interval.t_first + 2.0 * weight * (interval.t_mean - interval.t_first);
}
