// Exact order of plane crossings and exact position of a ray at a t. Twin:
// `crates/vdb_core/src/pack/exact.rs`, which explains why this precision is enough. Here, 64-bit numbers are
// pairs of u32.
#define_import_path bevy_vdb::traversal::exact

// Relative error of a t computed in f32, doubled because two of them are compared.
const T_ERROR: f32 = 1.9073486328125e-6;    // 2^-19

// A ray mirrored on the axes where it points downwards (octant mirroring), so that it points upwards on all
// of them. Cell `c` becomes `~c`, and everything ahead has larger coordinates. Cells are counted from the
// ray's own.
struct MirroredRay {
    mirror: vec3<i32>,      // -1 on mirrored axes, else 0
    cell: vec3<i32>,        // the cell of the origin, mirrored
    frac: vec3<f32>,        // origin within that cell, 0 to 1: a multiple of 2^-24
    speed: vec3<f32>,       // cells per unit of t, not negative or subnormal
    inverse: vec3<f32>,     // reciprocal of max(speed, MIN_SPEED)
    first: vec3<u32>,       // first cells of the grid's box ahead; 0 where the ray is past them
    last: vec3<u32>,        // last cells of the box, or those in which the ray ends if it ends earlier
    before: vec3<bool>,     // whether the box is ahead of the origin's cell on each axis
    begin: vec3<u32>,       // the cell at t_min; 0 if that is before the box
    meets: bool,            // whether the ray can hit the box at all
    octant: u32,
    t_min: f32,             // not negative or subnormal
    t_max: f32,             // FAR if the ray leaves the box before it ends
}

// Whether components of a direction are zero, or so small that hardware may flush them to zero.
fn is_zero(x: vec3<f32>) -> vec3<bool> {
    return (bitcast<vec3<u32>>(x) & vec3(0x7f800000u)) == vec3(0u);
}

fn component_f(v: vec3<f32>, axis: u32) -> f32 {
    return select(select(v.z, v.y, axis == 1u), v.x, axis == 0u);
}

fn component_u(v: vec3<u32>, axis: u32) -> u32 {
    return select(select(v.z, v.y, axis == 1u), v.x, axis == 0u);
}

// The size of the index space. A plane at its end is stored as 0, which no plane ahead can be.
const WHOLE: f32 = 4294967296.0;    // 2^32

// Distance from a mirrored ray's origin to a plane on an axis, in units of 2^-24 cells, low word first; at
// most 56 bits.
fn plane_distance(mirrored: MirroredRay, axis: u32, plane: u32) -> vec2<u32> {
    let frac = u32(component_f(mirrored.frac, axis) * 16777216.0);
    return minus(vec2(plane << 24u, select(plane >> 8u, 0x1000000u, plane == 0u)), vec2(frac, 0u));
}

// Where a mirrored ray crosses a plane, to within half of T_ERROR.
fn crossing(mirrored: MirroredRay, axis: u32, plane: u32) -> f32 {
    let cells = select(f32(plane), WHOLE, plane == 0u);
    return (cells - component_f(mirrored.frac, axis)) * component_f(mirrored.inverse, axis);
}

// x · m modulo 2^64, for m of 24 bits, in digits of 16 bits so that no product overflows u32.
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
    // In two steps, because a shift by 32 has no effect.
    return vec2(x.x << shift, (x.y << shift) | ((x.x >> 1u) >> (31u - shift)));
}

// x · 2^-shift, rounded down, for shifts below 64.
fn shifted_down(x: vec2<u32>, shift: u32) -> vec2<u32> {
    if shift >= 32u {
        return vec2(x.y >> (shift & 31u), 0u);
    }
    // In two steps, because a shift by 32 has no effect.
    return vec2((x.x >> shift) | ((x.y << 1u) << (31u - shift)), x.y >> shift);
}

// Difference of two 64-bit numbers modulo 2^64.
fn minus(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2(a.x - b.x, a.y - b.y - select(0u, 1u, a.x < b.x));
}

// Position of a mirrored ray on an axis.
struct Reached {
    units: vec2<u32>,   // from the low end of the origin's cell, units of 2^-24 cells, rounded down
    is_exact: bool,     // whether nothing was rounded off
}

