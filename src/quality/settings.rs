//! Settings that trade accuracy for speed.

use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::VdbTraversal;

/// All settings of a camera that trade accuracy for speed. Added to every `Camera3d`.
/// [`VdbCamera`](crate::VdbCamera) sets what the camera displays.
///
/// The presets are points on measured time–error fronts; `docs/reference/quality.md` has the plots.
/// [`VdbDial`](crate::VdbDial) adjusts the settings automatically. Invalid values are replaced by
/// the nearest valid ones, with a warning.
#[derive(Clone, Component, Copy, Debug, PartialEq, Reflect, ExtractComponent)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbQuality {
    /// How rays traverse grids. The default is the fastest.
    pub traversal: VdbTraversal,
    /// Whether volumes receive shadows from lights with `shadow_maps_enabled`: shadows of volumes by
    /// one ray per light and pixel, and shadows of meshes from Bevy's shadow maps. On by default; costs
    /// nothing without such a light.
    pub shadows: bool,
    /// The largest distance at which a volume casts shadows on a point, in world units. 0 or more;
    /// infinite by default.
    pub shadow_range: f32,
    /// Whether the normals of smooth surfaces are interpolated between cells, which takes twelve
    /// more samples per visible point. On by default. When off, they are exactly those of the
    /// trilinear interpolant, which jump from cell to cell and make highlights look faceted.
    /// Shapes, depths and the positions of shadows are the same.
    pub smooth_normals: bool,
    /// The number of reflections a ray follows, 0 to 16. With 0, the default, surfaces reflect only
    /// the camera's `EnvironmentMapLight`; with 1, they also reflect volumes; with 2, those volumes
    /// reflect others in turn.
    ///
    /// Rough surfaces reflect in one random direction per pixel; [`denoise`](Self::denoise), temporal
    /// anti-aliasing and [`accumulate`](Self::accumulate) smooth the noise. The number of bounces is part of a
    /// scene's look, so every preset has 0.
    pub reflections: u32,
    /// The largest distance at which a volume or mesh is reflected in a surface, in world units. 0 or
    /// more; infinite by default.
    pub reflection_range: f32,
    /// Whether the surfaces of volumes also reflect opaque meshes, as far as the camera itself sees
    /// them; elsewhere, they reflect the environment map. Requires [`reflections`](Self::reflections).
    /// On by default. Only for cameras with `Hdr` or without tonemapping, because the targets of
    /// other cameras do not hold radiance.
    pub mesh_reflections: bool,
    /// Whether grain is removed. On by default, except in [`EXACT`](Self::EXACT).
    ///
    /// Reflections in rough surfaces are smoothed by a filter that follows the blur of the surface
    /// itself, and averaged over up to 32 frames, or two while lights, volumes or meshes change. This
    /// requires [`reflections`](Self::reflections) and takes 72 bytes per ray. Without the mean over
    /// frames, it takes 32: with [`accumulate`](Self::accumulate), which averages whole frames, and
    /// with motion vectors on devices that have only four storage textures per shader stage. From the
    /// opaque meshes that a camera sees, the grain of fog's shadows is subtracted, which takes 20 bytes
    /// per pixel and copies of the shadow maps (64 MiB for a sun with Bevy's defaults).
    pub denoise: bool,
    /// The distance in voxels between density samples of evenly lit fog (no lamps nearby, no
    /// shadows) that overlaps no other. From ¼ to 16; 0, the default, integrates exactly, cell by
    /// cell. In fog lit by the light cache, steps follow [`fog_light_error`](Self::fog_light_error) instead.
    pub fog_step: f32,
    /// The length in voxels of the stretches of a ray through fog that share one lighting sample,
    /// where light varies; four times as long in reflections. With the light cache, it applies only to
    /// shadows of surfaces and meshes. From ¼ to 64, 2 by default. Proportionally longer for grids of
    /// more than 128 voxels along an edge, which bounds the cost of a ray.
    pub fog_light_step: f32,
    /// The distance in voxels between density samples on rays from fog to lights. From ¼ to 64, 1
    /// by default; rays that fill the light cache use at most 1, but no less than its spacing. Proportionally
    /// larger for grids of more than 256 voxels along an edge.
    pub fog_shadow_step: f32,
    /// The light cache: the accepted relative error of radiance in fog lit by lights with shadows.
    /// Optical depths towards these lights are then computed once, on a lattice as coarse as the error
    /// permits, and interpolated along view rays, instead of sending rays to the lights. The steps of
    /// view rays follow from the error as well. From 0 to 1, 0.01 by default; 0 turns the cache off.
    ///
    /// The error is estimated from the extinction, the number of voxels, and how much densities change from
    /// voxel to voxel. Fog that is too dense or too large for the cache is lit by rays, along with all
    /// other fog on a view ray that meets it. If [`fog_shadow_step`](Self::fog_shadow_step) is at least
    /// twice the finest spacing that fits, the cache is used nevertheless, because it is more accurate.
    /// Fog on view rays that meet more than eight fogs or more than eight emission grids is also lit by
    /// rays. Shadows of surfaces and meshes on fog are not interpolated; they are evaluated once per
    /// `fog_light_step`.
    pub fog_light_error: f32,
    /// The number of slabs into which a ray is divided where fogs overlap that are not in the light
    /// cache; within a slab, they are treated as evenly mixed and evenly lit. Reflections use a quarter
    /// of that number. From 1 to 256, 32 by default.
    pub fog_slabs: u32,
    /// Levels of detail: what is distant is displayed at half, a quarter … of its resolution, as long
    /// as the voxels of the copy are no larger than this many pixels. At most 64. With 1, the cost of a
    /// distant volume follows the pixels that it covers. With 0, the default, grids are shown at
    /// full resolution, and the cost grows with the number of their voxels.
    ///
    /// Each part of a surface is displayed at the level for its depth along the view axis, so a terrain
    /// may reach from the camera's feet to the horizon. Shadows and reflections use the level of the
    /// point that shows them. Fog, and whatever an orthographic camera sees, has one level, that of
    /// its nearest point.
    ///
    /// Levels are generated in the background, one grid after the other, for volumes in view: for a
    /// surface once its farthest voxels are no larger than that many pixels, for fog once its nearest
    /// are. They take a third more memory for a surface,
    /// and a seventh more for fog.
    pub detail: f32,
    /// Rays per pixel along each axis of the image: 0.5 traces one ray per four pixels. The
    /// remaining pixels are interpolated from neighbours that belong to the same surface. From 0.25
    /// to 1, 1 by default.
    pub resolution: f32,
    /// Anti-aliasing: the number of additional rays through each pixel on a silhouette, a crease or
    /// the edge of a shadow. 2, 4, 8 or 16; 0 turns it off.
    ///
    /// Off in unlit modes, with fewer rays than pixels, and with temporal anti-aliasing or
    /// [`accumulate`](Self::accumulate), which smooth edges themselves.
    pub edge_samples: u32,
    /// Temporal accumulation: the number of frames whose mean is displayed while nothing in view
    /// changes: neither the camera, nor a volume, a light, or a mesh in front of volumes or casting
    /// shadows on them. Up to 256; 0, the default, and 1 turn it off.
    ///
    /// Rays pass through different positions of their pixels in turn, which smooths the edges of
    /// volumes, soft shadows and rough reflections, and recovers full detail if there are fewer
    /// rays than pixels. The first frame looks as it does without accumulation. Takes 44 bytes per
    /// pixel from the second frame on. Changes made only by shaders, such as shadows of meshes that
    /// they deform, fade in over this many frames.
    ///
    /// Off with temporal anti-aliasing, which does the same, and in unlit modes.
    pub accumulate: u32,
}

