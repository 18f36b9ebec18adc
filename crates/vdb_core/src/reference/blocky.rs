//! The first occupied voxel on a ray, decided exactly.

use glam::DVec3;

use super::{
    Ray,
    cells::Corners,
    field::{Block, Field},
    planes::Planes,
    walk::{Span, Walk, outside_of_index_space},
};
use crate::tree::{IVec3, Node, Tree};

/// The criterion for occupied voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Occupied {
    /// The value is below the iso-value, whether active or not, so that the interior tiles of level
    /// sets count. NaNs do not count.
    BelowIso(f32),
    /// The voxel is active, or lies in an active tile.
    Active,
    /// The value is above a threshold, whether active or not. NaNs do not count.
    Above(f32),
}

impl Occupied {
    /// Whether a voxel of this value and state (active or not) is occupied.
    #[inline]
    pub fn holds(self, value: f32, active: bool) -> bool {
        match self {
            Self::BelowIso(iso) => value < iso,
            Self::Active => active,
            Self::Above(threshold) => value > threshold,
        }
    }
}

/// A face of a voxel, by its outward normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Face {
    /// 0, 1, 2 for x, y, z.
    pub axis: u8,
    /// +1 or -1: the direction of the normal on the axis, against the ray's direction.
    pub sign: i8,
}

impl Face {
    /// The outward normal in index space.
    pub fn normal(self) -> DVec3 {
        DVec3::AXES[usize::from(self.axis)] * f64::from(self.sign)
    }
}

/// The first occupied voxel on a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelHit {
    /// The voxel: the box `[ijk - 1/2, ijk + 1/2)` of index space.
    pub ijk: IVec3,
    /// The face through which the ray enters; `None` if it begins inside.
    pub face: Option<Face>,
    /// The `t` at which the ray enters, with a relative error of at most 2.1 · 2⁻⁵³; `t_min` if the
    /// ray begins inside. (The voxel and the face are exact.)
    pub t: f64,
}

/// Finds the first voxels on rays through one tree; see [`first_voxel`].
#[derive(Debug)]
pub struct Blocky<'a, C: Node<Value = f32>> {
    field: Field<'a, C>,
    occupied: Occupied,
}

impl<'a, C: Node<Value = f32>> Blocky<'a, C> {
    /// Prepares a tree by sorting the positions of its root entries.
    pub fn new(tree: &'a Tree<C>, occupied: Occupied) -> Self {
        Self { field: Field::new(tree), occupied }
    }

    /// The gradient, per voxel, of the trilinear interpolant at a point in index space. The cell is
    /// the one that contains `beside`, a point nearby, which selects a side of a face. Not finite
    /// if a sample is not.
    pub fn gradient(&self, point: DVec3, beside: DVec3) -> DVec3 {
        let cell = beside.floor();
        let mut accessor = self.field.tree().accessor();
        let corners = self.field.corners(&mut accessor, cell.to_array().map(|c| c as i64));
        Corners(corners.map(f64::from)).gradient(point - cell)
    }

    /// See [`first_voxel`].
    pub fn first_voxel(&self, ray: &Ray) -> Option<VoxelHit> {
        let mut walk = Walk::new(ray, Planes::of_voxels(ray))?;
        let mut accessor = self.field.tree().accessor();
        for _ in 0..=self.field.max_steps() {
            let cell = walk.cell();
            let index_space = outside_of_index_space(cell);
            let span = match index_space {
                // There are no voxels outside the index space, even with an occupied background.
                Some(span) => span,
                None => {
                    let (span, occupied) = match self.field.block(&mut accessor, cell) {
                        Block::Tile(span, value, active) => {
                            let holds = self.occupied.holds(value, active);
                            (span, holds && !self.field.is_void(cell))
                        }
                        Block::Voxel(value, active) => {
                            (Span::cell(cell), self.occupied.holds(value, active))
                        }
                    };
                    if occupied {
                        let face = walk
                            .entered()
                            .map(|(axis, step)| Face { axis: axis as u8, sign: -step as i8 });
                        let ijk = IVec3::from_array(cell.map(|c| c as i32));
                        return Some(VoxelHit { ijk, face, t: walk.t() });
                    }
                    span
                }
            };
            let exit = walk.exit(span)?;
            walk.cross(span, exit);
        }
        unreachable!("a walk crosses every plane of the tree once at most")
    }
}

/// The first occupied voxel on a ray and the face through which the ray enters it. **Exact**: voxel
/// and face follow from the real numbers that define the ray, without rounding.
///
/// - A voxel is the half-open box `[ijk - 1/2, ijk + 1/2)`: the ray begins in the voxel
///   `floor(p(t_min) + 1/2)`, and a ray that runs in a face belongs to the voxel above it.
/// - A voxel is left at the plane of its face, `t = (n - 1/2 - origin) / dir`. Planes crossed at
///   the same `t` are crossed one after the other, x before y before z, and the voxels between them
///   count. The face of the hit is on the last plane crossed.
/// - A crossing at exactly `t_max` counts. An axis with a direction component of zero is never
///   crossed.
/// - Where the root of the tree has no entry there are no voxels, whatever the background.
///
/// For many rays, prepare the tree once with [`Blocky::new`].
pub fn first_voxel<C: Node<Value = f32>>(
    tree: &Tree<C>,
    occupied: Occupied,
    ray: &Ray,
) -> Option<VoxelHit> {
    Blocky::new(tree, occupied).first_voxel(ray)
}
