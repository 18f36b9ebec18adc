//! Rays mirrored so that they run upwards on every axis (octant mirroring), and where a traversal is on one.

use glam::{BVec3, IVec3, UVec3, Vec3};

/// A ray turned over on the axes where it runs down, so that it runs up on all of them: cell `c`
/// becomes `!c`, and all that is ahead has larger coordinates. Cells are counted from the ray's own.
#[derive(Clone, Copy, Debug)]
pub struct MirroredRay {
    /// -1 on the axes that are turned over, else 0.
    pub mirror: IVec3,
    /// The ray's own cell, turned over.
    pub cell: IVec3,
    /// Where in that cell the ray begins, from 0 to 1: a multiple of 2⁻²⁴.
    pub frac: Vec3,
    /// Cells per unit of `t`, 0 or more; what hardware may take for zero is zero.
    pub speed: Vec3,
    /// One over that, or over `IDLE`, the least speed that counts, where it is less.
    pub inverse: Vec3,
    /// The grid's box: its first cells ahead (0 where the ray is in or beyond them) and its last.
    pub first: UVec3,
    /// The last cells of the box, or those in which the ray ends if it ends before them.
    pub last: UVec3,
    /// Whether the box is ahead of the ray's own cell on an axis.
    pub(super) before: BVec3,
    /// The cell in which the ray begins: that at `t_min`; 0 where that is before the box.
    pub(super) begin: UVec3,
    /// Whether the ray can meet the box at all.
    pub(super) meets: bool,
    /// The octant of its direction.
    pub octant: u32,
    /// 0 or more, nothing denormal.
    pub(super) t_min: f32,
    /// `FAR` where the ray leaves the box before it ends.
    pub(super) t_max: f32,
}

/// `t` of planes that are never reached.
pub(super) const FAR: f32 = 1e30;
impl MirroredRay {
    /// The local cell `rel` cells ahead of the ray's own.
    pub fn local(&self, rel: UVec3) -> IVec3 {
        self.cell.wrapping_add(rel.as_ivec3()) ^ self.mirror
    }

    /// A place within a cell as the lattice has it.
    pub(super) fn unmirrored(&self, u: Vec3) -> Vec3 {
        Vec3::select(self.mirror.cmpne(IVec3::ZERO), 1.0 - u, u)
    }

    /// Where the mirrored ray crosses planes ahead of it, one on each axis, to within [`T_ERROR`](super::exact::T_ERROR). The
    /// integers are exact; the ray's own numbers come in only at the end.
    pub(super) fn plane_t(&self, plane: UVec3) -> Vec3 {
        (plane.as_vec3() - self.frac) * self.inverse
    }
}

/// Where a mirrored ray is on its way through the lattice.
#[derive(Clone, Copy, Debug)]
pub struct Dda {
    /// The cell, counted from the mirrored ray's own.
    pub rel: UVec3,
    /// Where the mirrored ray enters it.
    pub t: f32,
    /// The axis of the face by which; 3 where it started inside.
    pub axis: u32,
    /// Whether the cell is in the grid's box and before the ray's end.
    pub inside: bool,
}
