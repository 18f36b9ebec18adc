// Cubics: along a ray through a cell, the trilinear interpolant is one.
#define_import_path bevy_vdb::traversal::cubic

// The root finder stops when its step is below this fraction of the path through the cell: Newton's method
// converges quadratically.
const ROOT_TOLERANCE: f32 = 0.000003814697265625;   // 2^-18

// A cubic from its coefficients: a.x + s·(a.y + s·(a.z + s·a.w)).
fn cubic_at(a: vec4<f32>, s: f32) -> f32 {
    return a.x + s * (a.y + s * (a.z + s * a.w));
}

// The coefficients of the cubic that has four values at s = 0, 1/3, 2/3 and 1.
fn cubic_through(f: vec4<f32>) -> vec4<f32> {
    let d_1 = f.y - f.x;
    let d_2 = f.z - 2.0 * f.y + f.x;
    let d_3 = f.w - 3.0 * f.z + 3.0 * f.y - f.x;
    return vec4(
        f.x,
        3.0 * d_1 - 1.5 * d_2 + d_3,
        4.5 * (d_2 - d_3),
        4.5 * d_3,
    );
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
        let done = abs(next - s) <= ROOT_TOLERANCE;
        s = next;
        if done {
            break;
        }
    }
    return s;
}

// The first sign change of a cubic in [0, 1], or 2 if there is none. f_start and f_end are its values at the
// ends.
fn first_sign_change(a: vec4<f32>, f_start: f32, f_end: f32) -> f32 {
    // Bézier control points: the cubic changes sign at most as often as they do.
    let second_point = f_start + a.y / 3.0;
    let third_point = f_end - (a.y + 2.0 * a.z + 3.0 * a.w) / 3.0;
    let is_negative = vec4(f_start, second_point, third_point, f_end) < vec4(0.0);
    let changes = vec3<u32>(is_negative.xyz != is_negative.yzw);
    let count = changes.x + changes.y + changes.z;
    if count == 0u {
        return 2.0;
    }
    if count == 1u {
        return bracketed_root(a, 0.0, 1.0, f_start, f_end);
    }
    return first_sign_change_of_several(a, f_start, f_end);
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
