//! Cubics on `[0, 1]` in Bernstein form: sign changes, extrema and integrals.

/// A cubic on `[0, 1]` by its Bernstein coefficients.
///
/// The coefficients bound the cubic from above and below, and it changes sign no more often than
/// they do (the variation-diminishing property; G. Farin, "Curves and Surfaces for CAGD", section
/// 5.5), which isolates its roots with a proof and without a division.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cubic(pub [f64; 4]);

/// The sign behaviour of a cubic, given the sign before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Signs {
    /// No change; the sign at the end (0 if no sign other than zero has occurred).
    Kept(i8),
    /// The parameter in `[0, 1]` of the first change, and the new sign.
    Changed(f64, i8),
}

/// Bisections per root, which leave a bracket of 2⁻⁵⁰ of the interval.
const HALVINGS: u32 = 50;

impl Cubic {
    /// The cubic on the halves of the interval (de Casteljau).
    fn halves(&self) -> (Self, Self) {
        let mid = |a: f64, b: f64| 0.5 * (a + b);
        let [a, b, c, d] = self.0;
        let (ab, bc, cd) = (mid(a, b), mid(b, c), mid(c, d));
        let (abc, bcd) = (mid(ab, bc), mid(bc, cd));
        let all = mid(abc, bcd);
        (Self([a, ab, abc, all]), Self([all, bcd, cd, d]))
    }

    /// The value at a parameter.
    pub fn at(&self, s: f64) -> f64 {
        let mix = |a: f64, b: f64| a * (1.0 - s) + b * s;
        let [a, b, c, d] = self.0;
        let (ab, bc, cd) = (mix(a, b), mix(b, c), mix(c, d));
        mix(mix(ab, bc), mix(bc, cd))
    }

    /// The mean over the interval, which is the mean of the coefficients.
    pub fn mean(&self) -> f64 {
        self.0.iter().sum::<f64>() / 4.0
    }

    /// The integral from 0 to a parameter: a quartic, whose Bernstein coefficients are the running
    /// sums of those of the cubic over 4.
    pub fn integral_to(&self, s: f64) -> f64 {
        let mut sums = [0.0; 5];
        for (i, b) in self.0.iter().enumerate() {
            sums[i + 1] = sums[i] + b / 4.0;
        }
        for level in (1..5).rev() {
            for i in 0..level {
                sums[i] = sums[i] * (1.0 - s) + sums[i + 1] * s;
            }
        }
        sums[0]
    }

    /// The first change of sign, starting from `sign`: the last one other than zero before the
    /// interval, or 0 if there was none. Coefficients of at most `noise` in magnitude count as
    /// zero.
    ///
    /// With coefficients accurate to 16u M (u = 2⁻⁵³, `M` their bound) and two roundings of u M for
    /// each of the 50 bisections, a `noise` of 128u M = 2⁻⁴⁶ M ensures that every sign used is
    /// correct.
    pub fn first_change(&self, sign: i8, noise: f64) -> Signs {
        self.change(sign, noise, 0.0, 1.0, HALVINGS)
    }

    fn change(&self, sign: i8, noise: f64, low: f64, width: f64, halvings: u32) -> Signs {
        let of = |b: f64| if b > noise { 1 } else { -i8::from(b < -noise) };
        let (mut before, mut last, mut changes) = (sign, sign, 0);
        for now in self.0.map(of).into_iter().filter(|s| *s != 0) {
            if before == 0 {
                before = now;
            }
            changes += u32::from(last != 0 && now != last);
            last = now;
        }
        if changes == 0 {
            return Signs::Kept(last);
        }
        let first = of(self.0[0]);
        if first != 0 && first != before {
            return Signs::Changed(low, first);
        }
        if halvings == 0 {
            // One change in this tiny interval, or two or three so close that f64 cannot separate
            // them.
            return if last == before {
                Signs::Kept(last)
            } else {
                Signs::Changed(low + 0.5 * width, last)
            };
        }
        let (left, right) = self.halves();
        let half = 0.5 * width;
        match left.change(sign, noise, low, half, halvings - 1) {
            Signs::Kept(sign) => right.change(sign, noise, low + half, half, halvings - 1),
            changed => changed,
        }
    }

