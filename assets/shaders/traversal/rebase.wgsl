// Where a ray is within a cell, however far it has come: the twin of `pack/rebased.rs`.
#define_import_path bevy_vdb::traversal::rebase

#import bevy_vdb::traversal::exact::{MirroredRay, beginning, component_f, component_u, minus, plane_distance, reached_at}
#import bevy_vdb::traversal::hdda::FAR

// Where a mirrored ray enters a cell: what is worked out close by has the precision of what is close by.
struct Rebased {
    cell: vec3<u32>,    // counted from the mirrored ray's own
    frac: vec3<f32>,    // where in it, from 0 to 1, on the mirrored ray's axes
    t: f32,             // where on the mirrored ray, to within f32
    end: f32,           // where the mirrored ray ends, from the rebased origin on; FAR where it leaves the box before
}

// Parameters, from the rebased origin on, of planes ahead of it, one on each axis.
fn rebased_t(near: Rebased, mirrored: MirroredRay, plane: vec3<u32>) -> vec3<f32> {
    return (vec3<f32>(plane - near.cell) - near.frac) * mirrored.inverse;
}

// Slower than this, relative to the fastest, a ray creeps along an axis.
const CREEP: f32 = 0.00390625;  // 2^-8

// Where a mirrored ray leaves a cube, from the rebased origin on: by the plane of an axis that the traversal
// crosses next. Where the ray creeps along that axis, the rebased origin's own rounding would move the
// plane's t by far; where it is on its fastest axis then is known to 2^-24 of a cell, however far away that
// is.
fn rebased_exit(near: Rebased, mirrored: MirroredRay, plane: vec3<u32>, axis: u32) -> f32 {
    let exits = rebased_t(near, mirrored, plane);
    if !creeps(mirrored, axis) {
        return component_f(exits, axis);
    }
    let swift = swift_axis(mirrored);
    let place = place_at(mirrored, swift, axis, component_u(plane, axis));
    return min(swift_t(near, mirrored, swift, place), component_f(exits, swift));
}

// The parameter, from the rebased origin on, at which a mirrored ray is at a place of its fastest axis, in
// units of 2^-24 cells from its own cell on.
fn swift_t(near: Rebased, mirrored: MirroredRay, swift: u32, place: vec2<u32>) -> f32 {
    let cell = component_u(near.cell, swift);
    let ahead = minus(place, vec2(cell << 24u, cell >> 8u));
    // A rounding of 2^-24 may lead behind the rebased origin.
    let units = select(f32(ahead.y) * 4294967296.0 + f32(ahead.x), 0.0, (ahead.y >> 31u) != 0u);
    let way = units / 16777216.0 - component_f(near.frac, swift);
    return max(way * component_f(mirrored.inverse, swift), 0.0);
}

// The end of a mirrored ray, from an rebased origin on.
fn end_from(near: Rebased, mirrored: MirroredRay) -> f32 {
    if mirrored.t_max >= FAR {
        return FAR;
    }
    let swift = swift_axis(mirrored);
    return swift_t(near, mirrored, swift, reached_at(mirrored, swift, mirrored.t_max).units);
}

fn fastest(mirrored: MirroredRay) -> f32 {
    return max(max(mirrored.speed.x, mirrored.speed.y), mirrored.speed.z);
}

fn swift_axis(mirrored: MirroredRay) -> u32 {
    return select(2u, select(0u, 1u, mirrored.speed.y > mirrored.speed.x), mirrored.speed.z < fastest(mirrored));
}

