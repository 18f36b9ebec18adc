//! Rays mirrored to run upwards on every axis (octant mirroring), and positions of a traversal.

use glam::{BVec3, IVec3, UVec3, Vec3};

/// A ray mirrored on the axes on which it runs down, so that it runs up on all of them. Cell `c`
/// becomes `!c`, and everything ahead has larger coordinates. Cells are counted from the ray's own.
#[derive(Clone, Copy, Debug)]
pub struct MirroredRay {
    /// -1 on mirrored axes, else 0.
    pub mirror: IVec3,
    /// The ray's own cell, mirrored.
    pub cell: IVec3,
    /// The position in that cell at which the ray begins, from 0 to 1: a multiple of 2⁻²⁴.
    pub frac: Vec3,
    /// Cells per unit of `t`, 0 or more. Denormal components, which hardware may flush to zero, are
    /// zero.
    pub speed: Vec3,
    /// The inverse of the speed, or of `IDLE` if the speed is less.
    pub inverse: Vec3,
    /// The first cells of the grid's box; 0 on axes on which the ray's own cell is in or beyond
    /// them.
    pub first: UVec3,
    /// The last cells of the box, or those in which the ray ends if it ends before them.
    pub last: UVec3,
    /// Whether the ray's own cell is before the box on an axis.
    pub(super) before: BVec3,
    /// The cell at `t_min`, in which the ray begins; 0 if that is before the box.
    pub(super) begin: UVec3,
    /// Whether the ray can meet the box.
    pub(super) meets: bool,
    /// The octant of the ray's direction.
    pub octant: u32,
    /// The start, 0 or more and never denormal.
    pub(super) t_min: f32,
    /// The end; `FAR` if the ray leaves the box before it.
    pub(super) t_max: f32,
}

/// The `t` of planes that are never reached.
pub(super) const FAR: f32 = 1e30;
impl MirroredRay {
    /// The local cell `rel` cells ahead of the ray's own.
    pub fn local(&self, rel: UVec3) -> IVec3 {
        self.cell.wrapping_add(rel.as_ivec3()) ^ self.mirror
    }

    /// A position within a cell, converted from mirrored to lattice axes.
    pub(super) fn unmirrored(&self, u: Vec3) -> Vec3 {
        Vec3::select(self.mirror.cmpne(IVec3::ZERO), 1.0 - u, u)
    }

    /// The `t` at which the mirrored ray crosses planes ahead of it, one on each axis, to within
    /// [`T_ERROR`](super::exact::T_ERROR). Integers are exact; rounding comes in only with the
    /// ray's own numbers at the end.
    pub(super) fn plane_t(&self, plane: UVec3) -> Vec3 {
        (plane.as_vec3() - self.frac) * self.inverse
    }
}

/// The position of a traversal on a mirrored ray.
#[derive(Clone, Copy, Debug)]
pub struct Dda {
    /// The current cell, counted from the mirrored ray's own.
    pub rel: UVec3,
    /// The `t` at which the ray enters the cell.
    pub t: f32,
    /// The axis of the face entered; 3 if the ray began inside.
    pub axis: u32,
    /// Whether the cell is in the grid's box and not beyond the ray's end.
    pub inside: bool,
}
