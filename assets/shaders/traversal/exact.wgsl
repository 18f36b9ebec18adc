// Which of two planes a ray crosses first, and where it is at a t, exactly. Twin:
// `crates/vdb_core/src/pack/exact.rs`, where it is told why this is enough; here numbers of 64 bits are
// made of u32.
#define_import_path bevy_vdb::traversal::exact

// Relative error of a t computed in f32, times two, because two of them are compared.
const T_ERROR: f32 = 1.9073486328125e-6;    // 2^-19

// A ray turned over on the axes where it runs down, so that it runs up on all of them: cell `c`
// becomes `~c`, and all that is ahead has larger coordinates. Cells are counted from the ray's own.
struct MirroredRay {
    mirror: vec3<i32>,        // -1 on the axes that are turned over, else 0
    cell: vec3<i32>,        // the ray's own, turned over
    frac: vec3<f32>,        // where in it the ray begins, 0 to 1: a multiple of 2^-24
    speed: vec3<f32>,       // cells per unit of t, 0 or more, nothing denormal
    inverse: vec3<f32>,     // one over that, or over IDLE where it is less
    first: vec3<u32>,       // of the grid's box: its first cells ahead, 0 where the ray is beyond them
    last: vec3<u32>,        // its last cells, or those in which the ray ends if it ends before them
    before: vec3<bool>,     // whether the box is ahead of the ray's own cell on an axis
    begin: vec3<u32>,       // the cell in which the ray begins: that at t_min; 0 where that is before the box
    meets: bool,            // whether the ray can meet the box at all
    octant: u32,
    t_min: f32,             // 0 or more, nothing denormal
    t_max: f32,             // FAR where the ray leaves the box before it ends
}

// Whether a component of a direction is zero, or so small that hardware may take it for zero.
fn is_zero(x: vec3<f32>) -> vec3<bool> {
    return (bitcast<vec3<u32>>(x) & vec3(0x7f800000u)) == vec3(0u);
}

fn component_f(v: vec3<f32>, axis: u32) -> f32 {
    return select(select(v.z, v.y, axis == 1u), v.x, axis == 0u);
}

fn component_u(v: vec3<u32>, axis: u32) -> u32 {
    return select(select(v.z, v.y, axis == 1u), v.x, axis == 0u);
}

// The end of the index space from its first cell on. A plane there is given as 0, where no plane ahead is.
const WHOLE: f32 = 4294967296.0;    // 2^32

// The distance from a mirrored ray's origin to a plane on an axis, in units of 2^-24 cells, low word first;
// at most 56 bits.
fn plane_distance(mirrored: MirroredRay, axis: u32, plane: u32) -> vec2<u32> {
    let frac = u32(component_f(mirrored.frac, axis) * 16777216.0);
    return minus(vec2(plane << 24u, select(plane >> 8u, 0x1000000u, plane == 0u)), vec2(frac, 0u));
}

// Where a mirrored ray crosses a plane, to within half of T_ERROR.
fn crossing(mirrored: MirroredRay, axis: u32, plane: u32) -> f32 {
    let cells = select(f32(plane), WHOLE, plane == 0u);
    return (cells - component_f(mirrored.frac, axis)) * component_f(mirrored.inverse, axis);
}

// x · m modulo 2^64, for m of 24 bits: digits of 16 bits, so that no product overflows a u32.
fn product_low(x: vec2<u32>, m: u32) -> vec2<u32> {
    let digits = vec4(x.x & 0xffffu, x.x >> 16u, x.y & 0xffffu, x.y >> 16u);
    let low = digits * (m & 0xffffu);
    let high = digits.xyz * (m >> 16u);
    let middle = (low.x >> 16u) + (low.y & 0xffffu) + (high.x & 0xffffu);
    let carry = (low.y >> 16u) + (high.x >> 16u) + (middle >> 16u);
    return vec2(
        (low.x & 0xffffu) | (middle << 16u),
        low.z + high.y + carry + ((low.w + high.z) << 16u),
    );
}

// x · 2^shift modulo 2^64.
fn shifted_low(x: vec2<u32>, shift: u32) -> vec2<u32> {
    if shift >= 32u {
        return vec2(0u, select(0u, x.x << (shift & 31u), shift < 64u));
    }
    // In two steps: a shift by 32 is none.
    return vec2(x.x << shift, (x.y << shift) | ((x.x >> 1u) >> (31u - shift)));
}

// x · 2^-shift, rounded down, for shifts below 64.
fn shifted_down(x: vec2<u32>, shift: u32) -> vec2<u32> {
    if shift >= 32u {
        return vec2(x.y >> (shift & 31u), 0u);
    }
    // In two steps: a shift by 32 is none.
    return vec2((x.x >> shift) | ((x.y << 1u) << (31u - shift)), x.y >> shift);
}

// The difference of two numbers of 64 bits, modulo 2^64.
fn minus(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2(a.x - b.x, a.y - b.y - select(0u, 1u, a.x < b.x));
}

// Where a mirrored ray is on an axis.
struct Reached {
    units: vec2<u32>,   // from the low end of the mirrored ray's own cell, in units of 2^-24 cells, rounded down
    is_exact: bool,     // whether that has cut nothing off
}

// A place that no cell of the index space has.
const BEYOND: u32 = 0x80000000u;

