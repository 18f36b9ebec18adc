//! Rays and boxes in world space.

use glam::DVec3;

/// A ray in world space.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: DVec3,
    /// Of unit length.
    pub dir: DVec3,
    /// The end, in world units from the origin.
    pub t_max: f64,
}

/// The corners of a box.
pub fn corners([low, high]: [DVec3; 2]) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
        DVec3::new(pick(0), pick(1), pick(2))
    })
}
