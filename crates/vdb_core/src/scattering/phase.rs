//! The phase function in two parts: a forward peak, and a remainder that is linear in the cosine.

use std::f64::consts::PI;

/// The largest magnitude of an anisotropy. Beyond it, the function of Henyey and Greenstein approaches a
/// Dirac delta, which no number of directions resolves.
pub const MAX_ANISOTROPY: f64 = 0.99;

/// The anisotropy below which the peak is evaluated as a difference: its terms cancel.
const NEARLY_ISOTROPIC: f64 = 0.1;

/// The phase function of Henyey and Greenstein (1941) with the mean cosine g, as
/// `f q(c) + (1 - f) p′(c)`: the delta-Eddington split (Joseph, Wiscombe and Weinman 1976), with what
/// remains of the function in place of a Dirac delta.
///
/// `f = g²` and `p′(c) = (1 + 3 g′ c) / 4π` with `g′ = (g - f) / (1 - f)`, so the peak `q` has the Legendre
/// moments 1, 1, 1, g, g², …: scattering in it turns light neither on average nor, up to the second moment,
/// in width. Light is treated as if it went straight on there: the rest of the transport sees an extinction
/// and an albedo that are scaled down.
///
/// For g ≤ 0 there is no peak: `f = 0` and `g′ = g`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    anisotropy: f64,
    peak: f64,
    remainder_anisotropy: f64,
}

impl Phase {
    /// The function with a mean cosine of the scattering angle, clamped to ±[`MAX_ANISOTROPY`].
    pub fn new(anisotropy: f64) -> Self {
        let g = anisotropy.clamp(-MAX_ANISOTROPY, MAX_ANISOTROPY);
        let peak = g.max(0.0) * g;
        Self { anisotropy: g, peak, remainder_anisotropy: (g - peak) / (1.0 - peak) }
    }

    /// `f`, the fraction of scattered light in the peak: 0 to 0.9801.
    pub fn peak(&self) -> f64 {
        self.peak
    }

    /// `g′`, the mean cosine of the remainder: -0.99 to 0.5. Below -1/3, `p′` is negative straight ahead.
    pub fn remainder_anisotropy(&self) -> f64 {
        self.remainder_anisotropy
    }

    /// `v = 1 - ω f`, the factor of the extinction in transport without the peak: above 0, up to 1.
    /// `albedo` is ω, 0 to 1.
    pub fn extinction_scale(&self, albedo: f64) -> f64 {
        1.0 - albedo * self.peak
    }

    /// `ω′ = ω (1 - f) / v`, the albedo in transport without the peak: 0 to 1.
    pub fn scaled_albedo(&self, albedo: f64) -> f64 {
        albedo * (1.0 - self.peak) / self.extinction_scale(albedo)
    }

    /// The phase function, per steradian. `cosine` is that of the angle between the directions of travel
    /// before and after.
    pub fn whole(&self, cosine: f64) -> f64 {
        henyey_greenstein(self.anisotropy, cosine)
    }

    /// `p′`, per steradian. Without a peak, this is the [whole](Self::whole) function, of which the linear
    /// one is an approximation good enough for light that is scattered again.
    pub fn remainder(&self, cosine: f64) -> f64 {
        match self.peak > 0.0 {
            true => (1.0 + 3.0 * self.remainder_anisotropy * cosine) / (4.0 * PI),
            false => self.whole(cosine),
        }
    }

    /// `q₁`, `q₂` and `q₃`, per steradian: the distribution of light after 1, 2 and 3 events in the peak.
    ///
    /// The convolution of `k` peaks has the moments 1, 1, 1, gᵏ, g²ᵏ, …, which are those of
    /// `g⁻²ᵏ HG(gᵏ, c) + (1 - g⁻²ᵏ + 3 c (1 - g⁻ᵏ)) / 4π`. Single values may be negative. They are 0 if there
    /// is no peak.
    pub fn peaks(&self, cosine: f64) -> [f64; 3] {
        let g = self.anisotropy;
        if self.peak < 1e-6 {
            return [0.0; 3];
        }
        if g < NEARLY_ISOTROPIC {
            let once =
                (self.whole(cosine) - (1.0 - self.peak) * self.remainder(cosine)) / self.peak;
            // The moments 1, 1, 1, 0, 0, …
            let many = 1.0 + 3.0 * cosine + 2.5 * (3.0 * cosine * cosine - 1.0);
            return [once, many / (4.0 * PI), many / (4.0 * PI)];
        }
        [1, 2, 3].map(|events| {
            let power = g.powi(events);
            let even = 1.0 - power.powi(-2) + 3.0 * cosine * (1.0 - 1.0 / power);
            power.powi(-2) * henyey_greenstein(power, cosine) + even / (4.0 * PI)
        })
    }
}

