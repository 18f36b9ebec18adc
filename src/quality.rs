//! What a camera trades accuracy for speed by.

use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::VdbTraversal;

/// Every knob by which a camera trades accuracy for speed. Every `Camera3d` has one; what it shows at
/// all is [`VdbCamera`](crate::VdbCamera)'s to say.
///
/// The presets are points of measured fronts of time against error; `docs/reference/quality.md` has the plots.
/// [`VdbDial`](crate::VdbDial) turns the knobs by itself. Values that cannot be honoured are
/// replaced by the nearest that can, and a warning says so.
#[derive(Clone, Component, Copy, Debug, PartialEq, Reflect, ExtractComponent)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbQuality {
    /// How rays find what they meet. All but one ways show the same; none is quicker than the default.
    pub traversal: VdbTraversal,
    /// Whether lights that throw shadows (`shadow_maps_enabled`) throw them on volumes: those of
    /// volumes, by a ray to each such light from each pixel, and those of meshes, from Bevy's shadow
    /// maps. On by default; without such a light it costs nothing.
    pub shadows: bool,
    /// How far from a place a volume can be to throw a shadow on it, in world units. 0 or more;
    /// infinite by default.
    pub shadow_range: f32,
    /// How many times a ray goes on from a surface to what it reflects. With 0, the default, surfaces
    /// reflect the camera's `EnvironmentMapLight` alone; with 1 volumes, too; with 2 volumes in
    /// volumes. Rough surfaces reflect in one direction a pixel, by chance: that is for temporal
    /// anti-aliasing, or [`accumulate`](Self::accumulate), to even out. At most 16. It is a part of a
    /// scene's look, so all presets have 0.
    pub reflections: u32,
    /// How far from a surface a volume can be to be reflected in it, in world units. 0 or more;
    /// infinite by default.
    pub reflection_range: f32,
    /// Voxels between the places where a ray samples the density of a fog that is lit evenly (no lamps
    /// near, no shadows) and overlaps no other. From ¼ to 16; 0, the default, integrates cell by cell,
    /// exactly.
    pub fog_step: f32,
    /// Voxels of fog along a ray that are lit as one, where light differs from place to place; of what
    /// is reflected, four times as many. From ¼ to 64, 2 by default. In a fog of more than 128 voxels
    /// along an edge it grows with it, so that what a ray costs has a bound.
    pub fog_light_step: f32,
    /// Voxels between the densities that a ray from a place in fog to a light sums up. From ¼ to 64, 1
    /// by default. In a fog of more than 256 voxels along an edge it grows with it.
    pub fog_shadow_step: f32,
    /// Into how many slabs the part of a ray is cut that overlapping fogs share; within one, they are
    /// taken as evenly mixed and evenly lit. Of what is reflected, a quarter of them. From 1 to 256, 32
    /// by default.
    pub fog_slabs: u32,
    /// Levels of detail: how many pixels a voxel may cover, at most, of the copies at a half, a quarter
    /// … of their resolution that are shown of volumes far away. They are made in the background, one grid
    /// after the other, of volumes that are in the picture of a camera that asks for them, so far away
    /// that their voxels are no larger than that; they take a third more memory of a surface, a seventh of fog. 0, the
    /// default, shows grids as they are, and with that every hit where it is; what they cost grows with
    /// their voxels. With 1, what a volume costs follows the pixels that it covers, not its voxels. At
    /// most 64.
    pub detail: f32,
    /// Rays per pixel, along each axis of the picture: at 0.5, a ray for four pixels. Pixels between
    /// take after those of their neighbours that belong to the same surface. From 0.25 to 1, 1 by
    /// default.
    pub resolution: f32,
    /// Frames whose mean is shown while nothing changes in what the camera sees: not the camera, nor a
    /// volume, a light, or a mesh before them or that throws shadows on them. Rays go through each place of a
    /// pixel in turn, so that edges of volumes become smooth; of fewer rays than pixels, through each pixel,
    /// so that the picture becomes that of all; and so do soft shadows and rough reflections. A first frame
    /// shows what it does without. Takes 44 bytes a pixel, once the second frame is there. What shaders alone
    /// change, such as the shadows of meshes that they bend, fades over so many frames. Up to 256; 0, the
    /// default, and 1 are off. Not with temporal anti-aliasing, which does the same, nor in modes that show
    /// no light.
    pub accumulate: u32,
}

