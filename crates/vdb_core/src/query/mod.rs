//! Ray casts and point samples in a grid on the CPU, for games and picking.
//!
//! Results match the rendered image. The cells that a ray touches are found by [`traverse`], the
//! exact twin of the shader's traversal. Within cells, samples come from the tree, or from the
//! packed grid if there is no tree, and the shader's f32 computations are done in f64: roots of the
//! trilinear interpolant as in `smooth.wgsl`, optical depth as in `fog.wgsl`.
//!
//! Points and rays are in *index space*, where sample `ijk` is the point `(i, j, k)` and voxel
//! `ijk` is the unit cube around it.

mod cubic;
mod fog;
mod index_ray;
mod local_ray;
mod samples;
mod smooth;

use std::ops::ControlFlow;

use glam::DVec3;

use crate::pack::{PackKind, PackedGrid, traverse};
use crate::tree::Vdb543;
use index_ray::nearest_voxel;
pub use index_ray::{IndexHit, IndexRay};
use local_ray::LocalRay;
use samples::Samples;

/// Queries of one grid, given as a tree and as the same tree packed, or packed alone.
#[derive(Clone, Copy, Debug)]
pub struct GridQuery<'a> {
    tree: Option<&'a Vdb543<f32>>,
    packed: &'a PackedGrid,
}

impl<'a> GridQuery<'a> {
    /// Queries of a tree. `packed` must have been made from `tree`.
    pub fn new(tree: &'a Vdb543<f32>, packed: &'a PackedGrid) -> Self {
        Self { tree: Some(tree), packed }
    }

    /// Queries of a grid whose tree is not at hand, as that of a [cooked file](crate::cooked). Rays
    /// and points in fog have the values that the GPU has. A smooth surface has values in the cells
    /// that it passes through, a surface of voxels has none.
    pub fn of_packed(packed: &'a PackedGrid) -> Self {
        Self { tree: None, packed }
    }

    /// The first hit on a ray, according to the grid's kind: a solid voxel, a root of the trilinear
    /// interpolant, or the point where `∫ density dt` from the origin exceeds `enough`.
    ///
    /// A ray is rounded near the grid, not at its origin: to 2⁻²⁴ voxels where it enters the grid's
    /// box, and to 2⁻²⁴ of the distance from there, however distant its origin is. A ray with
    /// non-finite numbers (other than an infinite `t_max`) hits nothing, nor does one so slow that
    /// the hit's `t` exceeds the largest f64.
    ///
    /// The time is proportional to the number of cubes that the ray crosses; empty cubes are at
    /// least as large as those of the tree. That is at most 3 · 4096 steps through each 4096³ node
    /// on its way, and some tens through the gap between two nodes. A tile of fog is one step,
    /// except for the cells at its border. The bound holds for any ray and any position of the grid
    /// in index space.
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
        // On extremely slow rays, the `t` of a hit can exceed the largest f64.
        hit.filter(|hit| hit.t.is_finite() && hit.t <= ray.t_max)
    }

    /// Calls `visit` for each part of a ray that lies within one cell of fog, or within one tile, in
    /// order: with the two ends of the part in units of `t`, and with its mean density. The optical
    /// depth of a part is exact, `σ · mean · length`. A surface has no fog.
    ///
    /// Rounding and time are those of [`GridQuery::first_hit`].
    pub fn visit_fog(&self, ray: &IndexRay, visit: impl FnMut([f64; 2], f64) -> ControlFlow<()>) {
        if self.packed.kind == PackKind::Fog
            && let Some(local) = LocalRay::new(self.packed, ray)
        {
            fog::visit(self.packed, &mut self.samples(), &local, ray.t_max, visit);
        }
    }

    /// The gradient of the interpolant, as the mean over one voxel along each axis, per voxel. Unlike
    /// the gradient itself, it has no jumps from cell to cell: a normal for shading. `None` where a
    /// surface without a tree has no value.
    pub fn smooth_gradient(&self, point: DVec3) -> Option<DVec3> {
        let mut samples = self.samples();
        let mut corners = |cell: DVec3| samples.corners(cell.to_array().map(|c| c as i64));
        // Three of the six points are in the same cell as this one.
        let own_cell = point.floor();
        let own = corners(own_cell)?;
        let mut at = |point: DVec3| {
            let cell = point.floor();
            let corners = if cell == own_cell { own } else { corners(cell)? };
            Some(corners.at(point - cell))
        };
        let mut gradient = DVec3::ZERO;
        for (axis, half) in [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| 0.5 * axis).iter().enumerate()
        {
            gradient[axis] = at(point + *half)? - at(point - *half)?;
        }
        Some(gradient)
    }

    fn samples(&self) -> Samples<'a> {
        Samples::new(self.tree, self.packed)
    }

    fn first_voxel(&self, local: &LocalRay) -> Option<IndexHit> {
        let hit = traverse::first_hit(self.packed, &local.ray)?;
        let ijk = hit.cell.wrapping_add(self.packed.base);
        let begins = hit.axis > 2;
        let mut normal = DVec3::ZERO;
        if begins && local.t_begin == 0.0 {
            return Some(IndexHit { t: 0.0, ijk, normal, begins_inside: true });
        }
        // If the box ends with the index space, a ray that enters the index space there begins in
        // the box.
        let axis = if begins { local.begin_axis } else { hit.axis as usize };
        normal[axis] = -f64::from(local.ray.dir[axis].signum());
        let way = if begins { 0.0 } else { local.face_t(hit.cell, axis) };
        Some(IndexHit { t: local.t_from_dda(way), ijk, normal, begins_inside: false })
    }

    /// The value of the sample nearest to a point, as displayed: densities are not negative, and
    /// NaNs are replaced. `None` where a surface without a tree has no value.
    pub fn nearest(&self, point: DVec3) -> Option<f32> {
        self.samples().value(nearest_voxel(point).map(i64::from))
    }

    /// The trilinear interpolant at a point, as displayed: densities are not negative, and NaNs are
    /// replaced. `None` where a surface without a tree has no value.
    pub fn trilinear(&self, point: DVec3) -> Option<f32> {
        let cell = point.floor();
        let corners = self.samples().corners(cell.to_array().map(|c| c as i64))?;
        Some(corners.at(point - cell) as f32)
    }

    /// Whether a point is inside: in a solid voxel, where the interpolant is below the iso-value of
    /// a smooth surface, or where the density is positive.
    pub fn contains(&self, point: DVec3) -> bool {
        match (self.packed.kind, self.tree) {
            (PackKind::Surface { iso }, Some(_)) => {
                self.nearest(point).is_some_and(|value| value < iso)
            }
            (PackKind::Surface { .. }, None) => {
                let ray = IndexRay { origin: point, dir: DVec3::X, t_max: 0.0 };
                self.first_hit(&ray, 0.0).is_some_and(|hit| hit.begins_inside)
            }
            (PackKind::Smooth { iso }, _) => match self.trilinear(point) {
                Some(value) => value < iso,
                None => self.leaves_surface(point),
            },
            (PackKind::Fog, _) => self.trilinear(point).is_some_and(|density| density > 0.0),
        }
    }

    /// Whether a ray from a point leaves the surface where it first meets it.
    fn leaves_surface(&self, point: DVec3) -> bool {
        let ray = IndexRay { origin: point, dir: DVec3::X, t_max: f64::INFINITY };
        self.first_hit(&ray, 0.0).is_some_and(|hit| hit.normal.dot(ray.dir) > 0.0)
    }
}
