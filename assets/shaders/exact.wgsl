// Which of two planes a ray crosses first, exactly. Twin: `crates/vdb_core/src/pack/exact.rs`,
// where it is told why this is enough; here numbers of 64 bits are made of u32.
#define_import_path bevy_vdb::exact

// Relative error of a t computed in f32, times two, because two of them are compared.
const T_ERROR: f32 = 1.9073486328125e-6;    // 2^-19

// A ray turned over on the axes where it runs down, so that it runs up on all of them: cell `c`
// becomes `~c`, and all that is ahead has larger coordinates. Cells are counted from the ray's own.
struct Course {
    flip: vec3<i32>,        // -1 on the axes that are turned over, else 0
    cell: vec3<i32>,        // the ray's own, turned over
    frac: vec3<f32>,        // where in it the ray begins, 0 to 1: a multiple of 2^-24
    speed: vec3<f32>,       // cells per unit of t, 0 or more, nothing denormal
    inverse: vec3<f32>,     // one over that, or over IDLE where it is less
    first: vec3<u32>,       // of the grid's box: its first cells ahead, 0 where the ray is beyond them
    last: vec3<u32>,        // its last cells
    before: vec3<bool>,     // whether the box is ahead of the ray on an axis
    meets: bool,            // whether the ray can meet the box at all
    octant: u32,
    t_min: f32,
    t_max: f32,
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

// The distance from a course's origin to a plane on an axis, in units of 2^-24 cells, low word first;
// at most 56 bits.
fn plane_distance(course: Course, axis: u32, plane: u32) -> vec2<u32> {
    let frac = u32(component_f(course.frac, axis) * 16777216.0);
    let low = plane << 24u;
    return vec2(low - frac, (plane >> 8u) - select(0u, 1u, low < frac));
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

// Whether a course crosses plane a of one axis before plane b of another. Planes crossed at once count
// in the order x, y, z.
//
// Where f32 does not tell, the two are the same to within 2^-18, and so are the integers
// p = distance a · digits of speed b and q = distance b · digits of speed a, once one is shifted by
// the difference of the exponents. The lesser of two nearly equal numbers is the unshifted one, or no
// larger, and that has 80 bits: their difference has at most 63, and its sign is that of the
// difference modulo 2^64.
fn plane_before(course: Course, axis_a: u32, plane_a: u32, axis_b: u32, plane_b: u32) -> bool {
    let speed_a = component_f(course.speed, axis_a);
    let speed_b = component_f(course.speed, axis_b);
    let t_a = (f32(plane_a) - component_f(course.frac, axis_a)) * component_f(course.inverse, axis_a);
    let t_b = (f32(plane_b) - component_f(course.frac, axis_b)) * component_f(course.inverse, axis_b);
    if speed_a == 0.0 || t_a > t_b * (1.0 + T_ERROR) {
        return false;
    }
    if speed_b == 0.0 || t_b > t_a * (1.0 + T_ERROR) {
        return true;
    }
    let bits_a = bitcast<u32>(speed_a);
    let bits_b = bitcast<u32>(speed_b);
    let p = product_low(plane_distance(course, axis_a, plane_a), (bits_b & 0x7fffffu) | 0x800000u);
    let q = product_low(plane_distance(course, axis_b, plane_b), (bits_a & 0x7fffffu) | 0x800000u);
    let exponent_a = bits_a >> 23u;
    let exponent_b = bits_b >> 23u;
    // p · 2^exponent b < q · 2^exponent a
    let least = min(exponent_a, exponent_b);
    let x = shifted_low(p, exponent_b - least);
    let y = shifted_low(q, exponent_a - least);
    if all(x == y) {
        return axis_a < axis_b;
    }
    let high = x.y - y.y - select(0u, 1u, x.x < y.x);
    return (high >> 31u) != 0u;
}
