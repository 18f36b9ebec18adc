//! What fog does to light.

use glam::Vec3;

/// The optical properties of fog, linear RGB.
#[derive(Clone, Copy, Debug)]
pub struct Medium {
    /// The extinction coefficient at a density of 1, per world unit.
    pub extinction: Vec3,
    /// The fraction of it that is scattered.
    pub albedo: Vec3,
}

impl Medium {
    /// The number of channels that differ: a grey fog has the same light in all of them.
    pub fn channels(&self) -> usize {
        let is_gray = |color: Vec3| color.x == color.y && color.y == color.z;
        if is_gray(self.extinction) && is_gray(self.albedo) { 1 } else { 3 }
    }
}
