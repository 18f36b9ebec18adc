// Which of two planes a ray crosses first, exactly. Twin: `crates/vdb_core/src/pack/exact.rs`,
// where it is told why this is enough; here numbers of 64 and 96 bits are made of u32.
#define_import_path bevy_vdb::exact

#import bevy_vdb::types::Ray

// Relative error of a t computed in f32, times two, because two of them are compared.
const T_ERROR: f32 = 9.5367431640625e-7;    // 2^-20

// Whether a component of a direction is zero, or so small that hardware may take it for zero.
fn is_zero(x: vec3<f32>) -> vec3<bool> {
    return (bitcast<vec3<u32>>(x) & vec3(0x7f800000u)) == vec3(0u);
}

fn component_f(v: vec3<f32>, axis: u32) -> f32 {
    return select(select(v.z, v.y, axis == 1u), v.x, axis == 0u);
}

fn component_i(v: vec3<i32>, axis: u32) -> i32 {
    return select(select(v.z, v.y, axis == 1u), v.x, axis == 0u);
}

// The distance from a ray's origin to a plane ahead of it on an axis, in units of 2^-24 cells, low
// word first; at most 56 bits.
fn plane_distance(ray: Ray, axis: u32, plane: i32) -> vec2<u32> {
    let frac = u32(component_f(ray.frac, axis) * 16777216.0);
    let cell = component_i(ray.cell, axis);
    // The difference of two i32 fits a u32 once its sign is known.
    if component_f(ray.dir, axis) > 0.0 {
        let cells = bitcast<u32>(plane - cell);
        let low = cells << 24u;
        return vec2(low - frac, (cells >> 8u) - select(0u, 1u, low < frac));
    }
    let cells = bitcast<u32>(cell - plane);
    return vec2((cells << 24u) | frac, cells >> 8u);
}

// x · m, for x of 64 bits and m of 24: digits of 16 bits, so that no product overflows a u32.
fn product(x: vec2<u32>, m: u32) -> vec3<u32> {
    let digits = vec4(x.x & 0xffffu, x.x >> 16u, x.y & 0xffffu, x.y >> 16u);
    let m_low = m & 0xffffu;
    let m_high = m >> 16u;
    let low_0 = digits.x * m_low;
    let low_1 = digits.y * m_low + (low_0 >> 16u);
    let low_2 = digits.z * m_low + (low_1 >> 16u);
    let low_3 = digits.w * m_low + (low_2 >> 16u);
    let high_1 = digits.x * m_high + (low_1 & 0xffffu);
    let high_2 = digits.y * m_high + (low_2 & 0xffffu) + (high_1 >> 16u);
    let high_3 = digits.z * m_high + (low_3 & 0xffffu) + (high_2 >> 16u);
    let high_4 = digits.w * m_high + (low_3 >> 16u) + (high_3 >> 16u);
    return vec3(
        (low_0 & 0xffffu) | (high_1 << 16u),
        (high_2 & 0xffffu) | (high_3 << 16u),
        high_4,
    );
}

// A number of 96 bits without its leading zeros, and how many those were.
struct Normal {
    digits: vec3<u32>,
    zeros: u32,
}

fn normal_of(x: vec3<u32>) -> Normal {
    var digits = x;
    var zeros = 0u;
    if digits.z == 0u {
        digits = vec3(0u, digits.x, digits.y);
        zeros = 32u;
    }
    if digits.z == 0u {
        digits = vec3(0u, digits.x, digits.y);
        zeros = 64u;
    }
    let shift = countLeadingZeros(digits.z);
    if shift > 0u && shift < 32u {
        digits = (digits << vec3(shift)) | (vec3(0u, digits.x, digits.y) >> vec3(32u - shift));
    }
    return Normal(digits, zeros + shift);
}

// Whether a ray crosses plane a of one axis before plane b of another; both are ahead of it or at
// its origin. Planes crossed at once count in the order x, y, z.
fn plane_before(ray: Ray, axis_a: u32, plane_a: i32, axis_b: u32, plane_b: i32) -> bool {
    let bits_a = bitcast<u32>(component_f(ray.dir, axis_a));
    let bits_b = bitcast<u32>(component_f(ray.dir, axis_b));
    let exponent_a = (bits_a >> 23u) & 0xffu;
    let exponent_b = (bits_b >> 23u) & 0xffu;
    if exponent_a == 0u {
        return false;
    }
    if exponent_b == 0u {
        return true;
    }
    let p = product(plane_distance(ray, axis_a, plane_a), (bits_b & 0x7fffffu) | 0x800000u);
    let q = product(plane_distance(ray, axis_b, plane_b), (bits_a & 0x7fffffu) | 0x800000u);
    let p_is_zero = all(p == vec3(0u));
    let q_is_zero = all(q == vec3(0u));
    if p_is_zero || q_is_zero {
        return select(p_is_zero, axis_a < axis_b, p_is_zero == q_is_zero);
    }
    let normal_p = normal_of(p);
    let normal_q = normal_of(q);
    // The exponents decide, or else the digits.
    let top_p = i32(exponent_b) - i32(normal_p.zeros);
    let top_q = i32(exponent_a) - i32(normal_q.zeros);
    if top_p != top_q {
        return top_p < top_q;
    }
    let dp = normal_p.digits;
    let dq = normal_q.digits;
    if dp.z != dq.z {
        return dp.z < dq.z;
    }
    if dp.y != dq.y {
        return dp.y < dq.y;
    }
    return select(dp.x < dq.x, axis_a < axis_b, dp.x == dq.x);
}
