//! What an app says about volumes, cameras and suns.

use bevy::camera::visibility::{VisibilityClass, add_visibility_class};
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::volume_state::ToldDrawn;
use crate::{VdbGrid, VdbVolumeState};

/// Shows a grid. `commands.spawn(VdbVolume(asset_server.load("smoke.vdb")))` is enough where a file has one
/// grid to show; `"smoke.vdb#density"` names one.
///
/// The grid stands in the entity's space as its file says (the grid's own transform, from index
/// space to the file's world); the entity's [`Transform`] then places it in Bevy's world: any
/// rotation, scale and mirror. [`Visibility`] and `RenderLayers` are obeyed. While the asset is on
/// its way, or if it never arrives, nothing is drawn; [`VdbVolumeState`] says how far it is.
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(Transform, Visibility, VisibilityClass, VdbMaterial, VdbVolumeState, ToldDrawn)]
#[component(on_add = add_visibility_class::<VdbVolume>)]
pub struct VdbVolume(pub Handle<VdbGrid>);

/// The look of a volume. Surfaces have the same terms and defaults as Bevy's `StandardMaterial`, and
/// look the same under the same lights.
///
/// Values out of range, and such that are no numbers, are replaced by the nearest that make sense, and
/// a warning says so.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbMaterial {
    /// Surfaces: the colour of what they reflect, diffusely or, of a metal, as a mirror; times that of a
    /// [`VdbColorGrid`](crate::VdbColorGrid), if there is one. Fog: the
    /// single-scattering albedo, the part of the light it meets that it sends on. White by default.
    pub base_color: Color,
    /// Luminance of its own, in cd/m²: of a surface; of fog, where it is opaque (fire has a grid of its
    /// own: [`VdbEmission`](crate::VdbEmission)). Black by default.
    pub emissive: LinearRgba,
    /// Surfaces: from 0, a mirror, to 1, with no highlights to speak of. 0.5 by default. Lights have no
    /// highlights smaller than those of 0.089.
    pub perceptual_roughness: f32,
    /// Surfaces: from 0, not a metal, to 1, a metal. 0 by default.
    pub metallic: f32,
    /// Surfaces that are not of metal: how much they reflect when seen head on, from 0 to 1, of which
    /// 0.5 is 4 % of the light. 0.5 by default.
    pub reflectance: f32,
    /// Fog: extinction coefficient per unit of density, in 1 / world unit: light is dimmed to 1/e
    /// after `1 / (density · density_scale)`. 0 or more, 1 by default.
    pub density_scale: f32,
    /// Fog: the mean cosine of the angle by which it turns light when it scatters it, after Henyey and
    /// Greenstein: from -1, all back to where it came from, by 0, evenly into all directions, to 1, all
    /// straight on. 0 by default; clouds have 0.8 and more. Nearer to -1 and 1 than 0.99 is taken as that.
    ///
    /// Of environment maps, fog scatters what one direction has more than the opposite one: finer
    /// features it takes as even.
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

/// What a camera shows of volumes. Every `Camera3d` has one; how well and how fast it does is for
/// [`VdbQuality`](crate::VdbQuality).
#[derive(Clone, Component, Debug, PartialEq, Reflect, ExtractComponent)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbCamera {
    /// Whether the camera shows volumes at all. To pick which, use `RenderLayers`.
    pub enabled: bool,
    /// What it shows of them.
    pub mode: VdbRenderMode,
    /// Whether volumes throw shadows on meshes: the shadow maps of lights that throw
    /// shadows (`shadow_maps_enabled`) then show volumes as well, drawn
    /// by a ray to each texel that may. Their edges are those of the maps, as the edges of the shadows of
    /// meshes are; fog dims light in 64 steps, which the smoothing of the maps evens out
    /// (`ShadowFilteringMethod::Gaussian`, Bevy's default, best of all). Maps of point and spot lights are for
    /// all cameras: volumes are in them if one of these wants them there. On by default; without such a
    /// light, a mesh in the picture and a volume somewhere, it costs nothing. Not with
    /// [`VdbQuality::shadows`](crate::VdbQuality::shadows) off, and not of volumes that are
    /// `NotShadowCaster`.
    pub mesh_shadows: bool,
    /// Borders of the tree's nodes on surfaces, in any mode.
    pub overlays: VdbOverlays,
    /// Whether fog scatters light more than once: what makes clouds white. On by default; it is an
    /// approximation, with nearly no cost beside the light that is scattered once. How far off either is
    /// from all the light there is, is in `docs/reference/fog.md`. Of lamps and suns without shadows fog scatters all
    /// light once either way, as nothing dims what comes to it.
    pub multiple_scattering: bool,
    /// [`VdbRenderMode::Steps`]: how many steps of the walk have the hottest colour. More than 0;
    /// 200 by default.
    pub steps_scale: f32,
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
        }
    }
}

