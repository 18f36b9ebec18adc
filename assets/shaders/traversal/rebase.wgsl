// Precise positions of a ray within cells, at any distance from its origin. Twin:
// `crates/vdb_core/src/pack/rebase.rs`.
#define_import_path bevy_vdb::traversal::rebase

#import bevy_vdb::traversal::exact::{MirroredRay, beginning, component_f, component_u, minus, plane_distance}
#import bevy_vdb::traversal::exact::reached_at
#import bevy_vdb::traversal::hdda::FAR

// A rebased origin: the point where a mirrored ray enters a cell. Parameters counted from a nearby origin
// keep their precision.
struct Rebased {
    cell: vec3<u32>,    // relative to the mirrored ray's own
    frac: vec3<f32>,    // within the cell, 0 to 1, on the mirrored ray's axes
    t: f32,             // on the mirrored ray, to within f32 rounding
    end: f32,           // end of the ray, from the rebased origin; FAR if it leaves the box first
}

// Parameters, from the rebased origin, of one plane ahead on each axis.
fn rebased_t(rebased: Rebased, mirrored: MirroredRay, plane: vec3<u32>) -> vec3<f32> {
    return (vec3<f32>(plane - rebased.cell) - rebased.frac) * mirrored.inverse;
}

// Below this fraction of its speed on the fastest axis, a ray counts as slow on an axis.
const SLOW_RATIO: f32 = 0.00390625;  // 2^-8

// Where a mirrored ray leaves a cube through the next plane of an axis, as a parameter from the rebased
// origin. On a slow axis, the rounding of the rebased origin would change the plane's t by a lot. The
// position on the fastest axis at that plane is known to 2^-24 of a cell at any distance, so use that
// instead.
fn rebased_exit(rebased: Rebased, mirrored: MirroredRay, plane: vec3<u32>, axis: u32) -> f32 {
    let exits = rebased_t(rebased, mirrored, plane);
    if !is_slow(mirrored, axis) {
        return component_f(exits, axis);
    }
    let major = major_axis(mirrored);
    let place = place_at(mirrored, major, axis, component_u(plane, axis));
    return min(major_axis_t(rebased, mirrored, major, place), component_f(exits, major));
}

// Parameter, from the rebased origin, at which a mirrored ray is at a position on its fastest axis. The
// position is in units of 2^-24 cells from the ray's own cell.
fn major_axis_t(rebased: Rebased, mirrored: MirroredRay, major: u32, place: vec2<u32>) -> f32 {
    let cell = component_u(rebased.cell, major);
    let ahead = minus(place, vec2(cell << 24u, cell >> 8u));
    // Rounding by 2^-24 may lead to a position behind the rebased origin.
    let units = select(f32(ahead.y) * 4294967296.0 + f32(ahead.x), 0.0, (ahead.y >> 31u) != 0u);
    let cells_ahead = units / 16777216.0 - component_f(rebased.frac, major);
    return max(cells_ahead * component_f(mirrored.inverse, major), 0.0);
}

// End of a mirrored ray, as a parameter from the rebased origin.
fn end_from(rebased: Rebased, mirrored: MirroredRay) -> f32 {
    if mirrored.t_max >= FAR {
        return FAR;
    }
    let major = major_axis(mirrored);
    return major_axis_t(rebased, mirrored, major, reached_at(mirrored, major, mirrored.t_max).units);
}

fn max_speed(mirrored: MirroredRay) -> f32 {
    return max(max(mirrored.speed.x, mirrored.speed.y), mirrored.speed.z);
}

fn major_axis(mirrored: MirroredRay) -> u32 {
    return select(
        2u,
        select(0u, 1u, mirrored.speed.y > mirrored.speed.x),
        mirrored.speed.z < max_speed(mirrored),
    );
}

fn is_slow(mirrored: MirroredRay, axis: u32) -> bool {
    return component_f(mirrored.speed, axis) < SLOW_RATIO * max_speed(mirrored);
}

// x · m, for x of 64 bits and m of 24, in digits of 16 bits so that no product overflows u32.
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

// One 8-bit digit of a division by a 24-bit number: the remainder so far, and the low 32 bits of the
// quotient.
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

