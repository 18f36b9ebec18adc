// The hierarchical walk through a packed grid. Twin: `crates/vdb_core/src/pack/walk.rs`.
//
// Cells are integers, and the ray parameter is always measured from the ray's own origin, so that
// nothing accumulates. Which plane is crossed first is decided in f32 where that is certain, and
// exactly where it is not: the cells and faces of a walk are those of the ray's very numbers.
#define_import_path bevy_vdb::hdda

#import bevy_vdb::types::{Grid, Ray}
#import bevy_vdb::tree::{locate, span_occupied}
#import bevy_vdb::exact::{T_ERROR, component_f, component_i, is_zero, plane_before}

// Where a ray is on its way through the lattice.
struct Walk {
    cell: vec3<i32>,
    t: f32,             // where the ray enters the cell
    t_end: f32,         // where the ray ends
    axis: u32,          // of the face that it entered the cell by; 3: it started inside
    inside: bool,       // whether the cell is in the grid's box and before the ray's end
}

// t of planes that are never reached.
const FAR: f32 = 1e30;
// How far from the grid's origin an eye may be, in cells.
const MAX_CELLS: f32 = 1073741824.0;    // 2^30
// Direction components smaller than this, relative to the largest, never reach another cell within
// the index space, but on the spot; dividing by them could exceed what f32 holds.
const IDLE: f32 = 3.469446951953614e-18;    // 2^-58
// The largest component of a direction is not smaller than this.
const SLOWEST: f32 = 9.313225746154785e-10; // 2^-30

#ifdef COUNT_STEPS
// Cells and larger cubes that the ray has looked at.
var<private> steps: u32;
#endif

fn count_step() {
#ifdef COUNT_STEPS
    steps += 1u;
#endif
}

// Where the ray crosses planes ahead of it, one on each axis, to within T_ERROR. The difference of
// the integers is exact; the ray's own numbers come in only at the end.
fn plane_t(ray: Ray, plane: vec3<i32>) -> vec3<f32> {
    let forward = ray.dir > vec3(0.0);
    let speed = abs(ray.dir);
    let cells = bitcast<vec3<u32>>(select(ray.cell - plane, plane - ray.cell, forward));
    let distance = vec3<f32>(cells) + select(ray.frac, -ray.frac, forward);
    let idle = speed < vec3(IDLE * max(max(speed.x, speed.y), speed.z));
    let t = distance / select(speed, vec3(1.0), idle);
    let never = is_zero(ray.dir) | (idle & (distance != vec3(0.0)));
    return select(t, vec3(FAR), never);
}

// The axis of the plane that is crossed first of three, one on each axis. At once means x before y
// before z.
fn first_axis(ray: Ray, plane: vec3<i32>, t: vec3<f32>) -> u32 {
    let first = select(select(2u, 1u, t.y <= t.z), 0u, t.x <= t.y && t.x <= t.z);
    let least = component_f(t, first);
    let in_doubt = t <= vec3(least * (1.0 + T_ERROR));
    if dot(vec3<u32>(in_doubt), vec3(1u)) < 2u {
        return first;
    }
    return ordered(ray, plane, vec3(true), true);
}

// The first, or the last, of the planes of some axes that a ray crosses, one on each axis; 3 for no
// axis at all. One loop with one comparison in it: compilers put functions in place of their calls,
// and this one is long.
fn ordered(ray: Ray, plane: vec3<i32>, axes: vec3<bool>, want_first: bool) -> u32 {
    var best = 3u;
    for (var axis = 0u; axis < 3u; axis++) {
        let of_interest = select(select(axes.z, axes.y, axis == 1u), axes.x, axis == 0u);
        if of_interest {
            var better = best == 3u;
            if !better {
                let own = component_i(plane, axis);
                better = plane_before(ray, best, component_i(plane, best), axis, own) != want_first;
            }
            best = select(best, axis, better);
        }
    }
    return best;
}

// A cell at a position relative to the ray's origin, kept to what an integer holds.
fn cell_of(ray: Ray, at: vec3<f32>) -> vec3<i32> {
    return vec3<i32>(clamp(floor(at), vec3(-MAX_CELLS), vec3(MAX_CELLS))) + ray.cell;
}