fn creeps(mirrored: MirroredRay, axis: u32) -> bool {
    return component_f(mirrored.speed, axis) < CREEP * fastest(mirrored);
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

// One digit of 8 bits of a division by 24: the rest so far, and the quotient's low 32 bits.
fn divide_digit(state: vec2<u32>, word: u32, shift: u32, divisor: u32) -> vec2<u32> {
    let step = (state.x << 8u) | ((word >> shift) & 0xffu);
    return vec2(step % divisor, (state.y << 8u) | (step / divisor));
}

fn divide_word(state: vec2<u32>, word: u32, divisor: u32) -> vec2<u32> {
    let a = divide_digit(state, word, 24u, divisor);
    let b = divide_digit(a, word, 16u, divisor);
    let c = divide_digit(b, word, 8u, divisor);
    return divide_digit(c, word, 0u, divisor);
}

// The quotient of 96 bits by 24, its low 64 bits. Without a loop: Mesa's llvmpipe ends a shader
// after 65,535 iterations of all its loops together, those that no thread takes counted in.
fn quotient(x: vec3<u32>, divisor: u32) -> vec2<u32> {
    let high = divide_word(vec2(0u), x.z, divisor);
    let middle = divide_word(high, x.y, divisor);
    return vec2(divide_word(middle, x.x, divisor).y, middle.y);
}

// x · 2^shift; bits that leave at the low end are lost.
fn shifted(x: vec3<u32>, shift: i32) -> vec3<u32> {
    let n = u32(min(abs(shift), 95));
    let words = n >> 5u;
    let bits = n & 31u;
    if shift >= 0 {
        let y = select(select(x, vec3(0u, x.x, x.y), words == 1u), vec3(0u, 0u, x.x), words == 2u);
        return select((y << vec3(bits)) | (vec3(0u, y.x, y.y) >> vec3(31u - bits) >> vec3(1u)), y, bits == 0u);
    }
    let y = select(select(x, vec3(x.y, x.z, 0u), words == 1u), vec3(x.z, 0u, 0u), words == 2u);
    return select((y >> vec3(bits)) | (vec3(y.y, y.z, 0u) << vec3(31u - bits) << vec3(1u)), y, bits == 0u);
}

// Where a mirrored ray is on one axis when it crosses a plane of another, in units of 2^-24 cells from its
// own cell on, rounded down: frac + (distance / speed of the other) · speed, in integers.
fn place_at(mirrored: MirroredRay, own: u32, axis: u32, plane: u32) -> vec2<u32> {
    let bits_own = bitcast<u32>(component_f(mirrored.speed, own));
    let bits_axis = bitcast<u32>(component_f(mirrored.speed, axis));
    let exponent_own = i32(bits_own >> 23u);
    let exponent_axis = i32(bits_axis >> 23u);
    var way = vec2(0u);
    if exponent_own > 0 {
        let p = product(plane_distance(mirrored, axis, plane), (bits_own & 0x7fffffu) | 0x800000u);
        let scaled = shifted(p, exponent_own - exponent_axis);
        way = quotient(scaled, (bits_axis & 0x7fffffu) | 0x800000u);
    }
    let low = way.x + u32(component_f(mirrored.frac, own) * 16777216.0);
    return vec2(low, way.y + select(0u, 1u, low < way.x));
}

// The same in a cell that it is in then, 0 to 1.
fn place(mirrored: MirroredRay, own: u32, cell: u32, axis: u32, plane: u32) -> f32 {
    // Modulo 2^32, which the cell's own place is well within.
    let at = bitcast<i32>(place_at(mirrored, own, axis, plane).x - (cell << 24u));
    // A rounding of 2^-24 may lead out of the cell.
    return f32(clamp(at, 0, 16777216)) / 16777216.0;
}

// Cells from the ray's own within which f32 is good enough: integers below this have 12 bits.
const NEAR: u32 = 4096u;
// How much faster than along the axis crossed a ray may be along another one.
const STEEPEST: f32 = 64.0;

// The first 12 bits of numbers; products of such halves are exact.
fn upper_half(x: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(x) & vec3(0xfffff000u));
}

// The same in f32, near the ray's own cell, to 2^-23 of a cell times the ratio of speeds: way = distance ·
// ratio of speeds, with what the rounding of the ratio has left, and all large terms exact.
fn place_near(mirrored: MirroredRay, rel: vec3<u32>, axis: u32) -> vec3<f32> {
    let plane = f32(component_u(rel, axis));
    let speed = vec3(component_f(mirrored.speed, axis));
    let inverse = component_f(mirrored.inverse, axis);
    let ratio = mirrored.speed * inverse;
    let high = upper_half(ratio);
    let low = ratio - high;
    let speed_high = upper_half(speed);
    let speed_low = speed - speed_high;
    let left = ((mirrored.speed - high * speed_high) - high * speed_low) - low * speed_high;
    let ratio_rest = (left - low * speed_low) * inverse;
    let small = plane * low + (plane * ratio_rest - component_f(mirrored.frac, axis) * ratio);
    return saturate((plane * high - vec3<f32>(rel)) + (mirrored.frac + small));
}

// Where a traversal enters a cell: by a plane of `axis`, at about t; 3 means that it began inside.
fn rebased_at(mirrored: MirroredRay, rel: vec3<u32>, axis: u32, t: f32) -> Rebased {
    var near = Rebased(rel, place_in(mirrored, rel, axis), t, FAR);
    near.end = end_from(near, mirrored);
    return near;
}

// Where in a cell that is.
fn place_in(mirrored: MirroredRay, rel: vec3<u32>, axis: u32) -> vec3<f32> {
    if axis > 2u {
        return beginning(mirrored).frac;
    }
    let axis_mask = vec3(0u, 1u, 2u) == vec3(axis);
    if all(rel < vec3(NEAR)) && fastest(mirrored) <= STEEPEST * component_f(mirrored.speed, axis) {
        return select(place_near(mirrored, rel, axis), vec3(0.0), axis_mask);
    }
    let plane = component_u(rel, axis);
    var frac = vec3(0.0);
    // The other two axes.
    let second = (axis + 1u) % 3u;
    let third = (axis + 2u) % 3u;
    let at_second = place(mirrored, second, component_u(rel, second), axis, plane);
    let at_third = place(mirrored, third, component_u(rel, third), axis, plane);
    frac = select(frac, vec3(at_second), vec3(0u, 1u, 2u) == vec3(second));
    return select(frac, vec3(at_third), vec3(0u, 1u, 2u) == vec3(third));
}
