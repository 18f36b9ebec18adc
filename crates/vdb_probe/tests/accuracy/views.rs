//! The views of the matrix: cameras at every distance, at every place of index space, through every
//! kind of transform and projection, aimed so that the grid fills the picture.

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec2, DVec3, EulerRot};
use vdb_core::pack::PackedGrid;
use vdb_core::synth::Random;
use vdb_core::view::{CannotShow, LatticeRays, ViewRays};

use crate::grids::{BALL, OFFSETS, at_offset};

/// Voxels from the surface to the eye; at 0 the eye is inside a voxel of the surface.
pub const DISTANCES: [(&str, f64); 6] =
    [("0", 0.0), ("1e-3", 1e-3), ("1", 1.0), ("1e3", 1e3), ("1e5", 1e5), ("1e7", 1e7)];

/// World units along the edge of a voxel.
pub const SIZES: [f64; 7] = [1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6];

/// Degrees from the lower to the upper end of the picture; 0: a parallel projection.
pub const FIELDS: [f64; 6] = [0.01, 1.0, 60.0, 120.0, 175.0, 0.0];

/// What else a transform does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    Plain,
    Rotated,
    Mirrored,
    Sheared,
    /// 1 : 1000.
    Flat,
}

pub const SHAPES: [Shape; 5] =
    [Shape::Plain, Shape::Rotated, Shape::Mirrored, Shape::Sheared, Shape::Flat];

impl Shape {
    /// A lower bound of how much it stretches any length.
    pub fn least(self) -> f64 {
        match self {
            Self::Plain | Self::Rotated | Self::Mirrored => 1.0,
            Self::Sheared => 0.3,
            Self::Flat => 1e-3,
        }
    }

    fn matrix(self) -> DMat3 {
        let turn = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.7, -1.9, 0.4));
        match self {
            Self::Plain => DMat3::IDENTITY,
            Self::Rotated => turn,
            Self::Mirrored => turn * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)),
            Self::Sheared => {
                DMat3::from_cols(DVec3::X, DVec3::new(0.8, 1.0, 0.0), DVec3::new(-0.5, 0.3, 1.0))
            }
            Self::Flat => turn * DMat3::from_diagonal(DVec3::new(1.0, 1e-3, 0.1)),
        }
    }
}

/// One picture.
#[derive(Clone, Copy, Debug)]
pub struct View {
    pub distance: f64,
    pub offset: i32,
    pub size: f64,
    pub shape: Shape,
    pub field: f64,
    /// Where the eye is from the ball's centre, in index space; unit.
    from: DVec3,
    /// Where in the whole picture the ball stands, in normalised device coordinates.
    place: DVec2,
}

/// All of them: every distance at every offset, by every size and every field of view; shapes take
/// turns. For a distance and an offset, by their numbers.
pub fn all(seed: u64) -> impl Iterator<Item = (usize, usize, View)> {
    let mut random = Random::new(seed);
    let mut number = 0;
    let mut views = Vec::new();
    for (d, (_, distance)) in DISTANCES.into_iter().enumerate() {
        for (o, (_, offset)) in OFFSETS.into_iter().enumerate() {
            for size in SIZES {
                for field in FIELDS {
                    number += 1;
                    let mut vector = || DVec3::from_array([0; 3].map(|_| random.range(-1.0, 1.0)));
                    let mut from = vector().normalize();
                    if offset.unsigned_abs() > 1 << 30 {
                        // Where there is index space to stand in.
                        from = from.abs() * -f64::from(offset.signum());
                    }
                    let place = DVec2::new(random.range(-0.9, 0.9), random.range(-0.9, 0.9));
                    let shape = SHAPES[number % SHAPES.len()];
                    views.push((d, o, View { distance, offset, size, shape, field, from, place }));
                }
            }
        }
    }
    views.into_iter()
}

/// A view's numbers: in f64, as a camera and a transform give them.
pub struct Camera {
    pub rays: ViewRays,
    pub world_from_view: DAffine3,
    pub world_from_index: DAffine3,
    /// From the coordinates of the part of the picture that is seen to those on a plane one world
    /// unit before the eye (of a parallel projection: on the near plane): factor and middle.
    plane: (f64, DVec2),
}

impl View {
    /// The camera; `None` where its projection cannot be inverted.
    pub fn camera(&self) -> Option<Camera> {
        let center = at_offset(self.offset);
        let eye = center + self.from * (BALL + self.distance);
        let world_from_index = DAffine3::from_mat3(self.shape.matrix() * self.size);
        let to_eye = world_from_index.transform_vector3(eye - center);
        let (axis, reach) = (to_eye.normalize(), to_eye.length());
        let edges = world_from_index.matrix3.to_cols_array_2d().map(DVec3::from_array);
        let radius = 1.1 * BALL * edges.map(DVec3::length).into_iter().fold(0.0, f64::max);
        let near = reach * 1e-3;
        let is_parallel = self.field == 0.0;
        let half = if is_parallel { radius } else { (self.field.to_radians() / 2.0).tan() };
        // Towards the ball in view space; a camera that sees more than it looks past it.
        let towards = if is_parallel { DVec3::NEG_Z } else { (self.place * half).extend(-1.0) };
        let seen = if is_parallel { half } else { radius / reach * towards.length() };
        let zoom = (half / seen).max(1.0);
        let middle = if zoom > 1.0 { self.place } else { DVec2::ZERO };
        let towards = if zoom > 1.0 { towards } else { DVec3::NEG_Z };
        let clip_from_view = if is_parallel {
            DMat4::orthographic_rh(-half, half, -half, half, 4.0 * (reach + radius), near)
        } else {
            DMat4::perspective_infinite_reverse_rh(self.field.to_radians(), 1.0, near)
        };
        // The part of the picture that the ball fills, cut out of the whole.
        let crop = DMat4::from_scale(DVec3::new(zoom, zoom, 1.0))
            * DMat4::from_translation((-middle).extend(0.0));
        let up = axis.any_orthonormal_vector();
        let turn = DMat3::from_quat(DQuat::from_rotation_arc(towards.normalize(), DVec3::NEG_Z));
        let world_from_view = DAffine3 {
            matrix3: DMat3::from_cols(up.cross(axis), up, axis) * turn,
            translation: world_from_index.transform_point3(eye),
        };
        let rays = ViewRays::new(crop * clip_from_view)?;
        let plane = (half / zoom, middle * half);
        Some(Camera { rays, world_from_view, world_from_index, plane })
    }
}

impl Camera {
    /// The rays of the view through a grid.
    pub fn lattice(&self, grid: &PackedGrid) -> Result<LatticeRays, CannotShow> {
        LatticeRays::new(&self.rays, self.world_from_view, self.world_from_index, grid)
    }

    /// How far the rays of the view, in f64, are from where the camera's own numbers say they are, in
    /// parts of the picture's half width.
    pub fn off(&self, grid: &PackedGrid, lattice: &LatticeRays, x: f64, y: f64) -> f64 {
        let (scale, middle) = self.plane;
        let at = DVec2::new(x, y) * scale + middle;
        let view_from_index = (self.world_from_index.inverse() * self.world_from_view).inverse();
        let dir = view_from_index.transform_vector3(lattice.dir_at(x, y));
        let seen = if self.rays.eye_x == DVec3::ZERO {
            dir.truncate() / -dir.z
        } else {
            let eye = lattice.eye_cell.as_dvec3() + lattice.start_at(x, y) + grid.base.as_dvec3();
            let eye = eye + grid.kind.lattice_origin();
            view_from_index.transform_point3(eye).truncate()
        };
        (seen - at).length() / scale
    }
}