/// Which nodes of the tree have their borders drawn on surfaces: lines as wide everywhere in the
/// picture, left out where nodes are smaller than a few pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub struct VdbOverlays {
    /// Leaves, 8³ voxels: cyan.
    pub leaves: bool,
    /// The nodes above them, 128³ voxels: red.
    pub lower: bool,
    /// The nodes above those, 4,096³ voxels: blue.
    pub upper: bool,
}

/// What a camera shows of volumes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbRenderMode {
    /// The picture: surfaces and fog under all lights that reach them, with all that surfaces reflect.
    /// It is the sum of [`Diffuse`](Self::Diffuse) and [`Glossy`](Self::Glossy).
    #[default]
    Lit,
    /// The part of the picture that does not change with the viewer's place: what surfaces scatter and
    /// send by themselves, and fog. No highlights, no reflections.
    Diffuse,
    /// The other part: highlights of lights and reflections, on surfaces alone. Fog dims them.
    Glossy,
    /// Faces of voxels told apart in gray, without light: those above bright, those below dark. Fog
    /// is left out here and below, but for [`Steps`](Self::Steps).
    Gray,
    /// The axes of the grid across which the surface lies: x red, y green, z blue.
    Rgb,
    /// World-space normals of surfaces, from -1…1 to 0…1.
    Normals,
    /// Depth of surfaces as in the depth buffer: 1 at the near plane, 0 infinitely far away.
    Depth,
    /// A colour for each voxel, or for each cell between samples of a smooth surface, by its index
    /// modulo 128.
    HitVoxel,
    /// Steps of the walk through the tree, light blue (none) to red ([`VdbCamera::steps_scale`]).
    Steps,
}

impl VdbRenderMode {
    /// Whether lights have a part in it.
    pub(crate) fn is_lit(self) -> bool {
        matches!(self, Self::Lit | Self::Diffuse | Self::Glossy)
    }
}

/// How rays find what they meet. All but [`March`](Self::March) show the same picture, to the last bit;
/// what they cost is told in `docs/internals/notebook.md`, and shown by [`VdbRenderMode::Steps`].
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

/// Makes a `DirectionalLight` shine on volumes otherwise than on meshes. Without it, every light shines
/// on both alike.
///
/// Lights in the very same direction are told apart by nothing: the factor goes for all of them.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(DirectionalLight)]
pub struct VdbSun {
    /// Factor on the light's illuminance, for volumes only. 0 or more, 1 by default.
    pub intensity: f32,
    /// How large the light is in the sky, in radians, which makes the edges of shadows that volumes throw
    /// on surfaces of volumes as soft: as wide as the distance of what throws them times this. From 0,
    /// the default, for sharp edges, to 1; the Sun's is 0.0093. Fog is shaded as from its middle, and
    /// shadows from and on meshes are Bevy's, whose `soft_shadow_size` is for that.
    pub angular_diameter: f32,
    /// Rays that each pixel sends to a light with a size: from 1 to 256, 16 by default. Fewer make grain,
    /// which stands still in the picture unless the camera has temporal anti-aliasing, or
    /// [`VdbQuality::accumulate`](crate::VdbQuality::accumulate), which even it out.
    pub samples: u32,
}

impl Default for VdbSun {
    fn default() -> Self {
        Self { intensity: 1.0, angular_diameter: 0.0, samples: 16 }
    }
}
