//! Cubics on `[0, 1]`, such as the trilinear interpolant along a ray in one cell.

/// A cubic in the monomial basis, constant coefficient first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cubic([f64; 4]);

impl Cubic {
    /// The cubic through four values, at 0, 1/3, 2/3 and 1.
    pub fn through(f: [f64; 4]) -> Self {
        let d_1 = f[1] - f[0];
        let d_2 = f[2] - 2.0 * f[1] + f[0];
        let d_3 = f[3] - 3.0 * f[2] + 3.0 * f[1] - f[0];
        Self([f[0], 3.0 * d_1 - 1.5 * d_2 + d_3, 4.5 * (d_2 - d_3), 4.5 * d_3])
    }

    pub fn at(&self, s: f64) -> f64 {
        let [a, b, c, d] = self.0;
        a + s * (b + s * (c + s * d))
    }

    fn slope(&self, s: f64) -> f64 {
        let [_, b, c, d] = self.0;
        b + s * (2.0 * c + s * 3.0 * d)
    }

    fn integral_to(&self, s: f64) -> f64 {
        let [a, b, c, d] = self.0;
        s * (a + s * (b / 2.0 + s * (c / 3.0 + s * (d / 4.0))))
    }

    /// The integral from 0 to 1.
    pub fn integral(&self) -> f64 {
        self.integral_to(1.0)
    }

    /// The first change of sign. A cubic changes sign at most once between two extrema.
    pub fn first_change(&self) -> Option<f64> {
        let [a, b, c, d] = self.0;
        let negative = a < 0.0;
        // A cubic lies between its Bernstein coefficients; thirds are left out. In most cells that a
        // ray crosses without a root, all have one sign, which is known sooner than the extrema.
        let bernstein = [3.0 * a + b, 3.0 * a + 2.0 * b + c, a + b + c + d];
        if bernstein.iter().all(|&coefficient| (coefficient < 0.0) == negative) {
            return None;
        }
        let mut low = 0.0;
        for high in self.extrema().into_iter().filter(|s| *s > 0.0 && *s < 1.0).chain([1.0]) {
            if (self.at(high) < 0.0) != negative {
                return Some(bracketed(|s| (self.at(s), self.slope(s)), low, high));
            }
            low = high;
        }
        None
    }

    /// The parameter at which the integral from 0 reaches `amount`, for a cubic that is nowhere
    /// negative and reaches it.
    pub fn integral_reaches(&self, amount: f64) -> f64 {
        if amount <= 0.0 {
            return 0.0;
        }
        bracketed(|s| (self.integral_to(s) - amount, self.at(s)), 0.0, 1.0)
    }

    /// The extrema in ascending order: the roots of `3 d s² + 2 c s + b = 0`, computed without
    /// cancellation. NaN or infinite where there is none.
    fn extrema(&self) -> [f64; 2] {
        let [_, b, c, d] = self.0;
        let q = -(c + (c * c - 3.0 * d * b).sqrt().copysign(c));
        let (r, s) = (q / (3.0 * d), b / q);
        [r.min(s), r.max(s)]
    }
}

/// The root between two points at which a function has different signs. `f` returns its value and
/// slope.
fn bracketed(f: impl Fn(f64) -> (f64, f64), mut low: f64, mut high: f64) -> f64 {
    let negative = f(low).0 < 0.0;
    let mut s = 0.5 * (low + high);
    // Newton's method, with bisection where a step would leave the bracket. Bisection takes no more
    // steps than an f64 has bits.
    for _ in 0..64 {
        let (value, slope) = f(s);
        if (value < 0.0) == negative {
            low = s;
        } else {
            high = s;
        }
        let newton = s - value / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if next == s {
            break;
        }
        s = next;
    }
    s
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(f: impl Fn(f64) -> f64) -> Cubic {
        Cubic::through([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(f))
    }

    #[test]
    fn the_first_change_of_sign_is_found() {
        for (roots, expected) in [
            ([0.2, 0.5, 0.9], Some(0.2)),
            ([-0.2, 0.5, 0.9], Some(0.5)),
            // A double root is no change of sign.
            ([0.4, 0.4, 0.8], Some(0.8)),
            ([0.500, 0.501, 0.502], Some(0.5)),
            ([-1.0, 2.0, 3.0], None),
        ] {
            for sign in [1.0, -1.0] {
                let cubic = sampled(|s| sign * roots.iter().map(|r| s - r).product::<f64>());
                match (cubic.first_change(), expected) {
                    (Some(found), Some(root)) => {
                        assert!((found - root).abs() < 1e-9, "{found} for {roots:?}");
                    }
                    (found, expected) => assert_eq!(found, expected, "{roots:?}"),
                }
            }
        }
        // Lines and parabolas, with leading coefficients of zero.
        let line = sampled(|s| s - 0.3).first_change().unwrap();
        assert!((line - 0.3).abs() < 1e-12, "{line}");
        let parabola = sampled(|s| (s - 0.25) * (s - 0.75)).first_change().unwrap();
        assert!((parabola - 0.25).abs() < 1e-12, "{parabola}");
        assert_eq!(sampled(|_| 0.0).first_change(), None);
    }

    #[test]
    fn the_integral_reaches_what_it_should() {
        // 4 s³, whose integral is s⁴.
        let cubic = sampled(|s| 4.0 * s * s * s);
        assert!((cubic.integral() - 1.0).abs() < 1e-12);
        for s in [0.0_f64, 0.1, 0.5, 0.9, 1.0] {
            let found = cubic.integral_reaches(s.powi(4));
            assert!((found - s).abs() < 1e-9, "{found} for {s}");
        }
    }
}
