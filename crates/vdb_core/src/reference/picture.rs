//! Images rendered by the reference tracer: level sets and fog, one sun, ambient light, no GPU.

mod camera;
mod look;
mod scene;
mod shade;

use glam::{UVec2, Vec4};
use rayon::prelude::*;

pub use camera::{Camera, Projection};
pub use look::Look;
pub use scene::{Scene, SunLight, Volume, VolumeKind};
use shade::Prepared;

use crate::tree::Node;

/// An image, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width and height in pixels.
    pub size: UVec2,
    /// Linear RGB, premultiplied by alpha, and alpha.
    pub color: Vec<Vec4>,
    /// World distance along each pixel's ray to the surface; infinite if there is none. Fog has no
    /// depth.
    pub depth: Vec<f32>,
}

/// Renders a scene with one ray through the centre of each pixel, rows in parallel.
pub fn render<C: Node<Value = f32>>(scene: &Scene<'_, C>, camera: &Camera, size: UVec2) -> Picture {
    let prepared = Prepared::new(scene);
    let pixels: Vec<(Vec4, f32)> = (0..size.y)
        .into_par_iter()
        .flat_map_iter(|y| {
            let prepared = &prepared;
            (0..size.x).map(move |x| {
                let (origin, direction) = camera.ray(UVec2::new(x, y), size);
                prepared.trace(origin, direction)
            })
        })
        .collect();
    let (color, depth) = pixels.into_iter().unzip();
    Picture { size, color, depth }
}