// A position outside the index space.
const BEYOND: u32 = 0x80000000u;

// Exact position of a mirrored ray on an axis at t ≥ 0: frac + t·speed, in integers. Both numbers have 24
// bits and an exponent. All positions beyond the index space become BEYOND.
fn reached_at(mirrored: MirroredRay, axis: u32, t: f32) -> Reached {
    let start = u32(component_f(mirrored.frac, axis) * 16777216.0);
    let speed = component_f(mirrored.speed, axis);
    if t == 0.0 || speed == 0.0 {
        return Reached(vec2(start, 0u), true);
    }
    let bits_t = bitcast<u32>(t);
    let bits_speed = bitcast<u32>(speed);
    // 48 bits.
    let digits = product_low(
        vec2((bits_t & 0x7fffffu) | 0x800000u, 0u),
        (bits_speed & 0x7fffffu) | 0x800000u,
    );
    // Each exponent is biased by 150 relative to integer digits; 24 is for the unit.
    let shift = i32(bits_t >> 23u) + i32(bits_speed >> 23u) - 276;
    if shift > 15 {
        return Reached(vec2(0u, BEYOND), true);
    }
    if shift <= -48 {
        return Reached(vec2(start, 0u), false);
    }
    let size = u32(abs(shift));
    var travelled = shifted_low(digits, size);
    if shift < 0 {
        travelled = shifted_down(digits, size);
    }
    let is_exact = shift >= 0 || all(shifted_low(travelled, size) == digits);
    let low = travelled.x + start;
    return Reached(vec2(low, travelled.y + select(0u, 1u, low < start)), is_exact);
}

// Number of planes on an axis that a mirrored ray has crossed at a position, and whether the index space has
// that many. A plane at the position itself counts as crossed.
struct Crossed {
    cells: u32,
    is_beyond: bool,
}

fn crossed_at(units: vec2<u32>) -> Crossed {
    return Crossed((units.x >> 24u) | (units.y << 8u), (units.y >> 24u) != 0u);
}

// Moves a position that lies exactly on a plane into the cell before it on mirrored axes, where voxels are
// half-open at the other end.
fn before_plane(reached: Reached, is_mirrored: bool) -> vec2<u32> {
    let in_plane = reached.is_exact && (reached.units.x & 0xffffffu) == 0u;
    // On a mirrored axis, the position is at least one unit.
    return select(reached.units, minus(reached.units, vec2(1u, 0u)), is_mirrored && in_plane);
}

// Position on all axes where a mirrored ray begins.
struct Beginning {
    cell: vec3<u32>,
    frac: vec3<f32>,    // within the cell, 0 to 1
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
        let units = before_plane(reached, any(axis_mask & (mirrored.mirror != vec3(0))));
        let crossed = crossed_at(units);
        begin.cell = select(begin.cell, vec3(crossed.cells), axis_mask);
        // A position moved one unit back is on the plane.
        let place = (units.x & 0xffffffu) + select(1u, 0u, all(units == reached.units));
        begin.frac = select(begin.frac, vec3(f32(place) / 16777216.0), axis_mask);
        begin.is_beyond = begin.is_beyond || crossed.is_beyond;
    }
    return begin;
}

// The last cells that a mirrored ray reaches. A plane exactly at its end is crossed.
fn ending(mirrored: MirroredRay) -> vec3<u32> {
    var last = vec3(0xffffffffu);
    for (var axis = 0u; axis < 3u; axis++) {
        let crossed = crossed_at(reached_at(mirrored, axis, mirrored.t_max).units);
        let axis_mask = vec3(0u, 1u, 2u) == vec3(axis);
        last = select(last, vec3(crossed.cells), axis_mask & vec3(!crossed.is_beyond));
    }
    return last;
}

// Whether a mirrored ray crosses plane a of one axis before plane b of another. Ties are broken in the order
// x, y, z.
//
// Where f32 cannot tell, the two t agree to within 2^-18, and so do the integers p = distance a · digits of
// speed b and q = distance b · digits of speed a, once one of them is shifted by the difference of the
// exponents. The smaller of two nearly equal numbers is at most the unshifted one, which has 80 bits. Their
// difference therefore has at most 63 bits, and its sign is that of the difference modulo 2^64.
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
