// Hierarchical traversal of a packed grid. Twin: `crates/vdb_core/src/pack/traverse.rs`.
//
// Cells are integers, and the ray parameter is always measured from the ray's origin, so errors do not
// accumulate. The order of plane crossings is decided in f32 where that is certain, and exactly elsewhere.
// The cells and faces of a traversal are therefore exact for the given ray.
#define_import_path bevy_vdb::traversal::hdda

#import bevy_vdb::gpu::types::{Grid, Ray}
#import bevy_vdb::traversal::tree::{Span, empty_cell, locate, new_accessor, span_occupied}
#import bevy_vdb::traversal::exact::{T_ERROR, WHOLE, MirroredRay, beginning, component_f, component_u, ending}
#import bevy_vdb::traversal::exact::{is_zero, plane_before}

// State of the traversal of a mirrored ray.
struct Dda {
    rel: vec3<u32>,     // the cell, relative to the mirrored ray's own
    t: f32,             // where the mirrored ray enters it
    axis: u32,          // of the entry face; 3 if the ray began inside
    inside: bool,       // whether the cell is in the grid's box and before the ray's end
}

// t of planes that are never reached.
const FAR: f32 = 1e30;
// A slower ray reaches no other cell on this axis within the index space, unless it begins right at a plane.
// Dividing by smaller speeds could overflow f32.
const MIN_SPEED: f32 = 3.2311742677852644e-27;  // 2^-88
// Limits of the largest component of a direction. Slower or faster rays hit nothing.
const SLOWEST: f32 = 9.313225746154785e-10; // 2^-30
const FASTEST: f32 = 1073741824.0;  // 2^30
// Greater than t of any plane of the grid's box, while its product with a speed stays within f32.
const NEVER: f32 = 1.8446744073709552e19;   // 2^64

#ifdef VDB_COUNT_STEPS
// Number of cells and larger cubes that the ray has visited.
var<private> steps: u32;
#endif

fn count_step() {
#ifdef VDB_COUNT_STEPS
    steps += 1u;
#endif
}

// Mirrors a ray so that it points upwards on all axes, and clips it to a grid's box.
fn mirrored_ray(grid: Grid, ray: Ray) -> MirroredRay {
    let zero = is_zero(ray.dir);
    let down = (ray.dir < vec3(0.0)) & !zero;
    let mirror = select(vec3(0), vec3(-1), down);
    let cell = ray.cell ^ mirror;
    let low = select(grid.occupied_min, ~grid.occupied_max, down);
    let high = select(grid.occupied_max, ~grid.occupied_min, down);
    let speed = select(abs(ray.dir), vec3(0.0), zero);
    let fastest = max(max(speed.x, speed.y), speed.z);
    let before = cell < low;
    let octant = dot(vec3<u32>(down), vec3(4u, 2u, 1u));
    var mirrored = MirroredRay(
        mirror,
        cell,
        select(ray.frac, 1.0 - ray.frac, down),
        speed,
        1.0 / max(speed, vec3(MIN_SPEED)),
        select(vec3(0u), bitcast<vec3<u32>>(low - cell), before),
        bitcast<vec3<u32>>(high - cell),
        before,
        vec3(0u),
        all(cell <= high) && fastest >= SLOWEST && fastest <= FASTEST && has_valid_range(ray),
        octant,
        begin_t(ray),
        end_t(ray),
    );
    set_ends(&mirrored);
    return mirrored;
}

// Whether the ends of a ray are valid: no NaNs, a finite start, and in order. Compared as bits, because WGSL
// does not guarantee that comparisons recognise NaNs and infinities.
fn has_valid_range(ray: Ray) -> bool {
    let is_finite = (bitcast<u32>(ray.t_min) & 0x7fffffffu) < INFINITE;
    let is_ahead = bitcast<u32>(ray.t_max) <= INFINITE || is_zero(vec3(ray.t_max)).x;
    return is_finite && is_ahead && begin_t(ray) <= end_t(ray);
}

// The bits of infinity. Those of NaNs and negative numbers are greater.
const INFINITE: u32 = 0x7f800000u;

