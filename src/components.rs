//! What an app says about volumes, cameras and the sun.

use bevy::camera::visibility::{VisibilityClass, add_visibility_class};
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::VdbGrid;

/// Shows a grid. `commands.spawn(VdbVolume(asset_server.load("smoke.vdb#density")))` is enough.
///
/// The grid stands in the entity's space as its file says (the grid's own transform, from index
/// space to the file's world); the entity's [`Transform`] then places it in Bevy's world: any
/// rotation, scale and mirror. [`Visibility`] and `RenderLayers` are obeyed. While the asset is on
/// its way, or if it never arrives, nothing is drawn.
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(Transform, Visibility, VisibilityClass, VdbMaterial)]
#[component(on_add = add_visibility_class::<VdbVolume>)]
pub struct VdbVolume(pub Handle<VdbGrid>);

/// The look of a volume.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbMaterial {
    /// Surfaces: the diffuse albedo. Fog: the single-scattering albedo, the part of the light it
    /// meets that it sends on. White by default.
    pub base_color: Color,
    /// Luminance of its own, in cd/m²: of a surface; of fog, where it is opaque. Black by default.
    pub emissive: LinearRgba,
    /// Fog: extinction coefficient per unit of density, in 1 / world unit: light is dimmed to 1/e
    /// after `1 / (density · density_scale)`. 0 or more, 1 by default.
    pub density_scale: f32,
}

impl Default for VdbMaterial {
    fn default() -> Self {
        Self { base_color: Color::WHITE, emissive: LinearRgba::BLACK, density_scale: 1.0 }
    }
}

/// How a camera shows volumes. Every `Camera3d` has one.
#[derive(Clone, Component, Debug, PartialEq, Reflect, ExtractComponent)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbCamera {
    /// Whether the camera shows volumes at all. To pick which, use `RenderLayers`.
    pub enabled: bool,
    /// What it shows of them.
    pub mode: VdbRenderMode,
    /// How rays find what they meet.
    pub traversal: VdbTraversal,
    /// [`VdbRenderMode::Steps`]: how many steps of the walk have the hottest colour. More than 0;
    /// 200 by default.
    pub steps_scale: f32,
}

impl Default for VdbCamera {
    fn default() -> Self {
        Self {
            enabled: true,
            mode: VdbRenderMode::Lit,
            traversal: VdbTraversal::HddaSdf,
            steps_scale: 200.0,
        }
    }
}

/// What a camera shows of volumes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbRenderMode {
    /// The picture: surfaces lit by the sun and the ambient light, fog that dims and glows.
    #[default]
    Lit,
    /// World-space normals of surfaces, from -1…1 to 0…1. Fog is left out.
    Normals,
    /// Depth of surfaces as in the depth buffer: 1 at the near plane, 0 infinitely far away. Fog is
    /// left out.
    Depth,
    /// Steps of the walk through the tree, light blue (none) to red ([`VdbCamera::steps_scale`]).
    Steps,
}

/// How rays find what they meet. All but [`March`](Self::March) show the same picture, to the last bit;
/// what they cost is told in `docs/benchmarks.md`, and shown by [`VdbRenderMode::Steps`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbTraversal {
    /// Samples at every half voxel, for comparison: passes over corners of voxels and finds surfaces
    /// late. Surfaces that are shown smooth, and fog, are walked as with [`Dda`](Self::Dda).
    March,
    /// Voxel by voxel.
    Dda,
    /// In strides over the empty nodes of the tree.
    Hdda,
    /// In leaps over all that is known to be empty ahead, from a start that the rays of a tile of
    /// 8×8 pixels share.
    #[default]
    HddaSdf,
}

/// Makes a `DirectionalLight` the sun of all volumes. Without one, the brightest directional light
/// that is visible is taken.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(DirectionalLight)]
pub struct VdbSun {
    /// Factor on the light's illuminance, for volumes only. 0 or more, 1 by default.
    pub intensity: f32,
}

impl Default for VdbSun {
    fn default() -> Self {
        Self { intensity: 1.0 }
    }
}
