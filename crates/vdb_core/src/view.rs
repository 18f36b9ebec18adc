//! Rays of a view, computed in f64 from a camera and transforms. The GPU gets an integer cell, a
//! fraction and directions, so that precision does not depend on a grid's position in the world or
//! in index space.

use bytemuck::{Pod, Zeroable};
use glam::{DAffine3, DMat3, DMat4, DVec3, IVec3, Vec2, Vec3};

use crate::pack::{PackedGrid, traverse};

/// The rays of a view, in view space. Through a point of the image in normalised device
/// coordinates, `p(t) = (eye + ndc.x·eye_x + ndc.y·eye_y) + t·(dir + ndc.x·dir_x +
/// ndc.y·dir_y)`, with `t` the depth along the view axis.
#[derive(Clone, Copy, Debug)]
pub struct ViewRays {
    /// The origin of the ray through the centre of the image.
    pub eye: DVec3,
    /// The change of the origin with `ndc.x`; zero except in orthographic views.
    pub eye_x: DVec3,
    /// The change of the origin with `ndc.y`.
    pub eye_y: DVec3,
    /// The direction of the ray through the centre, per unit of `t`.
    pub dir: DVec3,
    /// The change of the direction with `ndc.x`.
    pub dir_x: DVec3,
    /// The change of the direction with `ndc.y`.
    pub dir_y: DVec3,
    /// `t = -(x·depth + y) / (z·depth + w)`
    pub t_from_depth: [f64; 4],
    /// `depth = (x·t + y) / (z·t + w)`
    pub depth_from_t: [f64; 4],
    /// The `t` of the near plane.
    pub t_near: f64,
    /// The `t` of the far plane; 10³⁰ if there is none.
    pub t_far: f64,
}

/// The `t` of points at infinity.
const FAR: f64 = 1e30;

impl ViewRays {
    /// The rays of a projection; `None` if it cannot be inverted.
    pub fn new(clip_from_view: DMat4) -> Option<Self> {
        let view_from_clip = clip_from_view.inverse();
        if !view_from_clip.is_finite() {
            return None;
        }
        let m = &view_from_clip;
        let orthographic = clip_from_view.z_axis.w == 0.0;
        let t_from_depth = [m.z_axis.z, m.w_axis.z, m.z_axis.w, m.w_axis.w];
        let t_of = |depth: f64| {
            let [x, y, z, w] = t_from_depth;
            if z * depth + w == 0.0 { FAR } else { -(x * depth + y) / (z * depth + w) }
        };
        let p = &clip_from_view;
        // The unprojected point is linear in ndc up to its fourth coordinate, which scales a ray
        // through the origin and does not affect a parallel ray.
        let at = (m.z_axis * 0.5 + m.w_axis).truncate();
        let (at_x, at_y) = (m.x_axis.truncate(), m.y_axis.truncate());
        let flat = |v: DVec3| DVec3::new(v.x, v.y, 0.0);
        let ([eye, eye_x, eye_y], [dir, dir_x, dir_y]) = if orthographic {
            ([at, at_x, at_y].map(flat), [DVec3::NEG_Z, DVec3::ZERO, DVec3::ZERO])
        } else {
            ([DVec3::ZERO; 3], [at, at_x, at_y].map(|v| v / -at.z))
        };
        let rays = Self {
            eye,
            eye_x,
            eye_y,
            dir,
            dir_x,
            dir_y,
            t_from_depth,
            depth_from_t: [-p.z_axis.z, p.w_axis.z, -p.z_axis.w, p.w_axis.w],
            t_near: t_of(1.0),
            t_far: t_of(0.0),
        };
        (rays.dir.is_finite() && rays.eye.is_finite()).then_some(rays)
    }
}

/// The rays of a view in the local lattice coordinates of a grid; see [`ViewRays`].
#[derive(Clone, Copy, Debug)]
pub struct LatticeRays {
    /// The cell of the eye.
    pub eye_cell: IVec3,
    /// The position of the eye in that cell, from 0 up to but not including 1.
    pub eye_frac: DVec3,
    /// The change of the eye with `ndc.x`, in cells.
    pub eye_x: DVec3,
    /// The change of the eye with `ndc.y`, in cells.
    pub eye_y: DVec3,
    /// The direction at the centre of the image, in cells per unit of `t`.
    pub dir: DVec3,
    /// The change of the direction with `ndc.x`.
    pub dir_x: DVec3,
    /// The change of the direction with `ndc.y`.
    pub dir_y: DVec3,
    /// The matrix from gradients in index space to world-space normals, of any length.
    pub normal: DMat3,
}

