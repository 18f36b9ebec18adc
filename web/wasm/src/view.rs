//! Cameras in the form that the shaders read.

use bytemuck::{Pod, Zeroable};
use glam::{DAffine3, DMat4, DVec3};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};

/// The height of fog over the ground, in radii.
const FLOAT_HEIGHT: f64 = 1.3;

/// A perspective camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    pub eye: DVec3,
    pub target: DVec3,
    /// The vertical field of view, in radians.
    pub fov_y: f64,
    /// Width divided by height.
    pub aspect: f64,
}

/// Mirrors the struct `View` of `web/shaders/scene.wgsl` field by field.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct View {
    rays: GpuRays,
    /// Directions of view rays in world space, per unit of `t`.
    dir: [f32; 3],
    /// The height of the eye over the ground, in world units.
    eye_height: f32,
    dir_x: [f32; 3],
    /// Half the diagonal of the volume's box, in world units.
    radius: f32,
    dir_y: [f32; 3],
    pad_a: f32,
    /// Columns of the matrix from gradients in index space to normals in world space.
    normal: [[f32; 4]; 3],
    /// Columns of the matrix from world space to lattice directions.
    lattice: [[f32; 4]; 3],
    /// The centre of the volume's box on the ground, from the eye.
    center: [f32; 2],
    pad_b: [f32; 2],
    /// The index-space cell that is local cell 0.
    base: [i32; 3],
    pad_c: i32,
}

impl Camera {
    fn world_from_view(&self) -> DAffine3 {
        DAffine3::look_at_rh(self.eye, self.target, DVec3::Y).inverse()
    }

    fn rays(&self) -> Option<ViewRays> {
        // Rays begin at the eye, wherever the near plane is.
        ViewRays::new(DMat4::perspective_infinite_reverse_rh(self.fov_y, self.aspect, 1e-3))
    }

    /// The ray through a point of the image, in world space: its origin, and its direction.
    pub fn ray(&self, ndc_x: f64, ndc_y: f64) -> Option<[DVec3; 2]> {
        let (rays, world_from_view) = (self.rays()?, self.world_from_view());
        let dir = rays.dir + ndc_x * rays.dir_x + ndc_y * rays.dir_y;
        Some([self.eye, world_from_view.transform_vector3(dir)])
    }

    /// The view of a grid within a box.
    pub fn view(
        &self,
        packed: &PackedGrid,
        world_from_index: DAffine3,
        [low, high]: [DVec3; 2],
    ) -> Result<View, String> {
        let rays = self.rays().ok_or("the camera has no rays")?;
        let world_from_view = self.world_from_view();
        let lattice = LatticeRays::new(&rays, world_from_view, world_from_index, packed)
            .map_err(|why| format!("the volume cannot be shown: {why}"))?;
        let dir = |v| world_from_view.transform_vector3(v).as_vec3().to_array();
        let columns = |m: glam::DMat3| {
            [m.x_axis, m.y_axis, m.z_axis].map(|column| column.as_vec3().extend(0.0).to_array())
        };
        let center = (low + high) * 0.5 - self.eye;
        let radius = (high - low).length() * 0.5;
        // Surfaces stand on the ground, and fog floats.
        let floats = if packed.kind == PackKind::Fog { FLOAT_HEIGHT * radius } else { 0.0 };
        Ok(View {
            rays: GpuRays::from(&lattice),
            dir: dir(rays.dir),
            eye_height: (self.eye.y - low.y + floats) as f32,
            dir_x: dir(rays.dir_x),
            radius: radius as f32,
            dir_y: dir(rays.dir_y),
            normal: columns(lattice.normal),
            lattice: columns(world_from_index.matrix3.inverse()),
            center: [center.x as f32, center.z as f32],
            base: packed.base.to_array(),
            ..View::default()
        })
    }
}