impl VdbQuality {
    /// What others are measured against. Fog is lit at steps so small that smaller ones change nothing
    /// that a 16-bit float could show.
    pub const EXACT: Self = Self {
        traversal: VdbTraversal::HddaSdf,
        shadows: true,
        shadow_range: f32::INFINITY,
        reflections: 0,
        reflection_range: f32::INFINITY,
        fog_step: 0.0,
        fog_light_step: 0.5,
        fog_shadow_step: 0.25,
        fog_slabs: 128,
        detail: 0.0,
        resolution: 1.0,
        accumulate: 0,
    };
    /// The default: no difference that the eye could find.
    pub const HIGH: Self =
        Self { fog_light_step: 2.0, fog_shadow_step: 1.0, fog_slabs: 32, ..Self::EXACT };
    /// Fog by samples, and fewer of them.
    pub const BALANCED: Self = Self {
        fog_step: 1.0,
        fog_light_step: 4.0,
        fog_shadow_step: 4.0,
        fog_slabs: 16,
        ..Self::HIGH
    };
    /// A ray for four pixels, too, and copies of volumes far away, which take memory ([`VdbQuality::detail`]).
    pub const FAST: Self = Self {
        fog_step: 2.0,
        fog_light_step: 8.0,
        fog_shadow_step: 8.0,
        fog_slabs: 8,
        detail: 2.0,
        resolution: 0.5,
        ..Self::BALANCED
    };
    /// The presets by name, from the most accurate to the quickest.
    pub const PRESETS: [(&str, Self); 4] = [
        ("exact", Self::EXACT),
        ("high", Self::HIGH),
        ("balanced", Self::BALANCED),
        ("fast", Self::FAST),
    ];

    /// With the nearest values that make sense, and the name of the first that made none.
    pub(crate) fn sound(&self) -> (Self, Option<&'static str>) {
        let mut wrong = None;
        let mut within = |name, value: f32, least: f32, most: f32, otherwise: f32| {
            let sound = if value.is_nan() { otherwise } else { value.clamp(least, most) };
            if value != sound {
                wrong = wrong.or(Some(name));
            }
            sound
        };
        let step = if self.fog_step == 0.0 { 0.0 } else { LEAST_STEP };
        let sound = Self {
            traversal: self.traversal,
            shadows: self.shadows,
            shadow_range: within("shadow_range", self.shadow_range, 0.0, f32::INFINITY, 0.0),
            reflections: self.reflections.min(MOST_REFLECTIONS),
            reflection_range: within(
                "reflection_range",
                self.reflection_range,
                0.0,
                f32::INFINITY,
                0.0,
            ),
            fog_step: within("fog_step", self.fog_step, step, MOST_FOG_STEP, 0.0),
            fog_light_step: within(
                "fog_light_step",
                self.fog_light_step,
                LEAST_STEP,
                MOST_STEP,
                Self::HIGH.fog_light_step,
            ),
            fog_shadow_step: within(
                "fog_shadow_step",
                self.fog_shadow_step,
                LEAST_STEP,
                MOST_STEP,
                Self::HIGH.fog_shadow_step,
            ),
            fog_slabs: self.fog_slabs.clamp(1, MOST_SLABS),
            detail: within("detail", self.detail, 0.0, 64.0, 0.0),
            resolution: within("resolution", self.resolution, LEAST_RESOLUTION, 1.0, 1.0),
            accumulate: self.accumulate.min(MOST_FRAMES),
        };
        let slabs = (sound.fog_slabs != self.fog_slabs).then_some("fog_slabs");
        let bounces = (sound.reflections != self.reflections).then_some("reflections");
        let frames = (sound.accumulate != self.accumulate).then_some("accumulate");
        (sound, wrong.or(slabs).or(bounces).or(frames))
    }
}

impl Default for VdbQuality {
    fn default() -> Self {
        Self::HIGH
    }
}

/// What a volume has otherwise than the cameras' [`VdbQuality`]: a component of volumes. What is `None`
/// is the camera's to say.
#[derive(Clone, Component, Copy, Debug, Default, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbVolumeQuality {
    /// In place of [`VdbQuality::fog_step`], in voxels.
    pub fog_step: Option<f32>,
    /// In place of [`VdbQuality::fog_light_step`], in voxels.
    pub fog_light_step: Option<f32>,
    /// In place of [`VdbQuality::fog_shadow_step`], in voxels.
    pub fog_shadow_step: Option<f32>,
}

impl VdbVolumeQuality {
    /// What a camera takes for the volume.
    pub(crate) fn over(&self, camera: &VdbQuality) -> VdbQuality {
        VdbQuality {
            fog_step: self.fog_step.unwrap_or(camera.fog_step),
            fog_light_step: self.fog_light_step.unwrap_or(camera.fog_light_step),
            fog_shadow_step: self.fog_shadow_step.unwrap_or(camera.fog_shadow_step),
            ..*camera
        }
    }
}

/// How often a ray is sent on, at most.
const MOST_REFLECTIONS: u32 = 16;
/// Voxels between samples of fog: with less, steps would only cost.
const LEAST_STEP: f32 = 0.25;
const MOST_STEP: f32 = 64.0;
const MOST_FOG_STEP: f32 = 16.0;
const MOST_SLABS: u32 = 256;
const LEAST_RESOLUTION: f32 = 0.25;
const MOST_FRAMES: u32 = 256;

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
        let many = VdbQuality { accumulate: u32::MAX, ..plain() };
        assert_eq!((many.sound().0.accumulate, many.sound().1), (256, Some("accumulate")));
    }
}
