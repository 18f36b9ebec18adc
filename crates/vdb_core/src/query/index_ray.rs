//! Rays and hits in index space.

use glam::{DVec3, IVec3};

/// A ray in index space, `p(t) = origin + t · dir` for `t` from 0 to `t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexRay {
    /// The origin.
    pub origin: DVec3,
    /// Voxels per unit of `t`; any non-zero length.
    pub dir: DVec3,
    /// The end; may be infinite.
    pub t_max: f64,
}

impl IndexRay {
    /// The point at `t`.
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.dir
    }
}

/// A hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexHit {
    /// The ray parameter.
    pub t: f64,
    /// The voxel. For voxels, the one that the ray enters; for smooth surfaces and fog, the one
    /// around the point.
    pub ijk: IVec3,
    /// The outward direction, of any length: the face normal for voxels, the gradient of the
    /// interpolant for smooth surfaces, and the negative gradient for fog, which points towards
    /// thinner fog. Transform it to world space by the inverse transpose. Zero if the ray begins in
    /// a voxel or the interpolant is flat.
    pub normal: DVec3,
    /// Whether the ray begins in a solid voxel.
    pub begins_inside: bool,
}

/// The voxel around a point, clamped to index space.
pub(super) fn nearest_voxel(point: DVec3) -> [i32; 3] {
    point.to_array().map(|c| (c + 0.5).floor() as i32)
}