// Where a mirrored ray is on an axis at a t, which is 0 or more: frac + t·speed, in integers. Both numbers
// have 24 bits and an exponent. A place so far away that no cell of the index space is there is given as one
// such place.
fn reached_at(mirrored: MirroredRay, axis: u32, t: f32) -> Reached {
    let start = u32(component_f(mirrored.frac, axis) * 16777216.0);
    let speed = component_f(mirrored.speed, axis);
    if t == 0.0 || speed == 0.0 {
        return Reached(vec2(start, 0u), true);
    }
    let bits_t = bitcast<u32>(t);
    let bits_speed = bitcast<u32>(speed);
    // Of 48 bits.
    let digits = product_low(vec2((bits_t & 0x7fffffu) | 0x800000u, 0u), (bits_speed & 0x7fffffu) | 0x800000u);
    // 150 each for the exponents of digits that are whole numbers, and 24 for the unit.
    let shift = i32(bits_t >> 23u) + i32(bits_speed >> 23u) - 276;
    if shift > 15 {
        return Reached(vec2(0u, BEYOND), true);
    }
    if shift <= -48 {
        return Reached(vec2(start, 0u), false);
    }
    let size = u32(abs(shift));
    var way = shifted_low(digits, size);
    if shift < 0 {
        way = shifted_down(digits, size);
    }
    let is_exact = shift >= 0 || all(shifted_low(way, size) == digits);
    let low = way.x + start;
    return Reached(vec2(low, way.y + select(0u, 1u, low < start)), is_exact);
}

// Cells on an axis that a mirrored ray has crossed the planes of at a place, and whether the index space has
// as many. At a plane, it has crossed it.
struct Crossed {
    cells: u32,
    is_beyond: bool,
}

fn crossed_at(units: vec2<u32>) -> Crossed {
    return Crossed((units.x >> 24u) | (units.y << 8u), (units.y >> 24u) != 0u);
}

// A place that belongs to the cell before a plane where it is in one: so it is on an axis turned over,
// where voxels are half-open the other way.
fn held_back(reached: Reached, is_mirrored: bool) -> vec2<u32> {
    let in_plane = reached.is_exact && (reached.units.x & 0xffffffu) == 0u;
    // An axis turned over has a way of at least one unit.
    return select(reached.units, minus(reached.units, vec2(1u, 0u)), is_mirrored && in_plane);
}

// The same on all axes: where the mirrored ray begins.
struct Beginning {
    cell: vec3<u32>,
    frac: vec3<f32>,    // in it, 0 to 1
    is_beyond: bool,
}

fn beginning(mirrored: MirroredRay) -> Beginning {
    var begin = Beginning(vec3(0u), mirrored.frac, false);
    if mirrored.t_min == 0.0 {
        return begin;
    }
    for (var axis = 0u; axis < 3u; axis++) {
        let axis_mask = vec3(0u, 1u, 2u) == vec3(axis);
        let reached = reached_at(mirrored, axis, mirrored.t_min);
        let units = held_back(reached, any(axis_mask & (mirrored.mirror != vec3(0))));
        let crossed = crossed_at(units);
        begin.cell = select(begin.cell, vec3(crossed.cells), axis_mask);
        // One unit before a plane is in it.
        let place = (units.x & 0xffffffu) + select(1u, 0u, all(units == reached.units));
        begin.frac = select(begin.frac, vec3(f32(place) / 16777216.0), axis_mask);
        begin.is_beyond = begin.is_beyond || crossed.is_beyond;
    }
    return begin;
}

// The last cells that a mirrored ray comes to before it ends: a plane at its very end is crossed.
fn ending(mirrored: MirroredRay) -> vec3<u32> {
    var last = vec3(0xffffffffu);
    for (var axis = 0u; axis < 3u; axis++) {
        let crossed = crossed_at(reached_at(mirrored, axis, mirrored.t_max).units);
        let axis_mask = vec3(0u, 1u, 2u) == vec3(axis);
        last = select(last, vec3(crossed.cells), axis_mask & vec3(!crossed.is_beyond));
    }
    return last;
}

// Whether a mirrored ray crosses plane a of one axis before plane b of another. Planes crossed at once count
// in the order x, y, z.
//
// Where f32 does not tell, the two are the same to within 2^-18, and so are the integers
// p = distance a · digits of speed b and q = distance b · digits of speed a, once one is shifted by
// the difference of the exponents. The lesser of two nearly equal numbers is the unshifted one, or no
// larger, and that has 80 bits: their difference has at most 63, and its sign is that of the
// difference modulo 2^64.
fn plane_before(mirrored: MirroredRay, axis_a: u32, plane_a: u32, axis_b: u32, plane_b: u32) -> bool {
    let speed_a = component_f(mirrored.speed, axis_a);
    let speed_b = component_f(mirrored.speed, axis_b);
    let t_a = crossing(mirrored, axis_a, plane_a);
    let t_b = crossing(mirrored, axis_b, plane_b);
    if speed_a == 0.0 || t_a > t_b * (1.0 + T_ERROR) {
        return false;
    }
    if speed_b == 0.0 || t_b > t_a * (1.0 + T_ERROR) {
        return true;
    }
    let bits_a = bitcast<u32>(speed_a);
    let bits_b = bitcast<u32>(speed_b);
    let p = product_low(plane_distance(mirrored, axis_a, plane_a), (bits_b & 0x7fffffu) | 0x800000u);
    let q = product_low(plane_distance(mirrored, axis_b, plane_b), (bits_a & 0x7fffffu) | 0x800000u);
    let exponent_a = bits_a >> 23u;
    let exponent_b = bits_b >> 23u;
    // p · 2^exponent b < q · 2^exponent a
    let least = min(exponent_a, exponent_b);
    let x = shifted_low(p, exponent_b - least);
    let y = shifted_low(q, exponent_a - least);
    if all(x == y) {
        return axis_a < axis_b;
    }
    return (minus(x, y).y >> 31u) != 0u;
}
