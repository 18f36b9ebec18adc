//! Boxes and statistics of active values.

use crate::tree::{CoordBox, IVec3};

/// Minimum, maximum, mean and sum of squared differences from the mean.
///
/// The mean and the sum are updated value by value (B. P. Welford, "Note on a method for calculating
/// corrected sums of squares and products", Technometrics 4(3), 1962), and combined as by T. F. Chan,
/// G. H. Golub and R. J. `LeVeque`, "Algorithms for computing the sample variance", The American
/// Statistician 37(3), 1983.
#[derive(Clone, Copy, Debug)]
pub(super) struct Statistics {
    pub min: f32,
    pub max: f32,
    count: u64,
    mean: f64,
    squares: f64,
    pub bbox: Option<CoordBox>,
}

impl Statistics {
    /// Of no values.
    pub const NONE: Self =
        Self { min: f32::MAX, max: f32::MIN, count: 0, mean: 0.0, squares: 0.0, bbox: None };

    /// Adds a value; NaNs are neither the minimum nor the maximum.
    pub fn add(&mut self, value: f32) {
        self.extend(value, value);
        self.count += 1;
        let delta = f64::from(value) - self.mean;
        self.mean += delta / self.count as f64;
        self.squares += delta * (f64::from(value) - self.mean);
    }

    /// Adds a tile: a value that fills a cube.
    pub fn add_tile(&mut self, value: f32, origin: IVec3, log2_dim: u32) {
        let tile = Self {
            min: value,
            max: value,
            count: 1 << (3 * log2_dim),
            mean: value.into(),
            squares: 0.0,
            bbox: Some(CoordBox::cube(origin, log2_dim)),
        };
        self.combine(&tile);
    }

    /// Adds all values of another part.
    pub fn combine(&mut self, other: &Self) {
        if other.count == 0 {
            return;
        }
        self.extend(other.min, other.max);
        let count = (self.count + other.count) as f64;
        let delta = other.mean - self.mean;
        let share = other.count as f64 / count;
        self.mean += delta * share;
        self.squares += other.squares + delta * delta * self.count as f64 * share;
        self.count += other.count;
        self.bbox = match (self.bbox, other.bbox) {
            (Some(own), Some(other)) => Some(own.union(other)),
            (own, other) => own.or(other),
        };
    }

    fn extend(&mut self, min: f32, max: f32) {
        if min < self.min {
            self.min = min;
        }
        if max > self.max {
            self.max = max;
        }
    }

    /// The mean.
    pub fn average(&self) -> f32 {
        self.mean as f32
    }

    /// The standard deviation of all values, not of a sample.
    pub fn deviation(&self) -> f32 {
        if self.count < 2 { 0.0 } else { (self.squares / self.count as f64).sqrt() as f32 }
    }
}
