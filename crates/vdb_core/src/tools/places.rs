//! Where the voxels of one transform are among those of another one.

use glam::{DAffine3, DVec3};

use super::samples::Voxels;
use crate::Transform;
use crate::tree::IVec3;

/// The corners of a box.
pub(super) fn corners(low: DVec3, high: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let at = |axis: usize| if i >> axis & 1 == 1 { high[axis] } else { low[axis] };
        DVec3::new(at(0), at(1), at(2))
    })
}

/// The box around some points.
pub(super) fn around(points: [DVec3; 8]) -> [DVec3; 2] {
    let [first, rest @ ..] = points;
    rest.iter().fold([first; 2], |[low, high], p| [low.min(*p), high.max(*p)])
}

/// Where voxels of the new grid are in the old one.
pub(super) enum Places<'a> {
    Linear(DAffine3),
    Frustum { from: &'a Transform, to: &'a Transform },
}

impl<'a> Places<'a> {
    pub(super) fn new(from: &'a Transform, to: &'a Transform) -> Self {
        match (from.linear(), to.linear()) {
            (Some(own), Some(new)) => Self::Linear(own.inverse() * new),
            _ => Self::Frustum { from, to },
        }
    }

    pub(super) fn of(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Linear(old_from_new) => old_from_new.transform_point3(p),
            Self::Frustum { from, to } => from.index_from_world(to.world_from_index(p)),
        }
    }

    /// The voxels of the old grid that the values of a cube of the new one are made of. `None` if they
    /// are not known: in a frustum, points behind its apex come out in front.
    pub(super) fn voxels(&self, origin: IVec3, log2_dim: u32) -> Option<Voxels> {
        let low = origin.as_dvec3();
        let all = corners(low, low + f64::from((1_u32 << log2_dim) - 1));
        if let Self::Frustum { from, to } = self
            && !all.iter().all(|p| from.is_before_apex(to.world_from_index(*p)))
        {
            return None;
        }
        let [low, high] = around(all.map(|p| self.of(p)));
        Some(Voxels::between((low + ROUNDING / 2.0).floor(), (high - ROUNDING / 2.0).ceil()))
    }
}

/// Points this close to a voxel are at the voxel: what f64 leaves of them after two transforms.
pub(super) const ROUNDING: f64 = 1e-9;
