//! What is drawn.

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::look::Look;
use crate::reference::Occupied;
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
