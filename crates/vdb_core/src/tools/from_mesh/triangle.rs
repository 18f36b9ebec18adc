//! Distances to a triangle.

use glam::{DVec3, Vec3};

/// Points that are handled at once.
pub(super) const LANES: usize = 4;

/// A triangle with less height than this, in voxels, is treated as its edges: its normal would be
/// imprecise, and no point of it is farther from an edge.
const LEAST_HEIGHT: f64 = 1e-6;

/// A triangle prepared for distances from many points; in voxels.
pub(super) struct Triangle {
    corners: [DVec3; 3],
    /// From each corner to the next one.
    edges: [DVec3; 3],
    inverse_squares: [f64; 3],
    /// Of unit length.
    normal: DVec3,
    /// In the plane, at a right angle to each edge, towards the inside.
    inward: [DVec3; 3],
    has_area: bool,
    /// A circle around the triangle.
    center: DVec3,
    radius: f64,
    /// The bounding box.
    pub low: DVec3,
    pub high: DVec3,
}

impl Triangle {
    pub(super) fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let edges = [b - a, c - b, a - c];
        let normal = edges[0].cross(edges[1]);
        let longest = edges.map(|edge| edge.length_squared()).into_iter().fold(0.0, f64::max);
        let has_area = normal.length() > LEAST_HEIGHT * longest.sqrt();
        let normal = if has_area { normal.normalize() } else { DVec3::ZERO };
        let center = (a + b + c) / 3.0;
        let inverse = |edge: DVec3| {
            let square = edge.length_squared();
            if square > 0.0 { square.recip() } else { 0.0 }
        };
        Self {
            corners,
            edges,
            // Infinite for edges shorter than 1e-154, whose ends are the same point to all others.
            inverse_squares: edges.map(|edge| inverse(edge).min(f64::MAX)),
            normal,
            inward: edges.map(|edge| normal.cross(edge)),
            has_area,
            center,
            // A little more, for rounding.
            radius: corners.map(|corner| corner.distance(center)).into_iter().fold(1e-9, f64::max),
            low: a.min(b).min(c),
            high: a.max(b).max(c),
        }
    }

    /// Lowers squared distances to those of the points `p`, `p + z`, `p + 2z`, … where these are
    /// less.
    #[inline]
    pub(super) fn lower(&self, p: DVec3, squares: &mut [f64; LANES]) {
        let mut least = [f64::INFINITY; LANES];
        let mut inside = [f64::INFINITY; LANES];
        for i in 0..3 {
            let (q, edge, inward) = (p - self.corners[i], self.edges[i], self.inward[i]);
            let inverse = self.inverse_squares[i];
            let (along, per_lane) = (q.dot(edge), edge.z);
            let within = q.dot(inward);
            for lane in 0..LANES {
                let z = lane as f64;
                let t = ((along + z * per_lane) * inverse).clamp(0.0, 1.0);
                let x = q.x - t * edge.x;
                let y = q.y - t * edge.y;
                let z_to = q.z + z - t * edge.z;
                least[lane] = (x * x + y * y + z_to * z_to).min(least[lane]);
                inside[lane] = (within + z * inward.z).min(inside[lane]);
            }
        }
        if self.has_area {
            let height = self.normal.dot(p - self.corners[0]);
            for lane in 0..LANES {
                let h = height + lane as f64 * self.normal.z;
                least[lane] = if inside[lane] >= 0.0 { h * h } else { least[lane] };
            }
        }
        for lane in 0..LANES {
            squares[lane] = squares[lane].min(least[lane]);
        }
    }

    /// The squared distance of a point.
    pub(super) fn distance_squared(&self, p: DVec3) -> f64 {
        let mut squares = [f64::INFINITY; LANES];
        self.lower(p, &mut squares);
        squares[0]
    }

    /// The disc around the triangle, as seen from a leaf.
    pub(super) fn disc(&self, origin: DVec3) -> Disc {
        Disc {
            center: (self.center - origin).as_vec3(),
            normal: self.normal.as_vec3(),
            radius: (self.radius as f32) * 1.00001 + SLACK,
            is_small: self.radius < LARGEST_DISC,
        }
    }
}

/// The largest disc that is looked at: for this and eight voxels more, f32 has an error of 2e-6.
const LARGEST_DISC: f64 = 16.0;

/// More than the error of squares in [`Disc::can_lower`], which are less than 32².
pub(super) const SLACK: f32 = 1e-3;

/// A disc that contains a triangle. It tells in a few instructions, without any precision, that the
/// triangle is not the nearest.
///
/// A point at a height `h` above it, and at a distance `b` beside its center, is at least
/// `√(h² + (b - radius)²)` away. On smooth surfaces this leaves the triangles near the foot of the
/// perpendicular.
pub(super) struct Disc {
    center: Vec3,
    normal: Vec3,
    radius: f32,
    is_small: bool,
}

impl Disc {
    /// Whether the triangle may be closer to one of the points `p`, `p + z`, `p + 2z`, … than the
    /// square roots of these bounds, which are [`SLACK`] too large.
    #[inline]
    pub(super) fn can_lower(&self, p: Vec3, bounds: &[f32; LANES]) -> bool {
        const STEPS: [f32; LANES] = [0.0, 1.0, 2.0, 3.0];
        let q = p - self.center;
        let (height, square) = (q.dot(self.normal), q.x * q.x + q.y * q.y);
        let mut margins = [0.0; LANES];
        // Comparisons instead of `max` and `min`, which would ask for NaNs.
        for lane in 0..LANES {
            let z = q.z + STEPS[lane];
            let h = height + STEPS[lane] * self.normal.z;
            let left = bounds[lane] - h * h;
            let beside = square + z * z - h * h;
            let root = if left > 0.0 { left } else { 0.0 }.sqrt();
            let room = (self.radius + root) * (self.radius + root) - beside;
            margins[lane] = if room < left { room } else { left };
        }
        !self.is_small || margins.iter().fold(false, |any, margin| any | (*margin > 0.0))
    }
}