// The start of a ray, not behind its origin. Numbers that hardware may flush to zero are zero.
fn begin_t(ray: Ray) -> f32 {
    return select(ray.t_min, 0.0, ray.t_min < 0.0 || is_zero(vec3(ray.t_min)).x);
}

fn end_t(ray: Ray) -> f32 {
    let is_endless = bitcast<u32>(ray.t_max) == INFINITE || ray.t_max > FAR;
    return select(select(ray.t_max, 0.0, is_zero(vec3(ray.t_max)).x), FAR, is_endless);
}

// Where a mirrored ray leaves the grid's box.
fn box_exit(mirrored: MirroredRay) -> f32 {
    let exits = ((vec3<f32>(mirrored.last) + 1.0) - mirrored.frac) * mirrored.inverse;
    return min(min(exits.x, exits.y), exits.z);
}

// Makes the ends of a mirrored ray exact where they are in the grid's box, or too close to it for f32 to
// tell. Elsewhere they do not matter, because everything that the mirrored ray visits is between them.
fn set_ends(mirrored: ptr<function, MirroredRay>) {
    if (*mirrored).t_max < FAR {
        if (*mirrored).t_max * (1.0 - T_ERROR) > box_exit(*mirrored) {
            (*mirrored).t_max = FAR;
        } else {
            (*mirrored).last = min((*mirrored).last, ending(*mirrored));
        }
    }
    if (*mirrored).t_min > 0.0 {
        let entries = select(vec3(-1.0), plane_t(*mirrored, (*mirrored).first), (*mirrored).before);
        let touches = max(max(entries.x, entries.y), entries.z) <= (*mirrored).t_min * (1.0 + T_ERROR);
        if touches {
            let begin = beginning(*mirrored);
            (*mirrored).begin = begin.cell;
            (*mirrored).meets = (*mirrored).meets && !begin.is_beyond;
        }
    }
}

// The local cell at `rel` cells from the ray's own.
fn local_cell(mirrored: MirroredRay, rel: vec3<u32>) -> vec3<i32> {
    return (mirrored.cell + bitcast<vec3<i32>>(rel)) ^ mirrored.mirror;
}

// A position within a cell, 0 to 1, converted from mirrored axes to those of the lattice.
fn unmirrored(mirrored: MirroredRay, u: vec3<f32>) -> vec3<f32> {
    return select(u, 1.0 - u, mirrored.mirror != vec3(0));
}

// Where the mirrored ray crosses one plane ahead of it on each axis, to within T_ERROR. The integers are
// exact; rounding only occurs once the ray's own numbers come in.
fn plane_t(mirrored: MirroredRay, plane: vec3<u32>) -> vec3<f32> {
    return (vec3<f32>(plane) - mirrored.frac) * mirrored.inverse;
}

// The axis of the first or last plane that a mirrored ray crosses, among one plane on each of some axes; 3
// if there are no axes. A single loop with one comparison, because compilers inline calls and the comparison
// is long.
fn extreme_axis(mirrored: MirroredRay, plane: vec3<u32>, axes: vec3<bool>, want_first: bool) -> u32 {
    var best = 3u;
    for (var axis = 0u; axis < 3u; axis++) {
        let is_candidate = select(select(axes.z, axes.y, axis == 1u), axes.x, axis == 0u);
        if is_candidate {
            var better = best == 3u;
            if !better {
                let own_plane = component_u(plane, axis);
                let best_plane = component_u(plane, best);
                better = plane_before(mirrored, best, best_plane, axis, own_plane) != want_first;
            }
            best = select(best, axis, better);
        }
    }
    return best;
}

// Cells that a mirrored ray is certain to have reached on each axis at about t, or `before` if that is
// further. The result may be one cell short; the traversal then crosses that plane next.
//
// The rounding error of f32, a sixteenth of T_ERROR, is less than the margin subtracted here: if t is at
// most that of a plane, no cell behind that plane is reached.
fn cells_passed(mirrored: MirroredRay, t: f32, before: vec3<u32>) -> vec3<u32> {
    // Conversions saturate.
    let at = (mirrored.frac - T_ERROR) + (t * (1.0 - T_ERROR)) * mirrored.speed;
    return max(vec3<u32>(at), before);
}

