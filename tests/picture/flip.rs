//! How different two pictures look: FLIP, by Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and
//! Fairchild 2020, "FLIP: A Difference Evaluator for Alternating Images", Proceedings of the ACM on
//! Computer Graphics and Interactive Techniques 3(2), for pictures of low dynamic range.
//!
//! Pixels are filtered as an eye does at a distance, compared as colours, and where edges and points are
//! in one picture and not in the other, the difference counts for more.

use std::f64::consts::PI;

use glam::{DMat3, DVec3, Vec3, Vec4};

use super::common::Picture;

/// Of a screen that fills the view as theirs does: 0.7 m away, 0.7 m wide, with 3,840 pixels.
const PIXELS_PER_DEGREE: f64 = 67.0;

/// Rows of numbers.
struct Plane<T> {
    width: usize,
    values: Vec<T>,
}

impl<T: Copy + std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>> Plane<T> {
    /// Sums the neighbours of each value, weighted along rows, then along columns; at the borders, the last
    /// value goes on.
    fn filtered(&self, weights: [&[f64]; 2]) -> Self {
        let (width, height) = (self.width as i64, (self.values.len() / self.width) as i64);
        let along = |values: &[T], weights: &[f64], [dx, dy]: [i64; 2]| -> Vec<T> {
            let radius = weights.len() as i64 / 2;
            let at = |x: i64, y: i64| {
                let term = |k: i64| {
                    let [x, y] =
                        [(x + k * dx).clamp(0, width - 1), (y + k * dy).clamp(0, height - 1)];
                    values[(y * width + x) as usize] * weights[(k + radius) as usize]
                };
                (1 - radius..=radius).fold(term(-radius), |sum, k| sum + term(k))
            };
            (0..height)
                .flat_map(|y| (0..width).map(move |x| (x, y)))
                .map(|(x, y)| at(x, y))
                .collect()
        };
        let rows = along(&self.values, weights[0], [1, 0]);
        Self { width: self.width, values: along(&rows, weights[1], [0, 1]) }
    }
}

/// Weights around a place, `radius` on either side.
fn weights(radius: f64, of: impl Fn(f64) -> f64) -> Vec<f64> {
    let radius = radius.ceil() as i32;
    (-radius..=radius).map(|x| of(f64::from(x))).collect()
}

/// CIE XYZ from linear sRGB.
fn xyz_from_linear() -> DMat3 {
    DMat3::from_cols(
        DVec3::new(
            10_135_552.0 / 24_577_794.0,
            2_613_072.0 / 12_288_897.0,
            1_425_312.0 / 73_733_382.0,
        ),
        DVec3::splat(8_788_810.0) / DVec3::new(24_577_794.0, 12_288_897.0, 73_733_382.0),
        DVec3::new(
            4_435_075.0 / 24_577_794.0,
            887_015.0 / 12_288_897.0,
            70_074_185.0 / 73_733_382.0,
        ),
    )
}

fn xyz(linear: DVec3) -> DVec3 {
    xyz_from_linear() * linear
}

/// Linear in the light: its luminance, red from green, yellow from blue.
fn opponent(color: DVec3) -> DVec3 {
    let [x, y, z] = (xyz(color) / xyz(DVec3::ONE)).to_array();
    DVec3::new(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))
}

/// The inverse of [`opponent`], as far as screens have such a colour.
fn from_opponent([l, a, b]: [f64; 3]) -> DVec3 {
    let y = (l + 16.0) / 116.0;
    let white = xyz(DVec3::ONE);
    let color = DVec3::new(y + a / 500.0, y, y - b / 200.0) * white;
    (xyz_from_linear().inverse() * color).clamp(DVec3::ZERO, DVec3::ONE)
}

/// CIELAB, with less colour where it is dark (Hunt).
fn lab(color: DVec3) -> DVec3 {
    let f = |t: f64| {
        let delta = 6.0_f64 / 29.0;
        if t > delta.powi(3) { t.cbrt() } else { t / (3.0 * delta * delta) + 4.0 / 29.0 }
    };
    let [x, y, z] = (xyz(color) / xyz(DVec3::ONE)).to_array().map(f);
    let l = 116.0 * y - 16.0;
    DVec3::new(l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z))
}

/// How far two colours are from each other, for differences that are large (`HyAB`).
fn apart(a: DVec3, b: DVec3) -> f64 {
    let d = a - b;
    (d.x.abs() + d.y.hypot(d.z)).powf(0.7)
}

/// A plane of one component, filtered by the eye's contrast sensitivity: a sum of Gaussians.
fn seen(plane: &Plane<f64>, gaussians: &[[f64; 2]]) -> Vec<f64> {
    // The widest of all components, for all of them.
    let radius = 3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE;
    // A Gaussian of two dimensions is one along each.
    let one = |b: f64| weights(radius, |x| (-(PI * x / PIXELS_PER_DEGREE).powi(2) / b).exp());
    let (mut sum, mut all) = (vec![0.0; plane.values.len()], 0.0);
    for [a, b] in gaussians {
        let w = one(*b);
        let scale = a * (PI / b).sqrt();
        all += scale * w.iter().sum::<f64>().powi(2);
        let part = plane.filtered([&w, &w]).values;
        sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += scale * part);
    }
    sum.into_iter().map(|sum| sum / all).collect()
}