// The cells that the ray is in, on each axis, when it has crossed a plane of one of them at about
// t; between `first` and `last`, which the ray passes in that order.
fn cells_behind(
    ray: Ray,
    axis: u32,
    plane: i32,
    t: f32,
    first: vec3<i32>,
    last: vec3<i32>,
) -> vec3<i32> {
    let way = t * ray.dir;
    let at = ray.frac + way;
    let error = (abs(way) + 1.0) * T_ERROR;
    let least = min(first, last);
    let most = max(first, last);
    let low = clamp(cell_of(ray, at - error), least, most);
    let high = clamp(cell_of(ray, at + error), least, most);
    let in_doubt = (low != high) & (vec3(0u, 1u, 2u) != vec3(axis));
    if !any(in_doubt) {
        return low;
    }
    var cell = low;
    for (var own = 0u; own < 3u; own++) {
        let here = vec3(0u, 1u, 2u) == vec3(own);
        // Which of the planes between two cells are crossed before that of the other axis? Those
        // that are come first. Halves the doubt each time: 32 times at most.
        let forward = component_f(ray.dir, own) > 0.0;
        var least_cell = component_i(low, own);
        var most_cell = component_i(high, own);
        while least_cell < most_cell && any(here & in_doubt) {
            let middle = least_cell + (most_cell - least_cell) / 2;
            if plane_before(ray, own, middle + 1, axis, plane) == forward {
                least_cell = middle + 1;
            } else {
                most_cell = middle;
            }
        }
        cell = select(cell, vec3(least_cell), here);
    }
    return cell;
}

fn in_box(grid: Grid, cell: vec3<i32>) -> bool {
    return all(cell >= grid.occupied_min) && all(cell <= grid.occupied_max);
}

// The start of the walk: the first cell of the grid's box on the ray.
fn enter(grid: Grid, ray: Ray) -> Walk {
    let forward = ray.dir > vec3(0.0);
    let below = ray.cell < grid.occupied_min;
    let above = ray.cell > grid.occupied_max;
    // The planes by which the ray comes into the box, on the axes where it is before it.
    let before = select(above, below, forward);
    let beyond = select(below, above, forward);
    let plane = select(grid.occupied_max + 1, grid.occupied_min, forward);
    let near = select(vec3(-1.0), plane_t(ray, plane), before);
    let t_near = max(max(near.x, near.y), near.z);
    let slow = all(abs(ray.dir) < vec3(SLOWEST));
    if slow || any(beyond) || t_near >= FAR {
        return Walk(ray.cell, 0.0, 0.0, 3u, false);
    }
    if t_near < ray.t_min || !any(before) {
        let cell = cell_of(ray, ray.frac + ray.t_min * ray.dir);
        let inside = ray.t_min <= ray.t_max && in_box(grid, cell);
        return Walk(cell, ray.t_min, ray.t_max, 3u, inside);
    }
    // The last of them; at once means x before y before z.
    let axis = ordered(ray, plane, before, false);
    let first = clamp(ray.cell, grid.occupied_min, grid.occupied_max);
    // One cell more: the ray may have left the box on another axis before it comes in on this one.
    let last = select(grid.occupied_min - 1, grid.occupied_max + 1, forward);
    let t = component_f(near, axis);
    let across = vec3(0u, 1u, 2u) == vec3(axis);
    let behind = cells_behind(ray, axis, component_i(plane, axis), t, first, last);
    let cell = select(behind, first, across);
    return Walk(cell, t, ray.t_max, axis, t <= ray.t_max && in_box(grid, cell));
}

// Steps out of the cube of 2^log_dim cells that holds the walk's cell, into the next cell.
//
// The cell changes by at least one along the axis crossed and never turns back along the others,
// so a walk takes at most as many steps as the box has cells along its three edges: the loops
// around this end.
fn advance(grid: Grid, ray: Ray, walk: Walk, log_dim: u32) -> Walk {
    let size = 1i << log_dim;
    let low = walk.cell & vec3(-size);
    let last = low + (size - 1);
    let forward = ray.dir > vec3(0.0);
    let plane = select(low, last + 1, forward);
    let exits = plane_t(ray, plane);
    let axis = first_axis(ray, plane, exits);
    let t = max(component_f(exits, axis), walk.t);
    let across = vec3(0u, 1u, 2u) == vec3(axis);
    let end = select(low, last, forward);
    let behind = cells_behind(ray, axis, component_i(plane, axis), t, walk.cell, end);
    let cell = select(behind, end + select(vec3(-1), vec3(1), forward), across);
    return Walk(cell, t, walk.t_end, axis, t <= walk.t_end && in_box(grid, cell));
}

// The first occupied cell on a ray; `inside` is false where there is none.
fn first_hit(grid: Grid, ray: Ray) -> Walk {
    var walk = enter(grid, ray);
    while walk.inside {
        count_step();
        let span = locate(grid, walk.cell);
        if span_occupied(span) {
            break;
        }
        walk = advance(grid, ray, walk, span.log_dim);
    }
    return walk;
}
