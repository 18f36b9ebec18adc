//! What an app is told of volumes that cannot be shown as they should: once, while it lasts.

use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use vdb_core::view::CannotShow;

/// What is wrong with a volume in a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Trouble {
    /// The numbers are beyond what a shader can compute with.
    NotShown(CannotShow),
    /// It is shown, but pixels are closer together than f32 tells directions apart.
    Coarse,
    /// What is to shine in it is a surface.
    NoDensity,
    /// It is shown, but with a value that makes sense instead of its material's or its emission's.
    Setting(Setting),
    /// It is shown, but with a value that makes sense instead of its own `VdbVolumeQuality`'s.
    Quality(&'static str),
    /// Of a camera: the same of its `VdbQuality`.
    CameraQuality(&'static str),
    /// Of a camera: what jitters its picture puts frames together already.
    Jittered,
    /// Of a camera: its pixels' means do not fit into a buffer.
    TooManyPixels,
}

/// A setting of a material, or of what shines.
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
}

impl Setting {
    /// Its name, and what it has to be.
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
        }
    }

    /// The component that has it.
    fn component(self) -> &'static str {
        match self {
            Self::EmissionScale
            | Self::EmissionOffset
            | Self::EmissionStrength
            | Self::EmissionColor => "VdbEmission",
            _ => "VdbMaterial",
        }
    }
}

/// What has been told of, and what is wrong in this frame.
#[derive(Debug, Default, Resource)]
pub(crate) struct Warned {
    told: HashSet<(MainEntity, Trouble)>,
    now: HashSet<(MainEntity, Trouble)>,
}

impl Warned {
    /// Notes what is wrong in this frame; gives what to say of it if that is new.
    pub fn note(&mut self, entity: MainEntity, name: &str, trouble: Trouble) -> Option<String> {
        let is_new = self.now.insert((entity, trouble)) && !self.told.contains(&(entity, trouble));
        is_new.then(|| {
            let volume = format!("volume '{name}' of entity {}", entity.id());
            match trouble {
                Trouble::NotShown(why) => format!("{volume} is not shown: {why}"),
                Trouble::Coarse => format!(
                    "{volume} is shown coarsely: the camera's field of view is so narrow that a \
                     pixel is finer than the directions of rays in f32; widen it, or bring the \
                     camera closer"
                ),
                Trouble::NoDensity => format!(
                    "{volume} does not shine: the grid of its VdbEmission is a surface; load it with \
                     the loader setting render_as as fog"
                ),
                Trouble::Quality(setting) => format!(
                    "{volume} is shown with the nearest {setting} that makes sense: the documentation \
                     of VdbQuality has the range for its VdbVolumeQuality"
                ),
                Trouble::CameraQuality(setting) => format!(
                    "the camera of entity {} shows volumes with the nearest {setting} that makes sense: \
                     the documentation of VdbQuality has the range",
                    entity.id()
                ),
                Trouble::Jittered => format!(
                    "the camera of entity {} accumulates no frames of volumes: its temporal \
                     anti-aliasing does that; set VdbQuality::accumulate to 0, or take that away",
                    entity.id()
                ),
                Trouble::TooManyPixels => format!(
                    "the camera of entity {} accumulates no frames of volumes: its picture has more \
                     pixels than a buffer of this GPU holds",
                    entity.id()
                ),
                Trouble::Setting(setting) => {
                    let (name, wanted) = setting.describe();
                    format!(
                        "{volume} is shown with the nearest {name} that makes sense: give its {} \
                         {wanted}",
                        setting.component()
                    )
                }
            }
        })
    }

    /// Forgets what is over.
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
            assert!(warned.note(one, "smoke", far).is_none());
            assert!(warned.note(two, "smoke", Trouble::Coarse).is_none());
        }
        warned.end_frame();
        assert!(warned.note(one, "smoke", Trouble::Coarse).is_some(), "that is another trouble");
        warned.end_frame();
        assert!(warned.note(one, "smoke", far).is_some(), "it was over, and is back");
    }
}
