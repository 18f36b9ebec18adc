//! Warnings about volumes that cannot be displayed as requested: each once, as long as it lasts.

use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use vdb_core::view::CannotShow;

use crate::render::gpu::types;

/// A problem with a volume in a view, or with a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Trouble {
    /// The volume is not displayed, because its numbers exceed the range of a shader.
    NotShown(CannotShow),
    /// The volume is displayed, but f32 cannot distinguish the rays of neighbouring pixels.
    Coarse,
    /// The volume's emission grid is a surface.
    NoDensity,
    /// An invalid field of the volume's material or emission was replaced by the nearest valid
    /// value.
    Setting(Setting),
    /// An invalid field of the volume's `VdbVolumeQuality` was replaced by the nearest valid value.
    Quality(&'static str),
    /// An invalid field of the camera's `VdbQuality` was replaced by the nearest valid value.
    CameraQuality(&'static str),
    /// The camera is jittered, so frames are already averaged by temporal anti-aliasing.
    Jittered,
    /// The means of all pixels of the camera exceed the largest buffer.
    TooManyPixels,
    /// There are more clip planes than bits.
    TooManyPlanes,
}

/// A field of a material or an emission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Setting {
    BaseColor,
    Emissive,
    PerceptualRoughness,
    Metallic,
    Reflectance,
    DensityScale,
    Anisotropy,
    EmissionScale,
    EmissionOffset,
    EmissionStrength,
    EmissionColor,
    RampStops,
}

impl Setting {
    /// The name of the field, and a description of valid values.
    fn describe(self) -> (&'static str, &'static str) {
        match self {
            Self::BaseColor => ("base_color", "components that are finite and not negative"),
            Self::Emissive => ("emissive", "components that are finite and not negative"),
            Self::PerceptualRoughness => ("perceptual_roughness", "a value from 0 to 1"),
            Self::Metallic => ("metallic", "a value from 0 to 1"),
            Self::Reflectance => ("reflectance", "a value from 0 to 1"),
            Self::DensityScale => ("density_scale", "a value that is finite and not negative"),
            Self::Anisotropy => ("anisotropy", "a value from -1 to 1"),
            Self::EmissionScale => ("scale", "a value that is finite and not negative"),
            Self::EmissionOffset => ("offset", "a value that is finite"),
            Self::EmissionStrength => ("strength", "a value that is finite and not negative"),
            Self::EmissionColor => ("color", "components that are finite and not negative"),
            Self::RampStops => {
                ("stops", "numbers that are finite and, except values, not negative")
            }
        }
    }

    /// The component that has the field.
    fn component(self) -> &'static str {
        match self {
            Self::EmissionScale
            | Self::EmissionOffset
            | Self::EmissionStrength
            | Self::EmissionColor => "VdbEmission",
            Self::RampStops => "VdbRamp",
            _ => "VdbMaterial",
        }
    }
}

/// The problems already reported, and those of this frame.
#[derive(Debug, Default, Resource)]
pub(crate) struct Warned {
    told: HashSet<(MainEntity, Trouble)>,
    now: HashSet<(MainEntity, Trouble)>,
}

impl Warned {
    /// Records a problem in this frame; returns the message if the problem is new.
    pub fn note(&mut self, entity: MainEntity, name: &str, trouble: Trouble) -> Option<String> {
        let is_new = self.now.insert((entity, trouble)) && !self.told.contains(&(entity, trouble));
        is_new.then(|| {
            let volume = format!("volume '{name}' of entity {}", entity.id());
            match trouble {
                Trouble::NotShown(why) => format!("{volume} is not shown: {why}"),
                Trouble::Coarse => format!(
                    "{volume} is shown coarsely: the camera's field of view is so narrow that f32 \
                     cannot distinguish the rays of neighbouring pixels; widen it, or move the \
                     camera closer"
                ),
                Trouble::NoDensity => format!(
                    "{volume} does not emit light: the grid of its VdbEmission is a surface; load \
                     it as fog with VdbLoaderSettings::render_as"
                ),
                Trouble::Quality(setting) => format!(
                    "{volume} is shown with the nearest valid {setting}: see the documentation of \
                     VdbQuality for the range of this field of its VdbVolumeQuality"
                ),
                Trouble::CameraQuality(setting) => format!(
                    "the camera of entity {} shows volumes with the nearest valid {setting}: see \
                     the documentation of VdbQuality for its range",
                    entity.id()
                ),
                Trouble::Jittered => format!(
                    "the camera of entity {} accumulates no frames of volumes: its temporal \
                     anti-aliasing already does; set VdbQuality::accumulate to 0, or remove the \
                     anti-aliasing",
                    entity.id()
                ),
                Trouble::TooManyPlanes => format!(
                    "{volume} is not cut by all of its clip planes: at most {} planes can be in use at once; share \
                     planes between volumes, or remove some",
                    types::MAX_CLIP_PLANES
                ),
                Trouble::TooManyPixels => format!(
                    "the camera of entity {} accumulates no frames of volumes: its image has more \
                     pixels than a buffer of this GPU can hold",
                    entity.id()
                ),
                Trouble::Setting(setting) => {
                    let (name, wanted) = setting.describe();
                    format!(
                        "{volume} is shown with the nearest valid {name}: give its {} {wanted}",
                        setting.component()
                    )
                }
            }
        })
    }

    /// Why a volume is not displayed in a view of this frame, once that has ended.
    pub fn why_not_shown(&self, entity: MainEntity) -> Option<CannotShow> {
        let is_noted = |why: &CannotShow| self.told.contains(&(entity, Trouble::NotShown(*why)));
        CannotShow::ALL.into_iter().find(is_noted)
    }

    /// Forgets problems that this frame no longer has.
    pub fn end_frame(&mut self) {
        self.told = std::mem::take(&mut self.now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trouble_is_told_once_while_it_lasts() {
        let mut world = World::new();
        let [one, two] = [(); 2].map(|()| MainEntity::from(world.spawn_empty().id()));
        let far = Trouble::NotShown(CannotShow::TooFar);
        let mut warned = Warned::default();
        let text = warned.note(one, "smoke", far).unwrap();
        assert!(text.contains("'smoke'") && text.contains(&one.id().to_string()), "{text}");
        assert!(text.contains("not shown: the camera is more than"), "{text}");
        assert!(warned.note(one, "smoke", far).is_none(), "a second view sees the same");
        let text = warned.note(two, "smoke", Trouble::Setting(Setting::Metallic)).unwrap();
        assert!(text.contains("metallic") && text.contains("from 0 to 1"), "{text}");
        let text = warned.note(two, "smoke", Trouble::Coarse).unwrap();
        assert!(text.contains(&two.id().to_string()) && text.contains("coarsely"), "{text}");
        for _ in 0..3 {
            warned.end_frame();
            assert_eq!(warned.why_not_shown(one), Some(CannotShow::TooFar));
            assert_eq!(warned.why_not_shown(two), None, "it is shown coarsely");
            assert!(warned.note(one, "smoke", far).is_none());
            assert!(warned.note(two, "smoke", Trouble::Coarse).is_none());
        }
        warned.end_frame();
        assert!(warned.note(one, "smoke", Trouble::Coarse).is_some(), "that is another trouble");
        warned.end_frame();
        assert!(warned.note(one, "smoke", far).is_some(), "it was over, and is back");
    }
}
