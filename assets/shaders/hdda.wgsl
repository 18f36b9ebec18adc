// The hierarchical walk through a packed grid. Twin: `crates/vdb_core/src/pack/walk.rs`.
//
// Cells are integers, and the ray parameter is always measured from the ray's own origin, so that
// nothing accumulates. Which plane is crossed first is decided in f32 where that is certain, and
// exactly where it is not: the cells and faces of a walk are those of the ray's very numbers.
#define_import_path bevy_vdb::hdda

#import bevy_vdb::types::{Grid, Ray}
#import bevy_vdb::tree::{Span, empty_cell, locate, nowhere, span_occupied}
#import bevy_vdb::exact::{T_ERROR, Course, component_f, component_u, is_zero, plane_before}

// Where a course is on its way through the lattice.
struct Walk {
    rel: vec3<u32>,     // the cell, counted from the course's own
    t: f32,             // where the course enters it
    axis: u32,          // of the face by which; 3: it started inside
    inside: bool,       // whether the cell is in the grid's box and before the ray's end
}

// t of planes that are never reached.
const FAR: f32 = 1e30;
// Slower than this a ray reaches no other cell within the index space, but on the spot; dividing by
// less could exceed what f32 holds.
const IDLE: f32 = 3.2311742677852644e-27;   // 2^-88
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

// The course of a ray through a grid.
fn course_of(grid: Grid, ray: Ray) -> Course {
    let zero = is_zero(ray.dir);
    let down = (ray.dir < vec3(0.0)) & !zero;
    let flip = select(vec3(0), vec3(-1), down);
    let cell = ray.cell ^ flip;
    let low = select(grid.occupied_min, ~grid.occupied_max, down);
    let high = select(grid.occupied_max, ~grid.occupied_min, down);
    let speed = select(abs(ray.dir), vec3(0.0), zero);
    let before = cell < low;
    let octant = dot(vec3<u32>(down), vec3(4u, 2u, 1u));
    return Course(
        flip,
        cell,
        select(ray.frac, 1.0 - ray.frac, down),
        speed,
        1.0 / max(speed, vec3(IDLE)),
        select(vec3(0u), bitcast<vec3<u32>>(low - cell), before),
        bitcast<vec3<u32>>(high - cell),
        before,
        all(cell <= high) && any(speed >= vec3(SLOWEST)),
        octant,
        ray.t_min,
        ray.t_max,
    );
}

// The local cell that is so many cells ahead.
fn local_cell(course: Course, rel: vec3<u32>) -> vec3<i32> {
    return (course.cell + bitcast<vec3<i32>>(rel)) ^ course.flip;
}

// A place within a cell, 0 to 1, as the lattice has it.
fn unturned(course: Course, u: vec3<f32>) -> vec3<f32> {
    return select(u, 1.0 - u, course.flip != vec3(0));
}

// Where the course crosses planes ahead of it, one on each axis, to within T_ERROR. The integers are
// exact; the ray's own numbers come in only at the end.
fn plane_t(course: Course, plane: vec3<u32>) -> vec3<f32> {
    return (vec3<f32>(plane) - course.frac) * course.inverse;
}

// The first, or the last, of the planes of some axes that a course crosses, one on each axis; 3 for no
// axis at all. One loop with one comparison in it: compilers put functions in place of their calls,
// and this one is long.
fn ordered(course: Course, plane: vec3<u32>, axes: vec3<bool>, want_first: bool) -> u32 {
    var best = 3u;
    for (var axis = 0u; axis < 3u; axis++) {
        let of_interest = select(select(axes.z, axes.y, axis == 1u), axes.x, axis == 0u);
        if of_interest {
            var better = best == 3u;
            if !better {
                let own = component_u(plane, axis);
                let best_plane = component_u(plane, best);
                better = plane_before(course, best, best_plane, axis, own) != want_first;
            }
            best = select(best, axis, better);
        }
    }
    return best;
}

// Cells that a course has come to for certain at about t, on each axis, or the walk before. It may be a
// cell further: then the walk crosses that plane next.
//
// What f32 may get wrong, a sixteenth of T_ERROR, is less than what is taken off: where t is that of a
// plane or earlier, no cell behind that plane is reached.
fn cells_reached(course: Course, t: f32, before: vec3<u32>) -> vec3<u32> {
    // Conversions saturate.
    let at = (course.frac - T_ERROR) + (t * (1.0 - T_ERROR)) * course.speed;
    return max(vec3<u32>(at), before);
}

// The start of the walk: a cell of the grid's box on the course.
fn enter(course: Course) -> Walk {
    if !course.meets {
        return Walk(vec3(0u), 0.0, 3u, false);
    }
    let near = select(vec3(-1.0), plane_t(course, course.first), course.before);
    let t_near = max(max(near.x, near.y), near.z);
    if t_near < course.t_min || !any(course.before) {
        let at = course.frac + course.t_min * course.speed;
        // A place in a plane belongs to the cell above it, which is the one behind where turned over.
        let cell = select(floor(at), ceil(at) - 1.0, course.flip != vec3(0));
        let rel = vec3<u32>(cell);
        let in_box = all(rel >= course.first) && all(rel <= course.last);
        return Walk(rel, course.t_min, 3u, course.t_min <= course.t_max && in_box);
    }
    // Beyond the last, where the ray has left the box on another axis before it comes in on this one.
    let rel = cells_reached(course, t_near, course.first);
    let axis = select(select(2u, 1u, near.y == t_near), 0u, near.x == t_near);
    return Walk(rel, t_near, axis, t_near <= course.t_max && all(rel <= course.last));
}

