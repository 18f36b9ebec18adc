// The hierarchical walk through a packed grid: cells are integers, and the ray parameter is always
// measured from the ray's own origin, so that nothing accumulates. Twin: `pack/walk.rs`.
#define_import_path bevy_vdb::hdda

#import bevy_vdb::types::{Grid, Ray}
#import bevy_vdb::tree::{locate, span_occupied}

// Where a ray is on its way through the lattice.
struct Walk {
    cell: vec3<i32>,
    t: f32,             // where the ray enters the cell
    t_end: f32,         // where it leaves the grid's box or ends
    axis: u32,          // of the face that it entered the cell by; 3: it started inside
    inside: bool,       // false: the ray passes by, or the walk is over
}

const FAR: f32 = 1e30;
// Direction components below this count as zero: their planes are never reached, and 1/dir times
// any distance between cells stays finite.
const TINY: f32 = 1e-20;

#ifdef COUNT_STEPS
// Cells and larger cubes that the ray has looked at.
var<private> steps: u32;
#endif

fn count_step() {
#ifdef COUNT_STEPS
    steps += 1u;
#endif
}

fn is_parallel(dir: vec3<f32>) -> vec3<bool> {
    return abs(dir) < vec3(TINY);
}

// Where the ray crosses a plane on each axis. The difference of the integers is exact; the ray's
// own numbers come in only at the end.
fn plane_t(ray: Ray, plane: vec3<i32>) -> vec3<f32> {
    let parallel = is_parallel(ray.dir);
    let t = (vec3<f32>(plane - ray.cell) - ray.frac) / select(ray.dir, vec3(1.0), parallel);
    return select(t, vec3(FAR), parallel);
}

// The first axis of those that are set: x before y before z, wherever planes are crossed at once.
fn first_axis(axes: vec3<bool>) -> u32 {
    return select(select(2u, 1u, axes.y), 0u, axes.x);
}

fn min_component(v: vec3<f32>) -> f32 {
    return min(min(v.x, v.y), v.z);
}

fn max_component(v: vec3<f32>) -> f32 {
    return max(max(v.x, v.y), v.z);
}

// The cell of the ray at `t`.
fn cell_at(ray: Ray, t: f32) -> vec3<i32> {
    return vec3<i32>(floor(ray.frac + t * ray.dir)) + ray.cell;
}

// The start of the walk: the first cell of the grid's box on the ray.
fn enter(grid: Grid, ray: Ray) -> Walk {
    let low = grid.occupied_min;
    let high = grid.occupied_max + 1;
    let parallel = is_parallel(ray.dir);
    let forward = ray.dir > vec3(0.0);
    let beside = (ray.cell < low) | (ray.cell >= high);
    let near = select(plane_t(ray, select(high, low, forward)), vec3(-FAR), parallel);
    let far = plane_t(ray, select(low, high, forward));
    let t_near = max_component(near);
    let t = max(t_near, ray.t_min);
    let t_end = min(min_component(far), ray.t_max);
    let axis = select(first_axis(near == vec3(t_near)), 3u, t_near < ray.t_min);
    let inside = !any(parallel & beside) && t <= t_end;
    if !inside {
        return Walk(low, t, t_end, axis, false);
    }
    return Walk(clamp(cell_at(ray, t), low, grid.occupied_max), t, t_end, axis, true);
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
    let exits = plane_t(ray, select(low, last + 1, forward));
    let t_next = min_component(exits);
    let axis = first_axis(exits == vec3(t_next));
    let t = max(t_next, walk.t);
    // Along the other axes: where the ray is, but within the cube and not behind the cell.
    let across = vec3(axis == 0u, axis == 1u, axis == 2u);
    let along = clamp(cell_at(ray, t), select(low, walk.cell, forward), select(walk.cell, last, forward));
    let cell = select(along, select(low - 1, last + 1, forward), across);
    let inside = t <= walk.t_end
        && all(cell >= grid.occupied_min) && all(cell <= grid.occupied_max);
    return Walk(cell, t, walk.t_end, axis, inside);
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
