//! Scenes.

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::look::Look;
use crate::reference::Occupied;
use crate::tree::{Node, Tree};

/// A scene to render, in world space.
#[derive(Clone, Debug)]
pub struct Scene<'a, C: Node<Value = f32>> {
    /// The volumes; they may overlap.
    pub volumes: Vec<Volume<'a, C>>,
    /// The only directional light.
    pub sun: SunLight,
    /// Radiance from all directions, linear RGB.
    pub ambient: Vec3,
    /// The background, linear RGB and alpha.
    pub background: Vec4,
    /// Whether the sun casts shadows.
    pub shadows: bool,
    /// The reflection model of surfaces.
    pub look: Look,
}

/// A light at infinity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunLight {
    /// The direction towards the sun in world space, of any length.
    pub direction: DVec3,
    /// Radiance of a white Lambertian surface facing the sun (irradiance over π), linear RGB.
    pub radiance: Vec3,
}

/// A grid placed in the world.
#[derive(Clone, Debug)]
pub struct Volume<'a, C: Node<Value = f32>> {
    /// The values.
    pub tree: &'a Tree<C>,
    /// The transform from index space (sample `ijk` at the point `(i, j, k)`) to world space.
    pub world_from_index: DAffine3,
    /// The way the volume is rendered.
    pub kind: VolumeKind,
}

/// The way a volume is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VolumeKind {
    /// The surface where the trilinear interpolant passes through the iso-value.
    Smooth {
        /// The iso-value.
        iso: f32,
        /// Diffuse reflectance, linear RGB.
        albedo: Vec3,
    },
    /// The voxels as boxes.
    Blocky {
        /// The criterion for occupied voxels.
        occupied: Occupied,
        /// Diffuse reflectance, linear RGB.
        albedo: Vec3,
    },
    /// Absorption, emission and Henyey–Greenstein scattering.
    Fog {
        /// Extinction per unit of world length for a density of 1.
        extinction: f64,
        /// The fraction of extinction that is scattering, linear RGB.
        albedo: Vec3,
        /// Radiance emitted per unit of optical depth, linear RGB.
        emission: Vec3,
        /// The mean cosine of the scattering angle; between -1 and 1, exclusively.
        anisotropy: f64,
    },
}
