//! A picture of the page's data, and what it should show.

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;
use vdb_core::reference::Ray;

/// A picture, as `web/check.py` describes it.
#[derive(Deserialize)]
pub struct Case {
    /// The file of the picture.
    pub picture: PathBuf,
    /// The file with the grid, which is the only one in it.
    pub model: PathBuf,
    pub kind: Kind,
    /// Three numbers for the eye, three for the point it looks at, the vertical field of view in radians, the aspect.
    pub camera: [f64; 8],
    /// Of fog, per unit of density and world unit.
    pub extinction: f64,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    Voxels,
    Smooth,
    Fog,
}

impl Case {
    pub fn open(path: &Path) -> Result<Self, String> {
        let text =
            fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        serde_json::from_str(&text).map_err(|error| format!("{}: {error}", path.display()))
    }

    /// The ray through a point of the picture, in pixels from the top left, in index space. Its `t` is in world units.
    ///
    /// From first principles, to find mistakes in the page's own way.
    pub fn ray(&self, (x, y): (f64, f64), size: [u32; 2], index_from_world: DAffine3) -> Ray {
        let [eye_x, eye_y, eye_z, at_x, at_y, at_z, fov_y, aspect] = self.camera;
        let eye = DVec3::new(eye_x, eye_y, eye_z);
        let ahead = (DVec3::new(at_x, at_y, at_z) - eye).normalize();
        let right = ahead.cross(DVec3::Y).normalize();
        let axes = DMat3::from_cols(right, right.cross(ahead), ahead);
        let [width, height] = size.map(f64::from);
        let half = (0.5 * fov_y).tan();
        let on_screen = DVec3::new(
            (2.0 * x / width - 1.0) * half * aspect,
            (1.0 - 2.0 * y / height) * half,
            1.0,
        );
        let dir = (axes * on_screen).normalize();
        let origin = index_from_world.transform_point3(eye);
        Ray::from_f64(origin, index_from_world.transform_vector3(dir))
    }
}
