//! Components of volumes, cameras and suns.

use bevy::camera::visibility::{VisibilityClass, add_visibility_class};
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::scene::volume_state::ToldDrawn;
use crate::{VdbGrid, VdbVolumeState};

/// Displays a grid. `commands.spawn(VdbVolume(asset_server.load("smoke.vdb")))` suffices for a file
/// with one displayable grid; `"smoke.vdb#density"` names one of several.
///
/// The entity's local space is the world of the grid's file: the grid's own transform maps index
/// space to it, and the entity's [`Transform`] places it in Bevy's world, with any rotation, scale
/// and mirroring. [`Visibility`] and `RenderLayers` are obeyed. Nothing is drawn until the asset
/// has loaded; [`VdbVolumeState`] reports its progress.
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(Transform, Visibility, VisibilityClass, VdbMaterial, VdbVolumeState, ToldDrawn)]
#[component(on_add = add_visibility_class::<VdbVolume>)]
pub struct VdbVolume(pub Handle<VdbGrid>);

/// Marks the volume of a page of a larger surface. A ray that is already inside the solid where it enters a
/// page, because the surface of the adjacent page is slightly lower, hits at the border.
#[derive(Clone, Copy, Component, Debug, Default)]
pub(crate) struct Page;

/// The appearance of a volume. Surfaces use the terms and defaults of Bevy's `StandardMaterial`,
/// and match a mesh with the same material in the same light.
///
/// Values that are NaN or out of range are replaced by the nearest valid ones, with a warning.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbMaterial {
    /// Surfaces: the reflected colour, diffuse or, for metals, specular. Fog: the single-scattering
    /// albedo, the fraction of light that is scattered rather than absorbed. Both are multiplied by
    /// the [`VdbColorGrid`](crate::VdbColorGrid) if there is one. White by default.
    pub base_color: Color,
    /// Emitted luminance in cd/m², for fog where it is opaque. Black by default. For fire, use a
    /// [`VdbEmission`](crate::VdbEmission).
    pub emissive: LinearRgba,
    /// Surfaces: from 0, a mirror, to 1, without noticeable highlights. 0.5 by default. Below 0.089,
    /// highlights of lights do not become smaller.
    pub perceptual_roughness: f32,
    /// Surfaces: from 0, a dielectric, to 1, a metal. 0 by default.
    pub metallic: f32,
    /// Dielectric surfaces: reflectance at normal incidence, from 0 to 1, where 0.5 stands for 4 %.
    /// 0.5 by default.
    pub reflectance: f32,
    /// Fog: the extinction coefficient per unit of density, in 1 / world unit. Light drops to 1/e
    /// after `1 / (density · density_scale)`. 0 or more, 1 by default.
    pub density_scale: f32,
    /// Fog: the mean cosine of the scattering angle (Henyey–Greenstein), from -1, backwards,
    /// through 0, isotropic, to 1, forwards. 0 by default; clouds have 0.8 and more. Clamped to
    /// ±0.99.
    ///
    /// Light from environment maps is scattered with low angular resolution: fog takes into account
    /// the difference between opposite directions, and treats finer features as uniform.
    pub anisotropy: f32,
}

impl Default for VdbMaterial {
    fn default() -> Self {
        Self {
            base_color: Color::WHITE,
            emissive: LinearRgba::BLACK,
            perceptual_roughness: 0.5,
            metallic: 0.0,
            reflectance: 0.5,
            density_scale: 1.0,
            anisotropy: 0.0,
        }
    }
}

/// A camera's settings for displaying volumes. Added to every `Camera3d`. For accuracy and speed,
/// see [`VdbQuality`](crate::VdbQuality).
#[derive(Clone, Component, Debug, PartialEq, Reflect, ExtractComponent)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbCamera {
    /// Whether the camera displays volumes. On by default. To select individual volumes, use
    /// `RenderLayers`.
    pub enabled: bool,
    /// The quantity that the camera displays.
    pub mode: VdbRenderMode,
    /// Whether volumes cast shadows on meshes. On by default.
    ///
    /// Volumes are drawn into the shadow maps of lights with `shadow_maps_enabled` in every frame:
    /// surfaces with one ray per texel that they may cover, fog with about one per voxel across.
    /// `docs/guide/quality.md` explains how to reduce the cost. Edges have the resolution of the maps, as for shadows of meshes.
    /// A texel of a shadow map has one depth, so fog dithers the light between texels. Shadow filtering
    /// smooths that, best with Bevy's default `ShadowFilteringMethod::Gaussian`, and
    /// [`VdbQuality::denoise`](crate::VdbQuality::denoise) removes most of it from opaque meshes. The
    /// maps of point and spot lights are shared by all cameras: they include volumes if any camera has
    /// this setting on.
    ///
    /// Costs nothing without such a light, a mesh in view or a volume. Off where
    /// [`VdbQuality::shadows`](crate::VdbQuality::shadows) is off, and for volumes with
    /// `NotShadowCaster`.
    pub mesh_shadows: bool,
    /// The tree nodes whose borders are drawn on surfaces, in any mode.
    pub overlays: VdbOverlays,
    /// Multiple scattering: whether fog scatters light more than once, which makes clouds white. On
    /// by default. `docs/reference/fog.md` compares its errors with those of single scattering. Light
    /// from lamps and suns without shadows is scattered once in either case, because it is not
    /// attenuated on its way in.
    pub multiple_scattering: bool,
    /// The number of traversal steps shown in the hottest colour of [`VdbRenderMode::Steps`]. More
    /// than 0; 200 by default.
    pub steps_scale: f32,
    /// The value that [`VdbRenderMode::Maximum`] shows in white. More than 0; 1 by default.
    pub maximum_scale: f32,
}

