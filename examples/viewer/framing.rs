//! The position of the camera.

use bevy::math::DVec3;
use bevy::transform::components::Transform;
use bevy_vdb::VdbRenderMode;
use bevy_vdb::vdb_core::reference::picture::{Camera, Projection};

use crate::args::Args;

/// The default direction from the target to the camera.
const DIRECTION: DVec3 = DVec3::new(0.45, 0.35, 0.82);

/// A camera, and the bounds of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub eye: DVec3,
    pub target: DVec3,
    /// The vertical field of view in radians.
    pub fov_y: f64,
    /// The lowest and the highest corner of everything displayed.
    pub bounds: (DVec3, DVec3),
    /// The distance of the near plane.
    pub near: f64,
}

impl View {
    /// The requested view; by default, everything is in the image.
    pub fn new(args: &Args, bounds: (DVec3, DVec3)) -> Self {
        let middle = (bounds.0 + bounds.1) / 2.0;
        let target = args.target.unwrap_or(middle);
        let eye = args.eye.unwrap_or_else(|| {
            let direction = DIRECTION.normalize();
            target + direction * fit(args, bounds, target, direction)
        });
        let radius = ((bounds.1 - bounds.0).length() / 2.0).max(f64::from(f32::MIN_POSITIVE));
        // An eye far outside gets a near plane to match: f32 resolves depth in proportion to it.
        let near = 1e-3 * radius.max(0.1 * eye.distance(middle));
        // The mode shows the depth buffer, near / distance, which would be black with this near
        // plane.
        let near = match args.mode {
            VdbRenderMode::Depth => near.max(0.9 * (eye.distance(middle) - radius)),
            _ => near,
        };
        Self { eye, target, fov_y: args.fov_y, bounds, near }
    }

    /// The radius of the ball around the bounds.
    pub fn radius(&self) -> f64 {
        (self.bounds.1 - self.bounds.0).length() / 2.0
    }

    /// The transform of the camera.
    pub fn transform(&self) -> Transform {
        Transform::from_translation(self.eye.as_vec3())
            .looking_at(self.target.as_vec3(), self.up().as_vec3())
    }

    /// The up direction of the image: y, unless the camera looks along it.
    pub fn up(&self) -> DVec3 {
        let forward = (self.target - self.eye).normalize_or(DVec3::NEG_Z);
        if forward.cross(DVec3::Y).length() < 1e-3 { DVec3::NEG_Z } else { DVec3::Y }
    }

    /// The camera for the reference tracer.
    pub fn camera(&self) -> Camera {
        Camera {
            eye: self.eye,
            target: self.target,
            up: self.up(),
            projection: Projection::Perspective { fov_y: self.fov_y },
        }
    }
}

/// The smallest distance from the target at which all corners of the box are in the image.
fn fit(args: &Args, (low, high): (DVec3, DVec3), target: DVec3, direction: DVec3) -> f64 {
    let right = DVec3::Y.cross(direction).normalize();
    let up = direction.cross(right);
    let tan_y = (args.fov_y / 2.0).tan();
    let tan_x = tan_y * f64::from(args.size.x) / f64::from(args.size.y);
    let distances = (0..8).map(|i| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
        let corner = DVec3::new(pick(0), pick(1), pick(2)) - target;
        let beside = (corner.dot(right).abs() / tan_x).max(corner.dot(up).abs() / tan_y);
        corner.dot(direction) + beside
    });
    distances.fold(0.0, f64::max).max((high - low).length() * 1e-3)
}