    /// The parameters in `(0, 1)` where the slope is zero, ascending: none, one or two.
    pub fn extrema(&self) -> impl Iterator<Item = f64> {
        let [a, b, c, d] = self.0;
        let (p, q, r) = (b - a, c - b, d - c);
        // The slope over 3: p (1-s)² + 2 q s (1-s) + r s² = A s² + 2 B s + p.
        let (quad, lin) = (p - 2.0 * q + r, q - p);
        let root = (lin * lin - quad * p).max(0.0).sqrt();
        // The citardauq formula for the root that would cancel (Press et al., "Numerical Recipes",
        // 5.6).
        let sum = -(lin + root.copysign(lin));
        let (s, t) = (sum / quad, p / sum);
        let real = lin * lin >= quad * p;
        let inside = move |s: &f64| real && *s > 0.0 && *s < 1.0;
        [s.min(t), s.max(t)].into_iter().filter(inside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Bernstein coefficients of `k (s - x) (s - y) (s - z)`.
    fn with_roots(k: f64, x: f64, y: f64, z: f64) -> Cubic {
        let polar = |a: f64, b: f64, c: f64| {
            let one = |p: f64, q: f64, r: f64| (a - p) * (b - q) * (c - r);
            let all = one(x, y, z) + one(x, z, y) + one(y, x, z);
            k * (all + one(y, z, x) + one(z, x, y) + one(z, y, x)) / 6.0
        };
        Cubic([polar(0., 0., 0.), polar(0., 0., 1.), polar(0., 1., 1.), polar(1., 1., 1.)])
    }

    fn noise(cubic: Cubic) -> f64 {
        cubic.0.iter().fold(0.0, |m: f64, b| m.max(b.abs())) / (1_u64 << 46) as f64
    }

    fn first(cubic: Cubic, sign: i8) -> Signs {
        cubic.first_change(sign, noise(cubic))
    }

    #[test]
    fn changes_of_sign_are_the_roots_of_odd_multiplicity() {
        // Accurate to the bracket and to the noise over the slope, doubled for the rounding of
        // `along`.
        let changed = |cubic: Cubic, sign, at: f64| match first(cubic, sign) {
            Signs::Changed(s, _) => {
                let slope = (cubic.at(at + 1e-7) - cubic.at(at - 1e-7)) / 2e-7;
                let bound = 2.0 * noise(cubic) / slope.abs() + 1e-15;
                assert!((s - at).abs() < bound, "{s} for {at} within {bound}");
            }
            kept => panic!("{kept:?} for {at}"),
        };
        changed(with_roots(1.0, 0.25, 0.5, 0.75), 0, 0.25);
        changed(with_roots(-1.0, 0.3, 2.0, 3.0), 1, 0.3);
        // Two roots 1e-6 apart are two; a double root is no change of sign.
        changed(with_roots(1.0, 0.5, 0.500001, 3.0), -1, 0.5);
        assert_eq!(first(with_roots(1.0, 0.5, 0.5, 3.0), -1), Signs::Kept(-1));
        assert_eq!(first(with_roots(-1.0, 0.5, 0.5, -3.0), -1), Signs::Kept(-1));
        // A double root, then a simple one.
        changed(with_roots(1.0, 0.25, 0.25, 0.8), -1, 0.8);
        // A triple root is determined only to the cube root of the noise.
        match first(with_roots(1.0, 0.5, 0.5, 0.5), -1) {
            Signs::Changed(s, 1) => assert!((s - 0.5).abs() < 1e-4, "{s}"),
            other => panic!("{other:?}"),
        }
        // The interval begins beyond the sign change at the end of the previous cell.
        assert_eq!(first(Cubic([1.0, 2.0, 2.0, 1.0]), -1), Signs::Changed(0.0, 1));
        assert_eq!(first(Cubic([0.0; 4]), 1), Signs::Kept(1));
    }

    #[test]
    fn the_integral_is_that_of_the_polynomial() {
        // The integral of s³ - s is s⁴/4 - s²/2.
        let cubic = with_roots(1.0, -1.0, 0.0, 1.0);
        for s in [0.0, 0.2, 0.5, 0.9, 1.0_f64] {
            let expected = s.powi(4) / 4.0 - s * s / 2.0;
            assert!((cubic.integral_to(s) - expected).abs() < 1e-15, "{s}");
        }
        assert!((cubic.mean() + 0.25).abs() < 1e-15);
    }

    #[test]
    fn extrema_are_where_the_slope_vanishes() {
        let cubic = with_roots(3.0, 0.1, 0.6, 0.9);
        let found: Vec<f64> = cubic.extrema().collect();
        assert_eq!(found.len(), 2);
        for s in found {
            let slope = (cubic.at(s + 1e-6) - cubic.at(s - 1e-6)) / 2e-6;
            assert!(slope.abs() < 1e-8, "{s}: {slope}");
        }
        assert_eq!(Cubic([0.0, 1.0, 2.0, 3.0]).extrema().count(), 0);
        assert_eq!(Cubic([1.0, 0.0, 0.0, 1.0]).extrema().collect::<Vec<_>>(), [0.5]);
    }
}
