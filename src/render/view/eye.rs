//! The eye of a view, and how much of a grid its pixels cover, from which levels of detail follow.

use bevy::math::{DAffine3, DVec2, DVec3};
use bevy::prelude::*;
use vdb_core::view::ViewRays;

use crate::asset::corners;

/// The rays, the transform and the image size in pixels of a view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Eye<'a> {
    pub rays: &'a ViewRays,
    pub world_from_view: DAffine3,
    pub size: UVec2,
}

impl Eye<'_> {
    /// The smallest and largest depths along the view axis of a box in index space, clamped to the near plane.
    pub fn depths(&self, world_from_index: DAffine3, bounds: (DVec3, DVec3)) -> [f64; 2] {
        let view_from_index = self.world_from_view.inverse() * world_from_index;
        let depths = corners(bounds).map(|at| -view_from_index.transform_point3(at).z);
        let [near, far] =
            depths.fold([f64::INFINITY, 0.0], |[near, far], t| [near.min(t), far.max(t)]);
        [near, far].map(|depth| depth.max(self.rays.t_near))
    }

    /// The width and the height of a pixel at a depth along the view axis, in world units.
    pub fn pixel_edges(&self, depth: f64) -> DVec2 {
        let rays = self.rays;
        let half = [rays.eye_x + depth * rays.dir_x, rays.eye_y + depth * rays.dir_y];
        2.0 * DVec2::from(half.map(|edge| edge.length())) / self.size.as_dvec2()
    }
}

/// How many times larger the voxels of a grid could be and still cover no more pixels than they may, as a function of
/// the depth along the view axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// The factor at a depth of 0 …
    at_eye: f64,
    /// … and what is added to it per unit of depth. One of the two is 0: pixels of perspective cameras begin in a
    /// point, and those of orthographic ones do not grow.
    per_depth: f64,
}

impl Footprint {
    /// The footprint if a voxel may cover `detail` pixels.
    pub fn new(eye: Eye, world_from_index: DAffine3, detail: f64) -> Self {
        let axes = (eye.world_from_view.inverse() * world_from_index).matrix3;
        let edges = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.length());
        let voxel = edges.into_iter().fold(0.0, f64::max);
        let factor = |pixel: DVec2| {
            let factor = detail * pixel.min_element() / voxel;
            if factor.is_finite() { factor } else { 0.0 }
        };
        let at_eye = eye.pixel_edges(0.0);
        Self { at_eye: factor(at_eye), per_depth: factor(eye.pixel_edges(1.0) - at_eye) }
    }

    /// The coarsest level whose voxels are small enough at a depth, of `most` coarser ones.
    pub fn level(&self, depth: f64, most: usize) -> usize {
        let level = (self.at_eye + depth * self.per_depth).log2();
        // Conversions saturate, and turn NaN into 0.
        (level as usize).min(most)
    }

    /// The depth from which on the voxels of a level are small enough; `None` for orthographic cameras, to which all
    /// depths are alike.
    pub fn depth(&self, level: usize) -> Option<f32> {
        let depth = (level as f64).exp2() / self.per_depth;
        (self.at_eye == 0.0 && depth.is_finite()).then_some(depth as f32)
    }
}