// Starts the traversal at a cell of the grid's box on the mirrored ray.
fn enter(mirrored: MirroredRay) -> Dda {
    // Planes of the box that are crossed after the start of the ray.
    let ahead = mirrored.begin < mirrored.first;
    if !any(ahead) {
        let inside = mirrored.meets && all(mirrored.begin <= mirrored.last);
        return Dda(mirrored.begin, mirrored.t_min, 3u, inside);
    }
    let near = select(vec3(-1.0), plane_t(mirrored, mirrored.first), ahead);
    let t = max(max(near.x, near.y), near.z);
    // Past the last cell if the ray leaves the box on another axis before it enters on this one.
    let rel = cells_passed(mirrored, t, max(mirrored.first, mirrored.begin));
    let axis = select(select(2u, 1u, near.y == t), 0u, near.x == t);
    let inside = mirrored.meets && t < NEVER && all(rel <= mirrored.last);
    return Dda(rel, max(t, mirrored.t_min), axis, inside);
}

// Starts the traversal at `t_start`, before which nothing can stop the ray: at that point if it is in the
// box, or in a cell just before it.
fn enter_at(mirrored: MirroredRay, t_start: f32) -> Dda {
    let rel = cells_passed(mirrored, t_start, mirrored.begin);
    if t_start <= mirrored.t_min || any(rel < mirrored.first) {
        return enter(mirrored);
    }
    let inside = mirrored.meets && t_start <= mirrored.t_max && all(rel <= mirrored.last);
    // The face is confirmed later. Here, it only matters whether the ray begins inside the box.
    let axis = select(0u, 3u, all(mirrored.begin >= mirrored.first));
    return Dda(rel, t_start, axis, inside);
}

// Planes at the far end of a span, one on each axis, modulo 2^32. Planes beyond the index space wrap around
// and seem to be behind the cell.
fn exit_planes(mirrored: MirroredRay, rel: vec3<u32>, span: Span) -> vec3<u32> {
    let offset = bitcast<vec3<u32>>(mirrored.cell) + rel;
    let size = 1u << span.log_dim;
    return rel + (((span.skip + 1u) << span.log_dim) - (offset & vec3(size - 1u)));
}

// Steps out of the span that contains the current cell.
//
// The next plane to be crossed is exact. The number of planes crossed on the other axes is a lower bound. If
// it is too low, the traversal crosses those planes next and visits cells beside the ray that it does not
// touch; no cell that the ray touches is missed. The mirrored ray never turns back, and each step passes at
// least one plane, a face of a span. Loops of steps therefore end after at most as many iterations as the
// spans of the box have faces along its three edges, which is at most the number of cells along them.
fn advance(mirrored: MirroredRay, dda: Dda, span: Span) -> Dda {
    var plane = exit_planes(mirrored, dda.rel, span);
    var exits = plane_t(mirrored, plane);
    var t = min(min(exits.x, exits.y), exits.z);
#ifdef VDB_WIDE_GRIDS
    // Planes beyond the index space seem to be behind the ray, although a ray never goes back. It crosses
    // them at the end of the index space. Only wide grids (`PackedGrid::is_wide`) have spans that end there;
    // this branch would make the loop 5 % slower for others.
    if t < 0.5 * dda.t {
        let beyond = plane <= dda.rel;
        plane = select(plane, vec3(0u), beyond);
        exits = select(exits, (WHOLE - mirrored.frac) * mirrored.inverse, beyond);
        t = min(min(exits.x, exits.y), exits.z);
    }
#endif
    let second = max(min(exits.x, exits.y), min(max(exits.x, exits.y), exits.z));
    var crossed = exits == vec3(t);
    if second <= t * (1.0 + T_ERROR) {
        // Ties are broken in the order x, y, z.
        crossed = vec3(0u, 1u, 2u) == vec3(extreme_axis(mirrored, plane, vec3(true), true));
    }
    let axis = select(select(2u, 1u, crossed.y), 0u, crossed.x);
    let rel = select(cells_passed(mirrored, t, dda.rel), plane, crossed);
#ifdef VDB_WIDE_GRIDS
    return Dda(rel, t, axis, all(rel <= mirrored.last) && all(rel >= dda.rel));
#else
    return Dda(rel, t, axis, all(rel <= mirrored.last));
#endif
}