impl Default for VdbCamera {
    fn default() -> Self {
        Self {
            enabled: true,
            mode: VdbRenderMode::Lit,
            mesh_shadows: true,
            overlays: VdbOverlays::default(),
            multiple_scattering: true,
            steps_scale: 200.0,
            maximum_scale: 1.0,
        }
    }
}

/// The tree nodes whose borders are drawn on surfaces. All lines in the image have the same width;
/// they are omitted where nodes are smaller than a few pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub struct VdbOverlays {
    /// Leaf nodes, 8³ voxels: cyan.
    pub leaves: bool,
    /// Lower internal nodes, 128³ voxels: red.
    pub lower: bool,
    /// Upper internal nodes, 4,096³ voxels: blue.
    pub upper: bool,
}

/// The quantity that a camera displays for volumes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
#[non_exhaustive]
pub enum VdbRenderMode {
    /// The final image: lit surfaces and fog, with reflections. The sum of
    /// [`Diffuse`](Self::Diffuse) and [`Glossy`](Self::Glossy).
    #[default]
    Lit,
    /// The view-independent part of the image: diffuse reflection and emission of surfaces, and
    /// fog. No highlights, no reflections.
    Diffuse,
    /// The view-dependent part: highlights and reflections on surfaces, attenuated by fog.
    Glossy,
    /// Voxel faces in shades of grey, without lighting: bright above, dark below. Fog is left out
    /// in this and the following modes, except [`Steps`](Self::Steps) and
    /// [`Maximum`](Self::Maximum).
    Gray,
    /// The axes that the surface faces: x red, y green, z blue.
    Rgb,
    /// A colour for each voxel, or for each cell of a smooth surface, derived from its index modulo
    /// 128.
    HitVoxel,
    /// World-space normals of surfaces, mapped from -1…1 to 0…1.
    Normals,
    /// Depth of surfaces as in the depth buffer: 1 at the near plane, 0 at infinity.
    Depth,
    /// Traversal steps, from light blue (none) to red ([`VdbCamera::steps_scale`]).
    Steps,
    /// Maximum intensity projection, an overview of scientific and medical data: the largest value
    /// of all fog along each ray, up to the first opaque mesh, from black at 0 to white at
    /// [`VdbCamera::maximum_scale`]. Exact for the trilinear interpolant. Values are those of the
    /// grids, without `density_scale`, ramps and custom materials; surfaces are left out. While a
    /// player cross-fades, both frames count in full.
    Maximum,
}