// The start of the walk where it is known that nothing can stop the ray before `t_start`: there, if
// that is in the box. Its cell is one that is empty, so that its precision does not matter.
fn enter_at(course: Course, t_start: f32) -> Walk {
    let rel = vec3<u32>(course.frac + t_start * course.speed);
    if t_start <= course.t_min || any(rel < course.first) {
        return enter(course);
    }
    let inside = course.meets && t_start <= course.t_max && all(rel <= course.last);
    return Walk(rel, t_start, 0u, inside);
}

// The planes at the end of a span, one on each axis.
fn planes_behind(course: Course, rel: vec3<u32>, span: Span) -> vec3<u32> {
    let size = 1i << span.log_dim;
    let low = (course.cell + bitcast<vec3<i32>>(rel)) & vec3(-size);
    let ahead = low + (size + i32(span.reach << span.log_dim));
    return bitcast<vec3<u32>>(ahead - course.cell);
}

// Steps out of the span that holds the walk's cell.
//
// Which plane is crossed next is exact; how many planes of the other axes have been crossed by then is
// a lower bound. Where it is too low, the walk crosses those planes next, in cells beside the ray that
// it does not touch: all that it does touch are visited. The course never turns back and passes at
// least one plane, so a walk takes at most as many steps as the box has cells along its three edges:
// the loops around this end.
fn advance(course: Course, walk: Walk, span: Span) -> Walk {
    let plane = planes_behind(course, walk.rel, span);
    let exits = plane_t(course, plane);
    let t = min(min(exits.x, exits.y), exits.z);
    let second = max(min(exits.x, exits.y), min(max(exits.x, exits.y), exits.z));
    var across = exits == vec3(t);
    if second <= t * (1.0 + T_ERROR) {
        // At once means x before y before z.
        across = vec3(0u, 1u, 2u) == vec3(ordered(course, plane, vec3(true), true));
    }
    let axis = select(select(2u, 1u, across.y), 0u, across.x);
    let rel = select(cells_reached(course, t, walk.rel), plane, across);
    return Walk(rel, t, axis, t <= course.t_max && all(rel <= course.last));
}

// The cell in which a ray begins: there, it comes in by no face.
fn begin_of(walk: Walk) -> vec3<u32> {
    return select(vec3(0u), walk.rel, walk.axis == 3u);
}

// Whether the ray itself comes into the walk's cell, where and by which face: `begin` is the cell in
// which the ray begins. The answer does not depend on the way by which the walk has come.
fn confirm(course: Course, walk: Walk, begin: vec3<u32>) -> Walk {
    let crossed = walk.rel > begin;
    if !any(crossed) {
        return walk;
    }
    let near = select(vec3(-1.0), plane_t(course, walk.rel), crossed);
    let t = max(max(near.x, near.y), near.z);
    let second = max(min(near.x, near.y), min(max(near.x, near.y), near.z));
    let exits = plane_t(course, walk.rel + 1u);
    var axis = select(select(2u, 1u, near.y == t), 0u, near.x == t);
    var inside = true;
    if second * (1.0 + T_ERROR) >= t || min(min(exits.x, exits.y), exits.z) <= t * (1.0 + T_ERROR) {
        axis = ordered(course, walk.rel, crossed, false);
        let plane = component_u(walk.rel, axis);
        for (var own = 0u; own < 3u && inside; own++) {
            if own != axis {
                inside = !plane_before(course, own, component_u(walk.rel, own) + 1u, axis, plane);
            }
        }
    }
    return Walk(walk.rel, component_f(near, axis), axis, inside);
}

// The first occupied cell on a ray.
struct Hit {
    cell: vec3<i32>,
    t: f32,             // where the ray enters it
    axis: u32,          // of the face by which; 3: it started inside
    found: bool,
}

fn first_hit(grid: Grid, course: Course, enters: Walk) -> Hit {
#ifdef MARCH
    return first_sample(grid, course, enters);
#else
    var walk = enters;
    var place = nowhere(local_cell(course, walk.rel));
    while walk.inside {
        // A loop of its own, so that rays that go side by side confirm their hits together.
        var cell = vec3(0);
        var found = false;
        while walk.inside && !found {
            count_step();
            cell = local_cell(course, walk.rel);
            let span = locate(grid, cell, course.octant, &place);
            found = span_occupied(span);
            if !found {
                walk = advance(course, walk, span);
            }
        }
        if found {
            let hit = confirm(course, walk, begin_of(enters));
            if hit.inside {
                return Hit(cell, hit.t, hit.axis, hit.t <= course.t_max);
            }
            walk = advance(course, walk, empty_cell());
        }
    }
    return Hit(vec3(0), 0.0, 3u, false);
#endif
}

#ifdef MARCH
// Cells between two samples.
const MARCH_STEP: f32 = 0.5;

// The first occupied cell among samples at even distances: what others pass over and find late is what
// the walk is measured by.
fn first_sample(grid: Grid, course: Course, enters: Walk) -> Hit {
    var place = nowhere(local_cell(course, enters.rel));
    let step = MARCH_STEP / length(course.speed);
    for (var i = 0u; enters.inside; i++) {
        count_step();
        let t = enters.t + f32(i) * step;
        let rel = max(vec3<u32>(course.frac + t * course.speed), enters.rel);
        if t > course.t_max || any(rel > course.last) {
            break;
        }
        let cell = local_cell(course, rel);
        if span_occupied(locate(grid, cell, course.octant, &place)) {
            let near = plane_t(course, rel);
            let axis = select(select(2u, 1u, near.y > max(near.x, near.z)), 0u, near.x > max(near.y, near.z));
            return Hit(cell, t, axis, true);
        }
    }
    return Hit(vec3(0), 0.0, 3u, false);
}
#endif