/// The reason why a volume cannot be shown from a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CannotShow {
    /// The entity's transform is not finite or has no inverse.
    Singular,
    /// The camera is more than 2³⁰ voxels away.
    TooFar,
    /// A unit of the view's depth is less than 2⁻³⁰ voxels.
    TooLarge,
    /// A unit of the view's depth is more than 2³⁰ voxels.
    TooSmall,
}

impl CannotShow {
    /// All reasons.
    pub const ALL: [Self; 4] = [Self::Singular, Self::TooFar, Self::TooLarge, Self::TooSmall];
}

impl std::fmt::Display for CannotShow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Singular => "its transform has a scale of zero or is not finite",
            Self::TooFar => "the camera is more than 2³⁰ of its voxels away from it",
            Self::TooLarge => "its voxels are larger than 2³⁰ world units; scale it down",
            Self::TooSmall => "its voxels are smaller than 2⁻³⁰ world units; scale it up",
        })
    }
}

/// The greatest distance of an eye, in cells, for which it has an integer cell.
const MAX_CELL: f64 = (1 << 30) as f64;
/// The greatest speed in cells per unit of `t`; its inverse is the least.
const MAX_SPEED: f64 = (1 << 30) as f64;

impl LatticeRays {
    /// The rays of a view through a grid.
    ///
    /// # Errors
    /// If the numbers exceed the range of a shader's arithmetic.
    pub fn new(
        rays: &ViewRays,
        world_from_view: DAffine3,
        world_from_index: DAffine3,
        grid: &PackedGrid,
    ) -> Result<Self, CannotShow> {
        let index_from_world = world_from_index.inverse();
        if !index_from_world.is_finite() || !world_from_index.is_finite() {
            return Err(CannotShow::Singular);
        }
        let index_from_view = index_from_world * world_from_view;
        let to_lattice = grid.base.as_dvec3() + grid.kind.lattice_origin();
        let eye = index_from_view.transform_point3(rays.eye) - to_lattice;
        let linear = |v: DVec3| index_from_view.transform_vector3(v);
        let farthest = eye.abs() + linear(rays.eye_x).abs() + linear(rays.eye_y).abs();
        if eye.is_nan() || farthest.max_element() > MAX_CELL {
            return Err(CannotShow::TooFar);
        }
        let normal = index_from_world.matrix3.transpose();
        let largest = normal.to_cols_array().into_iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let rays = Self {
            eye_cell: eye.floor().as_ivec3(),
            eye_frac: eye - eye.floor(),
            eye_x: linear(rays.eye_x),
            eye_y: linear(rays.eye_y),
            dir: linear(rays.dir),
            dir_x: linear(rays.dir_x),
            dir_y: linear(rays.dir_y),
            // Scaled so that squares computed by the shader stay within f32.
            normal: normal * (1.0 / largest),
        };
        let corners = [(0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
        let speed = |(x, y)| rays.dir_at(x, y).abs().max_element();
        let speeds = corners.map(speed);
        if speeds.iter().any(|&speed| speed < 1.0 / MAX_SPEED) {
            return Err(CannotShow::TooLarge);
        }
        if speeds.iter().any(|&speed| speed > MAX_SPEED) {
            return Err(CannotShow::TooSmall);
        }
        Ok(rays)
    }

    /// The direction of the ray through a point of the image, in cells per unit of `t`.
    pub fn dir_at(&self, ndc_x: f64, ndc_y: f64) -> DVec3 {
        self.dir + ndc_x * self.dir_x + ndc_y * self.dir_y
    }

    /// The origin of the ray through a point of the image, relative to the cell of the eye.
    pub fn start_at(&self, ndc_x: f64, ndc_y: f64) -> DVec3 {
        self.eye_frac + ndc_x * self.eye_x + ndc_y * self.eye_y
    }

    /// Whether the rays of neighbouring pixels, in an image of this width, are closer together than
    /// f32 can distinguish: the image is correct, but coarse.
    pub fn is_coarse(&self, width: u32) -> bool {
        let pixel = 2.0 * self.dir_x.length() / f64::from(width.max(1));
        pixel > 0.0 && pixel < self.dir.length() / f64::from(1 << 24)
    }
}

/// The rays of a grid in f32, which mirror the struct `Rays` of `assets/shaders/gpu/types.wgsl`
/// field by field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuRays {
    /// The cell of the eye.
    pub eye_cell: [i32; 3],
    pad_0: f32,
    /// The position of the eye in that cell, from 0 to 1.
    pub eye_frac: [f32; 3],
    pad_1: f32,
    /// The change of the eye with `ndc.x`.
    pub eye_x: [f32; 3],
    pad_2: f32,
    /// The change of the eye with `ndc.y`.
    pub eye_y: [f32; 3],
    pad_3: f32,
    /// The direction at the centre of the image.
    pub dir: [f32; 3],
    pad_4: f32,
    /// The remainder of the direction after rounding to f32.
    pub dir_rest: [f32; 3],
    pad_5: f32,
    /// The change of the direction with `ndc.x`.
    pub dir_x: [f32; 3],
    pad_6: f32,
    /// The change of the direction with `ndc.y`.
    pub dir_y: [f32; 3],
    pad_7: f32,
}

impl From<&LatticeRays> for GpuRays {
    fn from(rays: &LatticeRays) -> Self {
        let array = |v: DVec3| v.as_vec3().to_array();
        Self {
            eye_cell: rays.eye_cell.to_array(),
            eye_frac: array(rays.eye_frac),
            eye_x: array(rays.eye_x),
            eye_y: array(rays.eye_y),
            dir: array(rays.dir),
            dir_rest: array(rays.dir - rays.dir.as_vec3().as_dvec3()),
            dir_x: array(rays.dir_x),
            dir_y: array(rays.dir_y),
            ..Self::default()
        }
    }
}

impl GpuRays {
    /// The ray through a point of the image: the twin of `ray_through` in
    /// `assets/shaders/traversal/rays.wgsl`.
    ///
    /// The error of each component of the direction is at most the same component of
    /// `2⁻²⁴ |dir| + 2⁻²⁰ (|dir_x| + |dir_y|)`: the rounding of the sum and, on the GPU, of `ndc`
    /// and of the products. The error of each component of the origin is at most
    /// `1.5 · 2⁻²⁴ + 2⁻²⁰ (|eye_x| + |eye_y|)`: the rounding of the fraction to f32 and then down
    /// to 24 bits and, in orthographic views, of `ndc` and of the products.
    pub fn ray_through(&self, ndc: Vec2, t_min: f32, t_max: f32) -> traverse::Ray {
        let vector = Vec3::from_array;
        let start = ndc.x * vector(self.eye_x) + ndc.y * vector(self.eye_y);
        let eye = vector(self.eye_frac) + start;
        let whole = eye.floor();
        let units = (1 << 24) as f32;
        let turn = vector(self.dir_rest) + ndc.x * vector(self.dir_x) + ndc.y * vector(self.dir_y);
        traverse::Ray {
            cell: IVec3::from_array(self.eye_cell) + whole.as_ivec3(),
            // 24 bits, because the traversal compares planes in units of 2⁻²⁴ cells. For a
            // difference just below a whole number, the subtraction rounds up to 1.
            frac: ((eye - whole) * units).floor().min(Vec3::splat(units - 1.0)) / units,
            dir: vector(self.dir) + turn,
            t_min,
            t_max,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::PackKind;
    use crate::tree::Vdb543;
    use glam::{DVec2, Mat4};

    fn check(clip_from_view: Mat4) {
        let clip_from_view = clip_from_view.as_dmat4();
        let rays = ViewRays::new(clip_from_view).unwrap();
        for ndc in [DVec2::ZERO, DVec2::new(0.7, -0.9), DVec2::new(-1.0, 1.0)] {
            for t in [0.5, 3.0, 80.0] {
                let at = rays.eye
                    + rays.eye_x * ndc.x
                    + rays.eye_y * ndc.y
                    + (rays.dir + rays.dir_x * ndc.x + rays.dir_y * ndc.y) * t;
                assert!((at.z + t).abs() < 1e-6 * t, "t is the depth: {at} at {t}");
                let clip = clip_from_view * at.extend(1.0);
                let back = clip.truncate() / clip.w;
                assert!((back.truncate() - ndc).length() < 1e-5, "{back} for {ndc}");
                let [x, y, z, w] = rays.depth_from_t;
                let depth = (x * t + y) / (z * t + w);
                assert!((depth - back.z).abs() < 1e-7, "{depth} for {}", back.z);
                let [x, y, z, w] = rays.t_from_depth;
                let again = -(x * back.z + y) / (z * back.z + w);
                assert!((again - t).abs() < 1e-4 * t, "{again} for {t}");
            }
        }
        assert!((rays.t_near - 0.1).abs() < 1e-6);
    }

    #[test]
    fn perspective() {
        check(Mat4::perspective_infinite_reverse_rh(0.8, 1.7, 0.1));
        let rays =
            ViewRays::new(Mat4::perspective_infinite_reverse_rh(0.8, 1.7, 0.1).as_dmat4()).unwrap();
        assert_eq!(rays.t_far, FAR);
    }

    #[test]
    fn perspective_with_a_far_plane_and_an_oblique_centre() {
        let mut m = Mat4::perspective_rh(0.8, 1.7, 100.0, 0.1);
        m.z_axis.x = 0.3;
        m.z_axis.y = -0.2;
        check(m);
    }

    #[test]
    fn orthographic() {
        check(Mat4::orthographic_rh(-3.0, 5.0, -2.0, 2.5, 100.0, 0.1));
    }

    #[test]
    fn a_camera_far_out_keeps_its_fraction() {
        let mut tree = Vdb543::new(0.0);
        let far = IVec3::new(1 << 30, -(1 << 30), 12345);
        tree.set(far, 1.0);
        let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let rays =
            ViewRays::new(Mat4::perspective_infinite_reverse_rh(0.8, 1.0, 0.1).as_dmat4()).unwrap();
        let eye = far.as_dvec3() + DVec3::new(0.125, 100.25, -7.5);
        let view = DAffine3::from_translation(eye);
        let lattice = LatticeRays::new(&rays, view, DAffine3::IDENTITY, &grid).unwrap();
        assert_eq!(lattice.eye_frac, DVec3::new(0.125, 0.25, 0.5));
        assert_eq!(lattice.eye_cell + grid.base, far + IVec3::new(0, 100, -8));
    }

    #[test]
    fn a_fraction_stays_below_one() {
        // In an orthographic view, just left of a cell's face.
        let rays = GpuRays { eye_x: [1e-12; 3], dir: [0.0, 0.0, -1.0], ..GpuRays::default() };
        let ray = rays.ray_through(Vec2::NEG_X, 0.0, 1.0);
        assert_eq!(ray.cell, IVec3::NEG_ONE);
        assert_eq!(ray.frac, Vec3::splat(1.0 - 2.0_f32.powi(-24)));
    }

    #[test]
    fn narrow_views_are_coarse_from_some_width_on() {
        let mut tree = Vdb543::new(0.0);
        tree.set(IVec3::ZERO, 1.0);
        let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let lattice = |clip_from_view: DMat4| {
            let rays = ViewRays::new(clip_from_view).unwrap();
            let view = DAffine3::from_translation(DVec3::Z * 1e5);
            LatticeRays::new(&rays, view, DAffine3::IDENTITY, &grid).unwrap()
        };
        // 0.01° are 1.7e-4 rad: 2,928 steps of 2⁻²⁴.
        let narrow = DMat4::perspective_infinite_reverse_rh(0.01_f64.to_radians(), 1.0, 0.1);
        assert!(!lattice(narrow).is_coarse(2_900));
        assert!(lattice(narrow).is_coarse(2_950));
        let wide = DMat4::perspective_infinite_reverse_rh(1.0_f64.to_radians(), 1.0, 0.1);
        assert!(!lattice(wide).is_coarse(16_384));
        let parallel = DMat4::orthographic_rh(-1e-3, 1e-3, -1e-3, 1e-3, 10.0, 0.1);
        assert!(!lattice(parallel).is_coarse(16_384), "its rays differ in where they begin");
    }

    #[test]
    fn what_cannot_be_shown_says_why() {
        let mut tree = Vdb543::new(0.0);
        tree.set(IVec3::ZERO, 1.0);
        let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let rays = ViewRays::new(DMat4::perspective_infinite_reverse_rh(0.8, 1.0, 0.1)).unwrap();
        let show = |view: DAffine3, world: DAffine3| {
            LatticeRays::new(&rays, view, world, &grid).map(|_| ()).unwrap_err()
        };
        let far = DAffine3::from_translation(DVec3::X * 3e9);
        assert_eq!(show(far, DAffine3::IDENTITY), CannotShow::TooFar);
        let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
        assert_eq!(show(DAffine3::IDENTITY, flat), CannotShow::Singular);
        let scaled = |scale| DAffine3::from_scale(DVec3::splat(scale));
        assert_eq!(show(DAffine3::IDENTITY, scaled(2e9)), CannotShow::TooLarge);
        assert_eq!(show(DAffine3::IDENTITY, scaled(1e-10)), CannotShow::TooSmall);
    }
}
