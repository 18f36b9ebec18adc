//! Two frames in one index space, that of the first.

use glam::{DAffine3, DVec3};

use super::frame::{floats, matrix};
use crate::tree::{CoordBox, IVec3, Vdb543};
use crate::{Error, Grid};

/// The tree of a frame, as seen from the index space of the first frame.
pub(super) struct Placed<'a> {
    pub tree: &'a Vdb543<f32>,
    /// From the index space of the first frame; `None` if it is the same.
    pub map: Option<DAffine3>,
    /// Its inverse.
    back: DAffine3,
}

/// Two frames.
pub(super) struct Pair<'a> {
    pub from: Placed<'a>,
    pub to: Placed<'a>,
    /// The index space of the first frame.
    pub world_from_index: DAffine3,
}

impl<'a> Pair<'a> {
    pub fn new(from: &'a Grid, to: &'a Grid) -> Result<Self, Error> {
        let (from_tree, to_tree) = (floats(from)?, floats(to)?);
        let (world_from_index, other) = (matrix(from)?, matrix(to)?);
        let same = world_from_index == other;
        let map = (!same).then(|| other.inverse() * world_from_index);
        let back = map.map_or(DAffine3::IDENTITY, |map| map.inverse());
        if ![map.unwrap_or(back), back].iter().all(is_sound) {
            let what = "voxels of a size so unlike that of the other frame that positions overflow; \
                        write both frames with one transform";
            return Err(Error::not_supported(what).in_grid(&to.unique_name));
        }
        Ok(Self {
            from: Placed { tree: from_tree, map: None, back: DAffine3::IDENTITY },
            to: Placed { tree: to_tree, map, back },
            world_from_index,
        })
    }

    /// The smallest box, in the index space of the first frame, of all active voxels.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        let boxes = [&self.from, &self.to].map(|frame| {
            let bbox = frame.tree.active_bbox()?;
            Some(image(frame.back, bbox.min.as_dvec3(), bbox.max.as_dvec3()))
        });
        boxes.into_iter().flatten().reduce(union)
    }
}

/// The smallest box around two.
pub(super) fn union(a: [DVec3; 2], b: [DVec3; 2]) -> [DVec3; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

impl Placed<'_> {
    /// A point of the first frame's index space in the frame's own.
    #[inline]
    pub fn own(&self, p: DVec3) -> DVec3 {
        self.map.map_or(p, |map| map.transform_point3(p))
    }

    /// A point of the frame's own index space in that of the first.
    pub fn first(&self, p: DVec3) -> DVec3 {
        self.back.transform_point3(p)
    }

    /// A box of the first frame's index space in the frame's own.
    pub fn own_box(&self, min: DVec3, max: DVec3) -> [DVec3; 2] {
        self.map.map_or([min, max], |map| image(map, min, max))
    }

    /// A box of voxels in the first frame's index space.
    pub fn seen(&self, bbox: CoordBox) -> [DVec3; 2] {
        match self.map {
            // A sample has influence on less than a voxel around it.
            Some(_) => image(self.back, bbox.min.as_dvec3() - 1.0, bbox.max.as_dvec3() + 1.0),
            None => [bbox.min.as_dvec3(), bbox.max.as_dvec3()],
        }
    }
}

/// Whether no voxel is mapped to infinity or nowhere.
fn is_sound(map: &DAffine3) -> bool {
    const MOST: f64 = 1e100;
    map.to_cols_array().iter().all(|entry| entry.abs() <= MOST)
}

/// The box around the image of a box.
fn image(map: DAffine3, min: DVec3, max: DVec3) -> [DVec3; 2] {
    let corner =
        |i: u32| DVec3::from_array([0, 1, 2].map(|a| [min, max][(i >> a & 1) as usize][a]));
    (0..8)
        .map(|i| map.transform_point3(corner(i)))
        .map(|p| [p, p])
        .reduce(union)
        .unwrap_or([DVec3::ZERO; 2])
}

/// The voxel of a point whose coordinates are integers; coordinates beyond the index space become
/// its ends.
pub(super) fn voxel(p: DVec3) -> IVec3 {
    IVec3::new(p.x as i32, p.y as i32, p.z as i32)
}
