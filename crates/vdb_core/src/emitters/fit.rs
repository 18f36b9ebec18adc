//! A few point lights that stand for many sources.

use glam::{DMat3, DVec3, Vec3};

use super::Source;

/// A point light that stands for a part of a fire.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lamp {
    /// The centroid of the part's light, in the file's world.
    pub position: Vec3,
    /// The sum of the part's intensities, as RGB.
    pub intensity: Vec3,
    /// The radius of an even ball of light with the same spread.
    pub radius: f32,
}

/// The ratio of the cross-section's radius to that of the distance at which errors are estimated:
/// half a radius from the boundary.
const DISTANCE: f64 = 1.5;
/// The estimated error of the light at that distance, above which a part is divided.
const TOLERANCE: f64 = 0.02;
/// Iterations of Lloyd's algorithm after each division.
const ITERATIONS: usize = 4;

/// At most `max_lamps` point lights that light what is outside a fire like its sources.
///
/// Without what absorbs it, the irradiance vector of sources with intensities `Iᵢ` at `xᵢ` is
/// `Σ Iᵢ (xᵢ - p) / |xᵢ - p|³`, formally the gravitational field of masses `Iᵢ`. Outside an even
/// ball that is exactly the field of a point in the middle, so what matters is how far a part is
/// from being as wide as it is long, and not its size. Parts are divided, the one with the largest
/// error first, across their longest axis, and then improved by Lloyd's algorithm (1982) until the
/// quadrupole of none of them matters any more.
pub fn fit_lamps(sources: &[Source], max_lamps: usize) -> Vec<Lamp> {
    let points: Vec<Point> = sources.iter().filter_map(Point::new).collect();
    if points.is_empty() || max_lamps == 0 {
        return Vec::new();
    }
    let mut owners = vec![0; points.len()];
    let mut parts = Part::all(&points, &owners, 1);
    let (whole, [_, thin, _]) = (parts[0].weight, parts[0].axes().1);
    // The squared semi-axis of an even ellipsoid is five times its variance.
    let distance_squared = (DISTANCE * DISTANCE * 5.0 * thin).max(f64::MIN_POSITIVE);
    while parts.len() < max_lamps {
        let error = |part: &Part| {
            let [a, b, c] = part.axes().1;
            // On the long axis of a quadrupole.
            3.0 * part.weight / whole * (c - 0.5 * (a + b)) / distance_squared
        };
        let errors = parts.iter().map(error).enumerate();
        let Some((worst, error)) = errors.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        if error.is_nan() || error <= TOLERANCE {
            break;
        }
        let (middle, axis, next) = (parts[worst].center, parts[worst].axes().0, parts.len());
        for (point, owner) in points.iter().zip(&mut owners) {
            if *owner == worst && (point.position - middle).dot(axis) > 0.0 {
                *owner = next;
            }
        }
        let divided = improve(&points, &mut owners, next + 1);
        if divided.len() <= next {
            break;
        }
        parts = divided;
    }
    parts.iter().map(Part::lamp).collect()
}

/// Lloyd's algorithm: each point belongs to the part with the nearest centroid. Returns the parts
/// that have points.
fn improve(points: &[Point], owners: &mut [usize], count: usize) -> Vec<Part> {
    for _ in 0..ITERATIONS {
        let mut parts = Part::all(points, owners, count);
        parts.retain(|part| part.weight > 0.0);
        for (point, owner) in points.iter().zip(&mut *owners) {
            let distance = |part: &Part| part.center.distance_squared(point.position);
            let parts = parts.iter().map(distance).enumerate();
            *owner = parts.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(number, _)| number);
        }
    }
    let mut parts = Part::all(points, owners, count);
    parts.retain(|part| part.weight > 0.0);
    parts
}

struct Point {
    position: DVec3,
    intensity: DVec3,
    weight: f64,
}

impl Point {
    fn new(source: &Source) -> Option<Self> {
        let intensity = source.intensity.as_dvec3();
        let weight = intensity.dot(LUMINANCE);
        let is_sound = weight > 0.0 && weight.is_finite() && source.position.is_finite();
        is_sound.then_some(Self { position: source.position.as_dvec3(), intensity, weight })
    }
}

/// The luminance of linear Rec. 709.
const LUMINANCE: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

/// Some of the points.
#[derive(Clone, Copy, Debug)]
struct Part {
    weight: f64,
    intensity: DVec3,
    center: DVec3,
    /// The covariance of the positions, weighted by light.
    scatter: DMat3,
}

impl Part {
    /// The parts of all owners.
    fn all(points: &[Point], owners: &[usize], count: usize) -> Vec<Self> {
        let nothing =
            Self { weight: 0.0, intensity: DVec3::ZERO, center: DVec3::ZERO, scatter: DMat3::ZERO };
        let mut parts = vec![nothing; count];
        for (point, owner) in points.iter().zip(owners) {
            let part = &mut parts[*owner];
            part.weight += point.weight;
            part.intensity += point.intensity;
            part.center += point.weight * point.position;
        }
        for part in parts.iter_mut().filter(|part| part.weight > 0.0) {
            part.center /= part.weight;
        }
        for (point, owner) in points.iter().zip(owners) {
            let part = &mut parts[*owner];
            let d = point.position - part.center;
            let weighted = d * (point.weight / part.weight);
            part.scatter += DMat3::from_cols(weighted * d.x, weighted * d.y, weighted * d.z);
        }
        parts
    }

    /// The longest axis, and the variances along the principal axes, in ascending order.
    ///
    /// The eigenvalues of a symmetric matrix of 3×3 by Smith 1961, "Eigenvalues of a symmetric 3×3
    /// matrix".
    fn axes(&self) -> (DVec3, [f64; 3]) {
        let m = self.scatter;
        let mean = (m.x_axis.x + m.y_axis.y + m.z_axis.z) / 3.0;
        let rest = m - DMat3::from_diagonal(DVec3::splat(mean));
        let size = rest.to_cols_array().iter().map(|x| x * x).sum::<f64>();
        let size = (size / 6.0).sqrt();
        if size <= 1e-12 * mean || size == 0.0 {
            return (DVec3::X, [mean; 3]);
        }
        let half = (0.5 * (rest * size.recip()).determinant()).clamp(-1.0, 1.0);
        let angle = half.acos() / 3.0;
        let third = std::f64::consts::TAU / 3.0;
        let high = mean + 2.0 * size * angle.cos();
        let low = mean + 2.0 * size * (angle + third).cos();
        let middle = 3.0 * mean - high - low;
        // The columns of (M - a)(M - b) lie along the axis of the third one.
        let shifted = |by: f64| m - DMat3::from_diagonal(DVec3::splat(by));
        let product = shifted(low) * shifted(middle);
        let columns = [product.x_axis, product.y_axis, product.z_axis];
        let longest = columns.into_iter().max_by(|a, b| a.length().total_cmp(&b.length()));
        let axis = longest.and_then(DVec3::try_normalize).unwrap_or(DVec3::X);
        // The same direction for small changes of the scatter.
        let axis = if axis.dot(DVec3::new(0.3, 1.0, 0.1)) < 0.0 { -axis } else { axis };
        (axis, [low.max(0.0), middle.max(0.0), high])
    }

    fn lamp(&self) -> Lamp {
        let scatter = self.scatter;
        let variance = scatter.x_axis.x + scatter.y_axis.y + scatter.z_axis.z;
        Lamp {
            position: self.center.as_vec3(),
            intensity: self.intensity.as_vec3(),
            radius: (5.0 / 3.0 * variance).sqrt() as f32,
        }
    }
}
