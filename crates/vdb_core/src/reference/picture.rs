//! Pictures by the reference tracer: level sets and fogs, one sun, ambient light, no GPU.

mod camera;
mod look;
mod shade;

use glam::{DAffine3, DVec3, UVec2, Vec3, Vec4};
use rayon::prelude::*;

pub use camera::{Camera, Projection};
pub use look::Look;
use shade::Prepared;

use super::{Blocky, Fog, Occupied, Smooth};
use crate::tree::{Node, Tree};

/// What to draw, in world space.
#[derive(Clone, Debug)]
pub struct Scene<'a, C: Node<Value = f32>> {
    /// The volumes; they may overlap.
    pub volumes: Vec<Volume<'a, C>>,
    /// The only light that has a direction.
    pub sun: SunLight,
    /// Radiance from everywhere, linear RGB.
    pub ambient: Vec3,
    /// What is behind everything, linear RGB and alpha.
    pub background: Vec4,
    /// Whether the sun throws shadows.
    pub shadows: bool,
    /// How surfaces scatter light.
    pub look: Look,
}

/// A light at infinity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunLight {
    /// Towards the sun, in world space; need not be of unit length.
    pub direction: DVec3,
    /// Radiance of a white Lambertian surface that faces the sun (irradiance over π), linear RGB.
    pub radiance: Vec3,
}

/// A grid somewhere in the world.
#[derive(Clone, Debug)]
pub struct Volume<'a, C: Node<Value = f32>> {
    /// The values.
    pub tree: &'a Tree<C>,
    /// From index space (the sample `ijk` at the point `(i, j, k)`) to world space.
    pub world_from_index: DAffine3,
    /// How it is shown.
    pub kind: VolumeKind,
}

/// How a volume is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VolumeKind {
    /// The surface where the trilinear interpolant passes through the iso-value.
    Smooth {
        /// The value on the surface.
        iso: f32,
        /// Diffuse reflectance, linear RGB.
        albedo: Vec3,
    },
    /// The voxels as boxes.
    Blocky {
        /// Which voxels there are.
        occupied: Occupied,
        /// Diffuse reflectance, linear RGB.
        albedo: Vec3,
    },
    /// Absorption, emission and scattering after Henyey and Greenstein.
    Fog {
        /// Extinction per unit of world length for a density of 1.
        extinction: f64,
        /// The part of extinction that is scattering, linear RGB.
        albedo: Vec3,
        /// Radiance emitted per unit of optical depth, linear RGB.
        emission: Vec3,
        /// The mean cosine of the angle by which scattering turns light; above -1 and below 1.
        anisotropy: f64,
    },
}

/// A picture, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row and rows.
    pub size: UVec2,
    /// Linear RGB, premultiplied, and alpha.
    pub color: Vec<Vec4>,
    /// World distance along each pixel's ray to the surface; infinite where there is none. Fog has
    /// no depth.
    pub depth: Vec<f32>,
}

/// Draws a scene, one ray through the middle of every pixel, rows in parallel.
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

/// The tracer of a volume.
enum Tracer<'a, C: Node<Value = f32>> {
    Smooth(Smooth<'a, C>, Vec3),
    Blocky(Blocky<'a, C>, Vec3),
    Fog { fog: Fog<'a, C>, extinction: f64, albedo: Vec3, emission: Vec3, anisotropy: f64 },
}
