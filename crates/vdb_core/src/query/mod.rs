//! What a ray meets in a grid, and what is at a point, on the CPU: for games and for picking.
//!
//! The answers are those of the picture. The cells that a ray touches come from [`walk`], the twin of
//! the shader's walk, exactly; within them the samples are those of the tree, and what the shader
//! works out in f32 is worked out in f64 here: roots of the trilinear interpolant as `smooth.wgsl`
//! finds them, optical depth as `fog.wgsl` adds it up.
//!
//! Points and rays are in *index space*, where the sample `ijk` is the point `(i, j, k)` and the
//! voxel `ijk` is the cube of edge 1 around it.

mod course;
mod cubic;
mod fog;
mod samples;
mod smooth;

use glam::{DVec3, IVec3};

use crate::pack::{PackKind, PackedGrid, walk};
use crate::tree::Vdb543;
use course::LocalRay;
use samples::Samples;

/// A ray in index space, `p(t) = origin + t · dir` for `t` from 0 to `t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexRay {
    /// Where it begins.
    pub origin: DVec3,
    /// Voxels per unit of `t`; of any length but zero.
    pub dir: DVec3,
    /// Where it ends; may be infinite.
    pub t_max: f64,
}

impl IndexRay {
    /// The point at `t`.
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.dir
    }
}

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexHit {
    /// Where on the ray.
    pub t: f64,
    /// The voxel there: the one that the ray comes into, for voxels; the one around the point, for
    /// smooth surfaces and fog.
    pub ijk: IVec3,
    /// Outwards, of any length: the normal of the face for voxels, the gradient of the interpolant
    /// for smooth surfaces, and its opposite for fog, which is outside where it is thin. A gradient:
    /// it goes to the world by the inverse transpose. Zero where the ray begins in a voxel, or the
    /// interpolant is flat.
    pub normal: DVec3,
    /// Whether the ray begins in a solid voxel.
    pub begins_inside: bool,
}

/// Asks about one grid: its tree, and the same tree packed.
#[derive(Clone, Copy, Debug)]
pub struct GridQuery<'a> {
    tree: &'a Vdb543<f32>,
    packed: &'a PackedGrid,
}

impl<'a> GridQuery<'a> {
    /// `packed` must have been made of `tree`.
    pub fn new(tree: &'a Vdb543<f32>, packed: &'a PackedGrid) -> Self {
        Self { tree, packed }
    }

    /// The first thing on a ray: a solid voxel, a root of the trilinear interpolant, or the place
    /// where `∫ density dt` from the ray's beginning on passes `enough`, by the grid's kind.
    ///
    /// A ray is rounded close to the grid, not at its origin: to 2⁻²⁴ of a voxel where it comes into
    /// the grid's box and 2⁻²⁴ of the way from there, however far away it begins. A ray whose numbers
    /// are not finite (but for `t_max`, which may be infinite) meets nothing.
    ///
    /// It takes time in proportion to the cubes that the ray passes, of which empty ones are as large as
    /// the tree's, or larger: at most 3 · 4096 steps through each of the tree's 4096³ nodes on its way, and
    /// some tens through the void between two of them. A tile of fog is one step, but for its cells at
    /// the border. The bound holds for any ray, wherever in index space the grid lies.
    pub fn first_hit(&self, ray: &IndexRay, enough: f64) -> Option<IndexHit> {
        let local = LocalRay::new(self.packed, ray)?;
        let hit = match self.packed.kind {
            PackKind::Surface { .. } => self.first_voxel(&local),
            PackKind::Smooth { iso } => {
                smooth::first_root(self.packed, &mut self.samples(), &local, iso.into(), ray)
            }
            PackKind::Fog => {
                fog::first_opaque(self.packed, &mut self.samples(), &local, enough, ray)
            }
        };
        hit.filter(|hit| hit.t <= ray.t_max)
    }

    fn samples(&self) -> Samples<'a> {
        Samples::new(self.tree, self.packed.kind)
    }

    fn first_voxel(&self, local: &LocalRay) -> Option<IndexHit> {
        let hit = walk::first_hit(self.packed, &local.ray)?;
        let ijk = hit.cell.wrapping_add(self.packed.base);
        let begins = hit.axis > 2;
        let mut normal = DVec3::ZERO;
        if begins && local.t_begin == 0.0 {
            return Some(IndexHit { t: 0.0, ijk, normal, begins_inside: true });
        }
        // Where the box ends with the index space, a ray that comes into that begins in the box.
        let axis = if begins { local.begin_axis } else { hit.axis as usize };
        normal[axis] = -f64::from(local.ray.dir[axis].signum());
        let way = if begins { 0.0 } else { local.face_t(hit.cell, axis) };
        Some(IndexHit { t: local.t_from_walk(way), ijk, normal, begins_inside: false })
    }

    /// The value at the sample nearest to a point, as the grid is shown: densities are 0 or more, and
    /// there is no NaN.
    pub fn nearest(&self, point: DVec3) -> f32 {
        self.samples().value(nearest_voxel(point).map(i64::from))
    }

    /// The trilinear interpolant at a point, as the grid is shown: densities are 0 or more, and there
    /// is no NaN.
    pub fn trilinear(&self, point: DVec3) -> f32 {
        let cell = point.floor();
        self.samples().corners(cell.to_array().map(|c| c as i64)).at(point - cell) as f32
    }

    /// Whether a point is in something: in a solid voxel, where the interpolant is below the
    /// iso-value of a smooth surface, or where a density is above zero.
    pub fn contains(&self, point: DVec3) -> bool {
        match self.packed.kind {
            PackKind::Surface { iso } => self.nearest(point) < iso,
            PackKind::Smooth { iso } => self.trilinear(point) < iso,
            PackKind::Fog => self.trilinear(point) > 0.0,
        }
    }
}

/// The voxel around a point; of those at the ends of the index space where it lies beyond.
fn nearest_voxel(point: DVec3) -> [i32; 3] {
    point.to_array().map(|c| (c + 0.5).floor() as i32)
}
