// Where a ray is within a cell, however far it has come: the twin of `pack/anchor.rs`.
#define_import_path bevy_vdb::anchor

#import bevy_vdb::types::Ray
#import bevy_vdb::exact::{component_f, component_i, plane_distance, product}

// A ray that begins where another one enters a cell. `t` counts from there, so that what is worked
// out close by has the precision of what is close by.
struct Anchor {
    ray: Ray,
    // The t of the other ray.
    t: f32,
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

// The quotient of 96 bits by 24, its low 32 bits. Without a loop: Mesa's llvmpipe ends a shader
// after 65,535 iterations of all its loops together, those that no thread takes counted in.
fn quotient(x: vec3<u32>, divisor: u32) -> u32 {
    let high = divide_word(vec2(0u), x.z, divisor);
    let middle = divide_word(high, x.y, divisor);
    return divide_word(middle, x.x, divisor).y;
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

// Where in a cell the ray is along one axis when it crosses a plane of another, in units of 2^-24:
// f + (distance / dir of the other) · dir, in integers.
fn place(ray: Ray, own: u32, cell: i32, axis: u32, plane: i32) -> f32 {
    let dir = component_f(ray.dir, own);
    let bits_own = bitcast<u32>(dir);
    let bits_axis = bitcast<u32>(component_f(ray.dir, axis));
    let exponent_own = i32((bits_own >> 23u) & 0xffu);
    let exponent_axis = i32((bits_axis >> 23u) & 0xffu);
    var way = 0u;
    if exponent_own > 0 {
        let p = product(plane_distance(ray, axis, plane), (bits_own & 0x7fffffu) | 0x800000u);
        let scaled = shifted(p, exponent_own - exponent_axis);
        way = quotient(scaled, (bits_axis & 0x7fffffu) | 0x800000u);
    }
    let start = u32(component_f(ray.frac, own) * 16777216.0);
    let cells = bitcast<u32>(cell - component_i(ray.cell, own)) << 24u;
    let at = select(start - way, start + way, dir > 0.0) - cells;
    // A rounding of 2^-24 may lead out of the cell.
    return f32(clamp(bitcast<i32>(at), 0, 16777215)) / 16777216.0;
}

// The ray from where it enters a cell on: it came by a plane of `axis`, at about t; 3 means that it
// began inside, at its own t_min.
fn anchored(ray: Ray, cell: vec3<i32>, axis: u32, t: f32) -> Anchor {
    if axis > 2u {
        // A shader's rays begin close to the eye.
        let at = ray.frac + t * ray.dir - vec3<f32>(cell - ray.cell);
        let frac = floor(clamp(at, vec3(0.0), vec3(0.99999994)) * 16777216.0) / 16777216.0;
        return Anchor(Ray(cell, frac, ray.dir, 0.0, ray.t_max - t), t);
    }
    let forward = component_f(ray.dir, axis) > 0.0;
    let plane = component_i(cell, axis) + select(1, 0, forward);
    var frac = vec3(select(0.99999994, 0.0, forward));
    // The other two axes.
    let second = (axis + 1u) % 3u;
    let third = (axis + 2u) % 3u;
    let at_second = place(ray, second, component_i(cell, second), axis, plane);
    let at_third = place(ray, third, component_i(cell, third), axis, plane);
    frac = select(frac, vec3(at_second), vec3(0u, 1u, 2u) == vec3(second));
    frac = select(frac, vec3(at_third), vec3(0u, 1u, 2u) == vec3(third));
    return Anchor(Ray(cell, frac, ray.dir, 0.0, ray.t_max - t), t);
}