impl VdbQuality {
    /// The reference. Fog is lit in such small steps that smaller ones would not change a 16-bit
    /// float.
    pub const EXACT: Self = Self {
        traversal: VdbTraversal::HddaSkip,
        shadows: true,
        shadow_range: f32::INFINITY,
        smooth_normals: true,
        reflections: 0,
        reflection_range: f32::INFINITY,
        mesh_reflections: true,
        denoise: false,
        fog_step: 0.0,
        fog_light_step: 0.5,
        fog_shadow_step: 0.25,
        fog_light_error: 0.0,
        fog_slabs: 128,
        detail: 0.0,
        resolution: 1.0,
        edge_samples: 0,
        accumulate: 0,
    };
    /// The default: hard to tell from [`EXACT`](Self::EXACT).
    pub const HIGH: Self = Self {
        denoise: true,
        fog_light_step: 2.0,
        fog_shadow_step: 1.0,
        fog_light_error: 0.01,
        fog_slabs: 32,
        ..Self::EXACT
    };
    /// Sampled fog, with fewer lighting and shadow samples.
    pub const BALANCED: Self = Self {
        fog_step: 1.0,
        fog_light_step: 4.0,
        fog_shadow_step: 4.0,
        fog_light_error: 0.02,
        fog_slabs: 16,
        ..Self::HIGH
    };
    /// Still fewer samples, one ray per four pixels, and levels of detail, which take memory
    /// ([`VdbQuality::detail`]).
    pub const FAST: Self = Self {
        fog_step: 2.0,
        fog_light_step: 8.0,
        fog_shadow_step: 8.0,
        fog_light_error: 0.05,
        fog_slabs: 8,
        detail: 2.0,
        resolution: 0.5,
        ..Self::BALANCED
    };
    /// The presets by name, from the most accurate to the fastest.
    pub const PRESETS: [(&str, Self); 4] = [
        ("exact", Self::EXACT),
        ("high", Self::HIGH),
        ("balanced", Self::BALANCED),
        ("fast", Self::FAST),
    ];

