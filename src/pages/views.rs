//! How large the voxels of a page are on the screens of cameras.

use bevy::camera::primitives::{Aabb, Frustum};
use bevy::math::{Affine3A, DAffine3, DVec3};
use bevy::prelude::*;
use vdb_core::pages::{PageId, PageIndex};

use crate::quality::pixel_size;

/// The factor for pages that only shadows and reflections show.
const OUT_OF_VIEW: f32 = 0.25;

/// A camera that displays volumes.
pub(super) struct Viewpoint<'a> {
    pub projection: &'a Projection,
    pub frustum: &'a Frustum,
    pub at: &'a GlobalTransform,
    /// Rows of pixels.
    pub height: u32,
}

/// A paged volume in the world, as cameras see it.
pub(super) struct Placed<'a> {
    index: &'a PageIndex,
    world_from_index: DAffine3,
    index_from_world: DAffine3,
    /// The edge of a voxel of the finest level in world units, along its longest axis.
    voxel: f64,
}

impl<'a> Placed<'a> {
    pub fn new(index: &'a PageIndex, at: &GlobalTransform) -> Self {
        let world_from_index = at.affine().as_daffine3() * index.world_from_index;
        let axes = world_from_index.matrix3;
        let voxel = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::length);
        Self {
            index,
            world_from_index,
            index_from_world: world_from_index.inverse(),
            voxel: voxel.into_iter().fold(0.0, f64::max),
        }
    }

    /// The size of a page's voxels on a camera's screen, in pixels, at the page's nearest point.
    pub fn voxel_pixels(&self, page: PageId, view: &Viewpoint) -> f32 {
        let (low, high) = self.index.index_bounds(page);
        let eye = self.index_from_world.transform_point3(view.at.translation().as_dvec3());
        let nearest = eye.clamp(low, high);
        let distance = self.world_from_index.transform_vector3(nearest - eye).length();
        let voxel = self.voxel * f64::from(page.level.min(1000)).exp2();
        let pixel = f64::from(pixel_size(view.projection, view.height, distance as f32));
        let size = (voxel / pixel.max(1e-30)).min(f64::from(f32::MAX)) as f32;
        let bounds = Aabb::from_min_max(low.as_vec3(), high.as_vec3());
        let is_in_view = view.frustum.intersects_obb(&bounds, &self.affine(), true, false);
        if is_in_view { size } else { OUT_OF_VIEW * size }
    }

    fn affine(&self) -> Affine3A {
        let own = self.world_from_index;
        Affine3A::from_mat3_translation(own.matrix3.as_mat3(), own.translation.as_vec3())
    }
}