// Whether the ray itself enters the traversal's cell, where, and through which face (none if it begins
// there). The result does not depend on the steps that led here.
fn confirm(mirrored: MirroredRay, dda: Dda) -> Dda {
    let crossed = dda.rel > mirrored.begin;
    if !any(crossed) {
        return Dda(dda.rel, mirrored.t_min, 3u, true);
    }
    let near = select(vec3(-1.0), plane_t(mirrored, dda.rel), crossed);
    let t = max(max(near.x, near.y), near.z);
    let second = max(min(near.x, near.y), min(max(near.x, near.y), near.z));
    let behind = dda.rel + 1u;
    let exits = select(
        plane_t(mirrored, behind),
        (WHOLE - mirrored.frac) * mirrored.inverse,
        behind == vec3(0u),
    );
    var axis = select(select(2u, 1u, near.y == t), 0u, near.x == t);
    var inside = true;
    if second * (1.0 + T_ERROR) >= t || min(min(exits.x, exits.y), exits.z) <= t * (1.0 + T_ERROR) {
        axis = extreme_axis(mirrored, dda.rel, crossed, false);
        let plane = component_u(dda.rel, axis);
        for (var own = 0u; own < 3u && inside; own++) {
            if own != axis {
                inside = !plane_before(mirrored, own, component_u(behind, own), axis, plane);
            }
        }
    }
    return Dda(dda.rel, component_f(near, axis), axis, inside);
}

// Clamps t to a mirrored ray, against rounding.
fn clamp_to_ray(mirrored: MirroredRay, t: f32) -> f32 {
    return clamp(t, mirrored.t_min, mirrored.t_max);
}

// The first occupied cell on a ray.
struct Hit {
    cell: vec3<i32>,
    t: f32,     // where the ray enters it
    axis: u32,  // of the entry face; 3 if the ray began inside
    found: bool,
}

fn first_hit(grid: Grid, mirrored: MirroredRay, entry: Dda) -> Hit {
#ifdef VDB_MARCH
    return first_sample(grid, mirrored, entry);
#else
    var dda = entry;
    var accessor = new_accessor(local_cell(mirrored, dda.rel));
    while dda.inside {
        // A separate loop, so that neighbouring rays confirm their hits together.
        var cell = vec3(0);
        var found = false;
        while dda.inside && !found {
            count_step();
            cell = local_cell(mirrored, dda.rel);
            let span = locate(grid, cell, mirrored.octant, &accessor);
            found = span_occupied(span);
            if !found {
                dda = advance(mirrored, dda, span);
            }
        }
        if found {
            let hit = confirm(mirrored, dda);
            if hit.inside {
                return Hit(cell, clamp_to_ray(mirrored, hit.t), hit.axis, true);
            }
            dda = advance(mirrored, dda, empty_cell());
        }
    }
    return Hit(vec3(0), 0.0, 3u, false);
#endif
}

#ifdef VDB_MARCH
// Cells between samples.
const MARCH_STEP: f32 = 0.5;

// The first occupied cell among evenly spaced samples. This is the naive method that the traversal is
// compared with: it skips cells and hits late.
fn first_sample(grid: Grid, mirrored: MirroredRay, entry: Dda) -> Hit {
    var accessor = new_accessor(local_cell(mirrored, entry.rel));
    let step = MARCH_STEP / length(mirrored.speed);
    for (var i = 0u; entry.inside; i++) {
        count_step();
        let t = entry.t + f32(i) * step;
        let rel = max(vec3<u32>(mirrored.frac + t * mirrored.speed), entry.rel);
        if t > mirrored.t_max || any(rel > mirrored.last) {
            break;
        }
        let cell = local_cell(mirrored, rel);
        if span_occupied(locate(grid, cell, mirrored.octant, &accessor)) {
            let near = plane_t(mirrored, rel);
            let axis = select(select(2u, 1u, near.y > max(near.x, near.z)), 0u, near.x > max(near.y, near.z));
            return Hit(cell, t, axis, true);
        }
    }
    return Hit(vec3(0), 0.0, 3u, false);
}
#endif