    /// The nearest valid settings, and the name of the first setting that was invalid.
    pub(crate) fn sound(&self) -> (Self, Option<&'static str>) {
        let mut wrong = None;
        let mut within = |name, value: f32, least: f32, most: f32, otherwise: f32| {
            let sound = if value.is_nan() { otherwise } else { value.clamp(least, most) };
            if value != sound {
                wrong = wrong.or(Some(name));
            }
            sound
        };
        let step = if self.fog_step == 0.0 { 0.0 } else { MIN_STEP };
        let sound = Self {
            traversal: self.traversal,
            shadows: self.shadows,
            shadow_range: within("shadow_range", self.shadow_range, 0.0, f32::INFINITY, 0.0),
            smooth_normals: self.smooth_normals,
            reflections: self.reflections.min(MAX_REFLECTIONS),
            mesh_reflections: self.mesh_reflections,
            denoise: self.denoise,
            reflection_range: within(
                "reflection_range",
                self.reflection_range,
                0.0,
                f32::INFINITY,
                0.0,
            ),
            fog_step: within("fog_step", self.fog_step, step, MAX_FOG_STEP, 0.0),
            fog_light_step: within(
                "fog_light_step",
                self.fog_light_step,
                MIN_STEP,
                MAX_STEP,
                Self::HIGH.fog_light_step,
            ),
            fog_shadow_step: within(
                "fog_shadow_step",
                self.fog_shadow_step,
                MIN_STEP,
                MAX_STEP,
                Self::HIGH.fog_shadow_step,
            ),
            fog_light_error: within(
                "fog_light_error",
                self.fog_light_error,
                0.0,
                1.0,
                Self::HIGH.fog_light_error,
            ),
            fog_slabs: self.fog_slabs.clamp(1, MAX_SLABS),
            detail: within("detail", self.detail, 0.0, 64.0, 0.0),
            resolution: within("resolution", self.resolution, MIN_RESOLUTION, 1.0, 1.0),
            edge_samples: match self.edge_samples.min(MAX_EDGE_SAMPLES) {
                0 => 0,
                samples => 1 << samples.max(2).ilog2(),
            },
            accumulate: self.accumulate.min(MAX_FRAMES),
        };
        let slabs = (sound.fog_slabs != self.fog_slabs).then_some("fog_slabs");
        let bounces = (sound.reflections != self.reflections).then_some("reflections");
        let edges = (sound.edge_samples != self.edge_samples).then_some("edge_samples");
        let frames = (sound.accumulate != self.accumulate).then_some("accumulate");
        (sound, wrong.or(slabs).or(bounces).or(edges).or(frames))
    }
}

