//! Rays from pixels.

use glam::{DVec2, DVec3, UVec2};

/// A camera in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Where it stands.
    pub eye: DVec3,
    /// A point that it looks at.
    pub target: DVec3,
    /// What is up in the picture, roughly; not along the view.
    pub up: DVec3,
    /// How rays leave it.
    pub projection: Projection,
}

/// How rays leave a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// From one point.
    Perspective {
        /// Angle between the lowest and the highest row's edge, in radians, below π.
        fov_y: f64,
    },
    /// In parallel.
    Orthographic {
        /// World length from the lowest to the highest row's edge.
        height: f64,
    },
}

impl Camera {
    /// The ray through the middle of a pixel (the first row is the top one): its origin, and its
    /// direction, of unit length.
    pub fn ray(&self, pixel: UVec2, size: UVec2) -> (DVec3, DVec3) {
        let forward = (self.target - self.eye).normalize();
        let right = forward.cross(self.up).normalize();
        let up = right.cross(forward);
        let size = size.as_dvec2();
        // From -1 to 1 over the height, y up, square pixels.
        let at = (2.0 * (pixel.as_dvec2() + 0.5) - size) / size.y * DVec2::new(1.0, -1.0);
        let offset = right * at.x + up * at.y;
        match self.projection {
            Projection::Perspective { fov_y } => {
                (self.eye, (forward + offset * (fov_y / 2.0).tan()).normalize())
            }
            Projection::Orthographic { height } => (self.eye + offset * (height / 2.0), forward),
        }
    }
}
