// Cubics: along a ray through a cell, the trilinear interpolant is one.
#define_import_path bevy_vdb::traversal::cubic

// The root finder stops when it estimates the error of the next root at less than this fraction of the path through the
// cell. A step on the interpolant itself follows (`refined_root`), which removes most of what is left.
const ROOT_TOLERANCE: f32 = 0.000003814697265625;   // 2^-18

// A cubic from its coefficients: a.x + s·(a.y + s·(a.z + s·a.w)).
fn cubic_at(a: vec4<f32>, s: f32) -> f32 {
    return a.x + s * (a.y + s * (a.z + s * a.w));
}

// The coefficients of the cubic with these Bézier control points.
fn cubic_of_points(b: vec4<f32>) -> vec4<f32> {
    let d = 3.0 * (b.yzw - b.xyz);
    return vec4(b.x, d.x, d.y - d.x, (b.w - b.x) - d.y);
}

// Where a cubic has its extrema, in ascending order; 2 in place of those that do not exist.
fn cubic_extrema(a: vec4<f32>) -> vec2<f32> {
    // 3·a.w·s² + 2·a.z·s + a.y = 0, without cancellation.
    let b = a.z;
    let root = b * b - 3.0 * a.w * a.y;
    if root <= 0.0 {
        return vec2(2.0);
    }
    let q = -(b + select(-sqrt(root), sqrt(root), b >= 0.0));
    let r_0 = select(2.0, q / (3.0 * a.w), abs(a.w) > 1e-30);
    let r_1 = select(2.0, a.y / q, abs(q) > 1e-30);
    return vec2(min(r_0, r_1), max(r_0, r_1));
}

// The root between two points where a cubic has the values f_low and f_high of opposite signs.
fn bracketed_root(a: vec4<f32>, s_low: f32, s_high: f32, f_low: f32, f_high: f32) -> f32 {
    var low = s_low;
    var high = s_high;
    let negative = f_low < 0.0;
    // Start with linear interpolation, but not at an end, which may itself be a root and would be taken for
    // the one sought. Then take Newton steps, or bisect where a step would leave the bracket.
    var s = low + (high - low) * clamp(f_low / (f_low - f_high), 0.0625, 0.9375);
    for (var i = 0u; i < 16u; i++) {
        let f = cubic_at(a, s);
        if (f < 0.0) == negative {
            low = s;
        } else {
            high = s;
        }
        let slope = a.y + s * (2.0 * a.z + s * 3.0 * a.w);
        let newton = s - f / select(slope, 1.0, slope == 0.0);
        let inside = newton > low && newton < high && slope != 0.0;
        let next = select(0.5 * (low + high), newton, inside);
        let step = next - s;
        // The value that a Newton step leaves: the quadratic and the cubic term around s, which it ignores.
        let rest = step * step * (a.z + a.w * (3.0 * s + step));
        let is_exact = abs(rest) <= ROOT_TOLERANCE * abs(slope);
        let done = select(abs(step) <= ROOT_TOLERANCE, is_exact, inside);
        s = next;
        if done {
            break;
        }
    }
    return s;
}

// The first sign change in [0, 1] of the cubic with these Bézier control points, or 2 if there is none.
fn first_sign_change(b: vec4<f32>) -> f32 {
    // The cubic changes sign at most as often as its control points do.
    let is_negative = b < vec4(0.0);
    let changes = vec3<u32>(is_negative.xyz != is_negative.yzw);
    let count = changes.x + changes.y + changes.z;
    if count == 0u {
        return 2.0;
    }
    let a = cubic_of_points(b);
    if count == 1u {
        return bracketed_root(a, 0.0, 1.0, b.x, b.w);
    }
    return first_sign_change_of_several(a, b.x, b.w);
}

// The same where there may be several sign changes. Between its extrema, a cubic has at most one.
fn first_sign_change_of_several(a: vec4<f32>, f_start: f32, f_end: f32) -> f32 {
    let ends = vec3(cubic_extrema(a), 1.0);
    var low = 0.0;
    var f_low = f_start;
    for (var i = 0u; i < 3u; i++) {
        let high = select(select(ends.z, ends.y, i == 1u), ends.x, i == 0u);
        if high > 0.0 && (high < 1.0 || i == 2u) {
            let f_high = select(cubic_at(a, high), f_end, i == 2u);
            if (f_high < 0.0) != (f_low < 0.0) {
                return bracketed_root(a, low, high, f_low, f_high);
            }
            low = high;
            f_low = f_high;
        }
    }
    return 2.0;
}