// The low 64 bits of a quotient of 96 bits by 24 bits. Unrolled, because Mesa's llvmpipe ends a shader after
// 65,535 iterations of all its loops together, including those that no thread executes.
fn quotient(x: vec3<u32>, divisor: u32) -> vec2<u32> {
    let high = divide_word(vec2(0u), x.z, divisor);
    let middle = divide_word(high, x.y, divisor);
    return vec2(divide_word(middle, x.x, divisor).y, middle.y);
}

// x · 2^shift; bits shifted out at the low end are lost.
fn shifted(x: vec3<u32>, shift: i32) -> vec3<u32> {
    let n = u32(min(abs(shift), 95));
    let words = n >> 5u;
    let bits = n & 31u;
    if shift >= 0 {
        let y = select(select(x, vec3(0u, x.x, x.y), words == 1u), vec3(0u, 0u, x.x), words == 2u);
        return select(
            (y << vec3(bits)) | (vec3(0u, y.x, y.y) >> vec3(31u - bits) >> vec3(1u)),
            y,
            bits == 0u,
        );
    }
    let y = select(select(x, vec3(x.y, x.z, 0u), words == 1u), vec3(x.z, 0u, 0u), words == 2u);
    return select((y >> vec3(bits)) | (vec3(y.y, y.z, 0u) << vec3(31u - bits) << vec3(1u)), y, bits == 0u);
}

// Position of a mirrored ray on one axis where it crosses a plane of another, in units of 2^-24 cells from
// its own cell, rounded down: frac + (distance / speed on the other axis) · speed, in integers.
fn place_at(mirrored: MirroredRay, own: u32, axis: u32, plane: u32) -> vec2<u32> {
    let bits_own = bitcast<u32>(component_f(mirrored.speed, own));
    let bits_axis = bitcast<u32>(component_f(mirrored.speed, axis));
    let exponent_own = i32(bits_own >> 23u);
    let exponent_axis = i32(bits_axis >> 23u);
    var travelled = vec2(0u);
    if exponent_own > 0 {
        let p = product(plane_distance(mirrored, axis, plane), (bits_own & 0x7fffffu) | 0x800000u);
        let scaled = shifted(p, exponent_own - exponent_axis);
        travelled = quotient(scaled, (bits_axis & 0x7fffffu) | 0x800000u);
    }
    let low = travelled.x + u32(component_f(mirrored.frac, own) * 16777216.0);
    return vec2(low, travelled.y + select(0u, 1u, low < travelled.x));
}

// The same position within a cell that contains it, 0 to 1.
fn place(mirrored: MirroredRay, own: u32, cell: u32, axis: u32, plane: u32) -> f32 {
    // Modulo 2^32, which is much larger than positions within the cell.
    let at = bitcast<i32>(place_at(mirrored, own, axis, plane).x - (cell << 24u));
    // Rounding by 2^-24 may lead out of the cell.
    return f32(clamp(at, 0, 16777216)) / 16777216.0;
}

// Distance in cells from the ray's own cell within which f32 suffices: integers below this have 12 bits.
const NEAR: u32 = 4096u;
// Largest ratio of the speed on another axis to that on the crossed axis for which f32 suffices.
const STEEPEST: f32 = 64.0;

// The upper 12 bits of each mantissa; products of such halves are exact.
fn upper_half(x: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(x) & vec3(0xfffff000u));
}

// The same position in f32, near the ray's own cell, to 2^-23 of a cell times the ratio of speeds: distance
// · ratio of speeds, corrected by the rounding error of the ratio, with all large terms exact.
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

// Rebases a mirrored ray to the point where it enters a cell through a plane of `axis`, at about t. An axis
// of 3 means that the ray began inside.
fn rebased_at(mirrored: MirroredRay, rel: vec3<u32>, axis: u32, t: f32) -> Rebased {
    var rebased = Rebased(rel, place_in(mirrored, rel, axis), t, FAR);
    rebased.end = end_from(rebased, mirrored);
    return rebased;
}

// Position within the cell at that point.
fn place_in(mirrored: MirroredRay, rel: vec3<u32>, axis: u32) -> vec3<f32> {
    if axis > 2u {
        return beginning(mirrored).frac;
    }
    let axis_mask = vec3(0u, 1u, 2u) == vec3(axis);
    if all(rel < vec3(NEAR)) && max_speed(mirrored) <= STEEPEST * component_f(mirrored.speed, axis) {
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