/// The function of Henyey and Greenstein, per steradian.
fn henyey_greenstein(g: f64, cosine: f64) -> f64 {
    // Exact where the cosine is near 1, unlike 1 + g² - 2gc.
    let square = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - cosine);
    (1.0 - g * g) / (4.0 * PI * square * square.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Legendre moments of a function of the cosine, by Simpson's rule.
    fn moments(f: impl Fn(f64) -> f64) -> [f64; 6] {
        let steps = 20_000;
        let mut moments = [0.0; 6];
        for i in 0..=steps {
            let c = -1.0 + 2.0 * f64::from(i) / f64::from(steps);
            let weight = match i {
                0 => 1.0,
                i if i == steps => 1.0,
                i if i % 2 == 1 => 4.0,
                _ => 2.0,
            };
            let weight = weight * 2.0 / f64::from(steps) / 3.0;
            let mut legendre = [1.0, c, 0.0, 0.0, 0.0, 0.0];
            for l in 1..5 {
                let n = l as f64;
                legendre[l + 1] =
                    ((2.0 * n + 1.0) * c * legendre[l] - n * legendre[l - 1]) / (n + 1.0);
            }
            for (moment, p) in moments.iter_mut().zip(legendre) {
                *moment += 2.0 * PI * weight * f(c) * p;
            }
        }
        moments
    }

    fn same(what: &str, found: [f64; 6], expected: [f64; 6]) {
        for (l, (found, expected)) in found.into_iter().zip(expected).enumerate() {
            // Simpson's rule with 20,000 steps, at a width of the peak of 0.02 and above.
            assert!((found - expected).abs() < 1e-6, "{what}, moment {l}: {found}, not {expected}");
        }
    }

    #[test]
    fn the_parts_have_their_moments() {
        for g in [0.05, 0.3, 0.6, 0.8] {
            let phase = Phase::new(g);
            let power = |n: i32| g.powi(n);
            let whole: [f64; 6] = std::array::from_fn(|l| power(l as i32));
            same("whole", moments(|c| phase.whole(c)), whole);
            let split = |c: f64| {
                phase.peak() * phase.peaks(c)[0] + (1.0 - phase.peak()) * phase.remainder(c)
            };
            same("split", moments(split), whole);
            for k in 1..=3 {
                // Below 0.1, the higher moments of further events count as 0: they are under 1e-4.
                let rest = |n: i32| if g < 0.1 && k > 1 { 0.0 } else { power(k * n) };
                let expected = [1.0, 1.0, 1.0, rest(1), rest(2), rest(3)];
                let name = format!("peak {k} of {g}");
                same(&name, moments(|c| phase.peaks(c)[k as usize - 1]), expected);
            }
        }
    }

    /// What is absorbed does not depend on the split, nor does the mean cosine.
    #[test]
    fn the_scaled_medium_absorbs_and_turns_as_much() {
        for g in [-0.9, -0.4, 0.0, 0.05, 0.4, 0.8, 0.99, 3.0] {
            let phase = Phase::new(g);
            for albedo in [0.0, 0.5, 0.9, 1.0] {
                let (v, scaled) = (phase.extinction_scale(albedo), phase.scaled_albedo(albedo));
                assert!((v * (1.0 - scaled) - (1.0 - albedo)).abs() < 1e-12, "{g}, {albedo}");
                let turned = v * (1.0 - scaled * phase.remainder_anisotropy());
                let g = g.min(MAX_ANISOTROPY);
                assert!((turned - (1.0 - albedo * g)).abs() < 1e-12, "{g}, {albedo}: {turned}");
            }
        }
    }
}