/// Edges and points of a plane of luminance from 0 to 1: the size of the first and second differences.
fn features(plane: &Plane<f64>) -> [Vec<f64>; 2] {
    let deviation = 0.5 * 0.082 * PIXELS_PER_DEGREE;
    let bell = |x: f64| (-x * x / (2.0 * deviation * deviation)).exp();
    let all = |of: &dyn Fn(f64) -> f64| weights(3.0 * deviation, of);
    let smooth = all(&bell);
    let whole: f64 = smooth.iter().sum();
    let smooth: Vec<f64> = smooth.iter().map(|w| w / whole).collect();
    [all(&|x| -x * bell(x)), all(&|x| (x * x / (deviation * deviation) - 1.0) * bell(x))].map(|w| {
        // What is above zero sums up to 1, what is below to -1.
        let sum = |sign: f64| w.iter().map(|w| (w * sign).max(0.0)).sum::<f64>();
        let [above, below] = [sum(1.0), sum(-1.0)];
        let w: Vec<f64> = w.iter().map(|w| w / if *w > 0.0 { above } else { below }).collect();
        let along_x = plane.filtered([&w, &smooth]).values;
        let along_y = plane.filtered([&smooth, &w]).values;
        along_x.iter().zip(along_y).map(|(x, y)| x.hypot(y)).collect()
    })
}

/// How different each pixel looks: from 0, not at all, to 1. What is beyond 0 to 1 is cut off.
pub fn flip(a: &Picture, b: &Picture) -> Vec<f64> {
    assert_eq!(a.size, b.size, "pictures of two sizes");
    let [a, b] = [a, b].map(|picture| {
        let color = |p: &Vec4| opponent(p.truncate().clamp(Vec3::ZERO, Vec3::ONE).as_dvec3());
        let opponents: Vec<DVec3> = picture.pixels.iter().map(color).collect();
        let plane = |of: &dyn Fn(&DVec3) -> f64| Plane {
            width: picture.size.x as usize,
            values: opponents.iter().map(of).collect::<Vec<f64>>(),
        };
        let light = seen(&plane(&|c| c.x), &[[1.0, 0.0047]]);
        let red = seen(&plane(&|c| c.y), &[[1.0, 0.0053]]);
        let blue = seen(&plane(&|c| c.z), &[[34.1, 0.04], [13.5, 0.025]]);
        let colors = (0..light.len()).map(|i| lab(from_opponent([light[i], red[i], blue[i]])));
        (colors.collect::<Vec<_>>(), features(&plane(&|c| (c.x + 16.0) / 116.0)))
    });
    let most = apart(lab(DVec3::Y), lab(DVec3::Z));
    let knee = 0.4 * most;
    let pixel = |i: usize| {
        let far = apart(a.0[i], b.0[i]);
        let color =
            if far < knee { 0.95 * far / knee } else { 0.95 + 0.05 * (far - knee) / (most - knee) };
        let feature = [0, 1].map(|k| (a.1[k][i] - b.1[k][i]).abs());
        let feature = (feature[0].max(feature[1]) / 2.0_f64.sqrt()).sqrt();
        color.powf(1.0 - feature.min(1.0))
    };
    (0..a.0.len()).map(pixel).collect()
}

/// The mean over all pixels, by which pictures are compared.
pub fn mean(errors: &[f64]) -> f64 {
    errors.iter().sum::<f64>() / errors.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::UVec2;

    fn picture(color: impl Fn(u32, u32) -> Vec3) -> Picture {
        let size = UVec2::new(40, 30);
        let pixels = (0..size.y).flat_map(|y| (0..size.x).map(move |x| (x, y)));
        Picture { size, pixels: pixels.map(|(x, y)| color(x, y).extend(1.0)).collect() }
    }

    /// What the paper says: 0 for equal pictures, 1 for green beside blue, the same either way round, more
    /// for features that are in one alone.
    #[test]
    fn flip_is_what_the_paper_says() {
        let even = |color: Vec3| picture(|_, _| color);
        let all = |a: &Picture, b: &Picture, expected: f64| {
            for error in flip(a, b) {
                assert!((error - expected).abs() < 1e-6, "{error}, not {expected}");
            }
        };
        let waves = picture(|x, y| Vec3::new(0.5, (x % 7) as f32 / 7.0, (y % 5) as f32 / 5.0));
        all(&waves, &waves, 0.0);
        all(&even(Vec3::Y), &even(Vec3::Z), 1.0);
        // Black and white are 100 apart, green and blue by the distance in the paper's formula.
        let (far, most) = (100_f64.powf(0.7), apart(lab(DVec3::Y), lab(DVec3::Z)));
        let expected = 0.95 + 0.05 * (far - 0.4 * most) / (0.6 * most);
        all(&even(Vec3::ZERO), &even(Vec3::ONE), expected);
        let gray = even(Vec3::splat(0.5));
        let [one, other] = [flip(&waves, &gray), flip(&gray, &waves)];
        assert!(one.iter().zip(&other).all(|(a, b)| (a - b).abs() < 1e-12) && mean(&one) > 0.1);
        // A step less is seen less.
        let steps =
            [0.01, 0.03, 0.1, 0.3].map(|step| mean(&flip(&gray, &even(Vec3::splat(0.5 + step)))));
        assert!(steps.windows(2).all(|pair| pair[0] < pair[1]) && steps[0] < 0.05, "{steps:?}");
        // A point is seen more than its part in the mean, and not far from it.
        let point = picture(|x, y| Vec3::splat(if (x, y) == (20, 15) { 1.0 } else { 0.5 }));
        let errors = flip(&gray, &point);
        let at = |x: usize, y: usize| errors[y * 40 + x];
        assert!(at(20, 15) > 0.1 && at(20, 15) > 3.0 * at(24, 15) && at(0, 0) < 1e-3);
        // Colours there and back.
        let color = DVec3::new(0.2, 0.7, 0.4);
        assert!((from_opponent(opponent(color).to_array()) - color).abs().max_element() < 1e-6);
    }
}