impl VdbRenderMode {
    /// All modes, in the order of their documentation.
    pub const ALL: &'static [Self] = &[
        Self::Lit,
        Self::Diffuse,
        Self::Glossy,
        Self::Gray,
        Self::Rgb,
        Self::HitVoxel,
        Self::Normals,
        Self::Depth,
        Self::Steps,
        Self::Maximum,
    ];

    /// The name of the mode for menus and command lines, in lower case.
    pub const fn name(self) -> &'static str {
        self.traits().name
    }

    /// Whether the mode depends on lights.
    pub const fn is_lit(self) -> bool {
        self.traits().is_lit
    }

    /// Everything that distinguishes the mode from others, except how its shader computes a colour.
    pub(crate) const fn traits(self) -> ModeTraits {
        let surfaces = ModeTraits {
            name: "",
            shader_def: None,
            is_lit: false,
            uses_normals: false,
            shows_fog: false,
            shows_reflections: false,
            shows_distance_fog: false,
            shows_background: false,
        };
        let light = ModeTraits { is_lit: true, uses_normals: true, shows_fog: true, ..surfaces };
        match self {
            Self::Lit => ModeTraits {
                name: "lit",
                shows_reflections: true,
                shows_distance_fog: true,
                ..light
            },
            Self::Diffuse => {
                ModeTraits { name: "diffuse", shader_def: Some("VDB_DIFFUSE_ONLY"), ..light }
            }
            Self::Glossy => ModeTraits {
                name: "glossy",
                shader_def: Some("VDB_GLOSSY_ONLY"),
                shows_reflections: true,
                ..light
            },
            Self::Gray => {
                ModeTraits { name: "gray", shader_def: Some("VDB_SHOW_GRAY"), ..surfaces }
            }
            Self::Rgb => ModeTraits { name: "rgb", shader_def: Some("VDB_SHOW_AXES"), ..surfaces },
            Self::HitVoxel => {
                ModeTraits { name: "voxels", shader_def: Some("VDB_SHOW_VOXELS"), ..surfaces }
            }
            Self::Normals => {
                let (name, shader_def) = ("normals", Some("VDB_SHOW_NORMALS"));
                ModeTraits { name, shader_def, uses_normals: true, ..surfaces }
            }
            Self::Depth => {
                ModeTraits { name: "depth", shader_def: Some("VDB_SHOW_DEPTH"), ..surfaces }
            }
            Self::Steps => ModeTraits {
                name: "steps",
                shader_def: Some("VDB_COUNT_STEPS"),
                shows_fog: true,
                shows_background: true,
                ..surfaces
            },
            Self::Maximum => ModeTraits {
                name: "maximum",
                shader_def: Some("VDB_SHOW_MAXIMUM"),
                shows_fog: true,
                ..surfaces
            },
        }
    }
}

/// Everything that distinguishes a render mode from others, except how its shader computes a colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ModeTraits {
    /// The name for menus and command lines.
    pub name: &'static str,
    /// The shader def of the trace; `None` for the final image.
    pub shader_def: Option<&'static str>,
    /// Whether it depends on lights.
    pub is_lit: bool,
    /// Whether smooth normals are compiled.
    pub uses_normals: bool,
    /// Whether fog is traced and compiled.
    pub shows_fog: bool,
    pub shows_reflections: bool,
    /// Whether it shows Bevy's `DistanceFog`.
    pub shows_distance_fog: bool,
    /// Whether it colours pixels without a surface or fog.
    pub shows_background: bool,
}

/// How rays traverse a grid. All but [`March`](Self::March) render the same image, to the last bit.
/// `docs/internals/notebook.md` compares their cost, and [`VdbRenderMode::Steps`] visualises it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
#[non_exhaustive]
pub enum VdbTraversal {
    /// Samples every half voxel, for comparison: misses corners of voxels and finds surfaces late.
    /// Smooth surfaces and fog are traversed as with [`Dda`](Self::Dda).
    March,
    /// Voxel by voxel.
    Dda,
    /// Hierarchical: skips empty nodes of the tree.
    Hdda,
    /// Hierarchical, and skips the largest known empty cube ahead, from a start shared by the rays
    /// of a tile of 8×8 pixels (beam optimisation).
    #[default]
    HddaSkip,
}

/// Makes a `DirectionalLight` affect volumes differently from meshes.
///
/// Lights in exactly the same direction cannot be told apart: the factor applies to all of them.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(DirectionalLight)]
pub struct VdbSun {
    /// Multiplies the light's illuminance on volumes. 0 or more, 1 by default.
    pub intensity: f32,
    /// The apparent size of the light in radians, which softens the shadows that volumes cast on
    /// surfaces of volumes: the width of the penumbra is the distance to the caster times this angle.
    /// From 0, the default, for hard edges, to 1; the Sun has 0.0093. Fog is lit from the
    /// light's centre. Shadows from and on meshes are Bevy's; see its `soft_shadow_size`.
    pub angular_diameter: f32,
    /// Shadow rays per pixel for a light with a size: 1 to 256, 16 by default. Fewer produce noise,
    /// which stays fixed in the image unless the camera has temporal anti-aliasing or
    /// [`VdbQuality::accumulate`](crate::VdbQuality::accumulate), which average it.
    pub samples: u32,
}

impl Default for VdbSun {
    fn default() -> Self {
        Self { intensity: 1.0, angular_diameter: 0.0, samples: 16 }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use bevy::reflect::enums::Enum;
    use bevy::reflect::{TypeInfo, Typed};

    use super::*;

    #[test]
    fn all_modes_are_listed_in_order_by_different_names() {
        let TypeInfo::Enum(modes) = VdbRenderMode::type_info() else { panic!("it is an enum") };
        let listed: Vec<_> = VdbRenderMode::ALL.iter().map(|mode| mode.variant_name()).collect();
        assert_eq!(listed, modes.variant_names());
        let names: HashSet<_> = VdbRenderMode::ALL.iter().map(|mode| mode.name()).collect();
        assert_eq!(names.len(), VdbRenderMode::ALL.len(), "{names:?}");
    }
}
