//! Cameras, which generate rays from pixels.

use glam::{DVec2, DVec3, UVec2};

/// A camera in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The position of the camera.
    pub eye: DVec3,
    /// A point that the camera looks at.
    pub target: DVec3,
    /// The approximate up direction in the image; not parallel to the view direction.
    pub up: DVec3,
    /// The projection.
    pub projection: Projection,
}

/// The projection of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Rays from one point.
    Perspective {
        /// The vertical field of view between the outer edges of the image, in radians, below π.
        fov_y: f64,
    },
    /// Parallel rays.
    Orthographic {
        /// The height of the image in world units.
        height: f64,
    },
}

impl Camera {
    /// The ray through the centre of a pixel (the first row is the top one): its origin, and its
    /// direction of unit length.
    pub fn ray(&self, pixel: UVec2, size: UVec2) -> (DVec3, DVec3) {
        let forward = (self.target - self.eye).normalize();
        let right = forward.cross(self.up).normalize();
        let up = right.cross(forward);
        let size = size.as_dvec2();
        // From -1 to 1 over the height, y up, with square pixels.
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