impl Default for VdbQuality {
    fn default() -> Self {
        Self::HIGH
    }
}

/// Overrides the camera's [`VdbQuality`] for one volume. `None` keeps the camera's value.
#[derive(Clone, Component, Copy, Debug, Default, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbVolumeQuality {
    /// Replaces [`VdbQuality::smooth_normals`].
    pub smooth_normals: Option<bool>,
    /// Replaces [`VdbQuality::fog_step`], in voxels.
    pub fog_step: Option<f32>,
    /// Replaces [`VdbQuality::fog_light_step`], in voxels.
    pub fog_light_step: Option<f32>,
    /// Replaces [`VdbQuality::fog_shadow_step`], in voxels.
    pub fog_shadow_step: Option<f32>,
}

impl VdbVolumeQuality {
    /// The settings of a camera for this volume.
    pub(crate) fn over(&self, camera: &VdbQuality) -> VdbQuality {
        VdbQuality {
            smooth_normals: self.smooth_normals.unwrap_or(camera.smooth_normals),
            fog_step: self.fog_step.unwrap_or(camera.fog_step),
            fog_light_step: self.fog_light_step.unwrap_or(camera.fog_light_step),
            fog_shadow_step: self.fog_shadow_step.unwrap_or(camera.fog_shadow_step),
            ..*camera
        }
    }
}

/// The largest number of bounces.
const MAX_REFLECTIONS: u32 = 16;
/// The shortest step through fog, in voxels; shorter steps would only add cost.
const MIN_STEP: f32 = 0.25;
const MAX_STEP: f32 = 64.0;
const MAX_FOG_STEP: f32 = 16.0;
const MAX_SLABS: u32 = 256;
const MIN_RESOLUTION: f32 = 0.25;
const MAX_FRAMES: u32 = 256;
const MAX_EDGE_SAMPLES: u32 = 16;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_makes_no_sense_is_replaced_and_named() {
        for (_, preset) in VdbQuality::PRESETS {
            assert_eq!(preset.sound(), (preset, None));
        }
        let plain = VdbQuality::default;
        let odd = [f32::NAN, -1.0, f32::NEG_INFINITY];
        for x in odd {
            for (settings, name) in [
                (VdbQuality { shadow_range: x, ..plain() }, "shadow_range"),
                (VdbQuality { reflection_range: x, ..plain() }, "reflection_range"),
                (VdbQuality { fog_step: x, ..plain() }, "fog_step"),
                (VdbQuality { fog_light_step: x, ..plain() }, "fog_light_step"),
                (VdbQuality { fog_shadow_step: x, ..plain() }, "fog_shadow_step"),
                (VdbQuality { fog_light_error: x, ..plain() }, "fog_light_error"),
                (VdbQuality { resolution: x, ..plain() }, "resolution"),
            ] {
                let (sound, wrong) = settings.sound();
                assert_eq!(wrong, Some(name), "{x}");
                assert_eq!(sound.sound(), (sound, None), "{name} {x}");
            }
        }
        let many = VdbQuality { fog_slabs: 0, ..plain() };
        assert_eq!((many.sound().0.fog_slabs, many.sound().1), (1, Some("fog_slabs")));
        let many = VdbQuality { reflections: u32::MAX, ..plain() };
        assert_eq!((many.sound().0.reflections, many.sound().1), (16, Some("reflections")));
        for (asked, given) in [(1, 2), (3, 2), (u32::MAX, 16)] {
            let edges = VdbQuality { edge_samples: asked, ..plain() }.sound();
            assert_eq!((edges.0.edge_samples, edges.1), (given, Some("edge_samples")));
        }
        let many = VdbQuality { accumulate: u32::MAX, ..plain() };
        assert_eq!((many.sound().0.accumulate, many.sound().1), (256, Some("accumulate")));
    }
}
