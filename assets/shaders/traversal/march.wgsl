// A ray's way through one fog, in stretches that are lit as one.
#define_import_path bevy_vdb::traversal::march

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::tree::{Place, empty_cell, locate, span_constant, span_occupied}
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_at}
#import bevy_vdb::traversal::fog::{REBASE_RANGE, mean_density}
#import bevy_vdb::traversal::hdda::{FAR, Dda, advance, confirm, count_step, enter, local_cell, planes_behind}

// Voxels between places where a fog is asked for something: `step`, and more the longer the longest edge of
// its box is than `edge`, so that what large fogs cost has a bound.
fn step_of(grid: Grid, step: f32, edge: f32) -> f32 {
    let size = vec3<f32>(grid.occupied_max) - vec3<f32>(grid.occupied_min) + 1.0;
    return step * max(1.0, max(max(size.x, size.y), size.z) / edge);
}

struct March {
    dda: Dda,         // the cell that comes next
    near: Rebased,
    t_done: f32,        // how far the cell is done, from the rebased origin on, if it is begun
    is_begun: bool,
    in_run: bool,
    // Stretches end at multiples of the step behind the place where the ray comes into the grid's box: places
    // that do not depend on the tree, so that neighbours in the picture see the light of neighbours.
    t_box: f32,
    t_step: f32,
}

// `step` is in voxels.
fn march_of(mirrored: MirroredRay, enters: Dda, step: f32) -> March {
    return March(
        enters,
        Rebased(vec3(0u), vec3(0.0), 0.0, FAR),
        0.0,
        false,
        false,
        enter(mirrored).t,
        step / length(mirrored.speed),
    );
}

struct Stretch {
    density: f32,       // ∫ density dt; of none that is left, 0
    t_first: f32,       // where its first density is
    t_middle: f32,      // the mean t, by density
}

// The next stretch that has a density. Every step of the loop goes into the next cell or takes a part of
// this one, so that it ends where the traversal does. `most` is for what exceeds f32.
fn next_stretch(
    grid: Grid,
    mirrored: MirroredRay,
    march: ptr<function, March>,
    place: ptr<function, Place>,
    most: f32,
) -> Stretch {
    var stretch = Stretch(0.0, 0.0, 0.0);
    var moment = 0.0;
    var t_out = 0.0;
    while (*march).dda.inside {
        count_step();
        let here = (*march).dda;
        let span = locate(grid, local_cell(mirrored, here.rel), mirrored.octant, place);
        if !span_occupied(span) {
            (*march).dda = advance(mirrored, here, span);
            (*march).in_run = false;
            continue;
        }
        let is_far = any(here.rel - (*march).near.cell > vec3(REBASE_RANGE));
        if !(*march).is_begun && (!(*march).in_run || is_far) {
            let own = confirm(mirrored, here);
            if !own.inside {
                (*march).dda = advance(mirrored, here, empty_cell());
                continue;
            }
            (*march).near = rebased_at(mirrored, own.rel, own.axis, own.t);
            (*march).t_done = 0.0;
        }
        let near = (*march).near;
        let t_done = (*march).t_done;
        let next = advance(mirrored, here, span);
        let plane = planes_behind(mirrored, here.rel, span);
        let t_cell = max(rebased_exit(near, mirrored, plane, next.axis), t_done);
        let t_last = max(min(t_cell, near.end), t_done);
        if stretch.density == 0.0 {
            let steps = floor((near.t + t_done - (*march).t_box) / (*march).t_step) + 1.0;
            t_out = (*march).t_box + steps * (*march).t_step;
        }
        var t_end = min(t_last, t_out - near.t);
        if t_end <= t_done {
            if stretch.density > 0.0 {
                (*march).is_begun = true;
                break;
            }
            // That is rounding.
            t_end = min(t_last, t_done + (*march).t_step);
        }
        let mean = mean_density(grid, mirrored, near, here, span, t_done, t_end);
        let part = min((t_end - t_done) * mean, most);
        if part > 0.0 {
            if stretch.density == 0.0 {
                stretch.t_first = near.t + t_done;
            }
            stretch.density += part;
            moment += part * (near.t + 0.5 * (t_done + t_end) - stretch.t_first);
        }
        (*march).is_begun = t_end < t_last;
        if (*march).is_begun {
            (*march).t_done = t_end;
            if stretch.density > 0.0 {
                break;
            }
        } else {
            (*march).t_done = t_cell;
            (*march).dda = next;
            // Of a boundary tile, cells without density count as void.
            (*march).in_run = mean > 0.0 && !span_constant(span);
        }
    }
    stretch.t_middle = stretch.t_first + moment / max(stretch.density, 1e-30);
    return stretch;
}

// The mean t of what a stretch of so much optical depth sends to the viewer: its front counts for more.
// Exact where the density is even, and where there is little of it.
fn seen_middle(stretch: Stretch, optical_depth: f32) -> f32 {
    // The mean of x from 0 to 1, weighted with e^(-depth·x).
    let x = max(optical_depth, 1e-2);
    let even = 1.0 / x - exp(-x) / (1.0 - exp(-x));
    let weight = select(even, 0.5 - optical_depth / 12.0, optical_depth < 1e-2);
    return stretch.t_first + 2.0 * weight * (stretch.t_middle - stretch.t_first);
}
