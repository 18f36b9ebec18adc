//! The component that makes fire light its surroundings.

use bevy::prelude::*;

/// Makes the fire of a [`VdbEmission`](crate::VdbEmission) light its surroundings: meshes, surfaces
/// and fog, through a few of Bevy's point lights, which are spawned as children of the volume.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// let temperature = assets.load("fire.vdb#temperature");
/// commands.spawn((
///     VdbVolume(assets.load("fire.vdb#density")),
///     VdbEmission::kelvin(temperature),
///     VdbEmissionLight::default(),
/// ));
/// # }
/// ```
///
/// The lights have the luminous power and colour of the emission, less the light absorbed by the
/// volume's own smoke. From a distance of half the fire's radius, they light objects like the fire
/// itself; `docs/reference/fog.md` has the errors. They follow the emission, the frames of a
/// [`VdbPlayer`](crate::VdbPlayer), edits and the transform. When a grid is shown for the first time,
/// its values are summarised in the background; until then, the previous lights stay. Without this
/// component, or without a renderer, nothing is computed.
///
/// The lights are isotropic: smoke on one side of a fire dims it on all sides, unless
/// [`shadows`](Self::shadows) are on.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbEmissionLight {
    /// The largest number of point lights, from 1 to 32. 8 by default. A fire gets as many as its
    /// shape needs: one if it is round, several if it is long.
    pub max_lights: u32,
    /// Multiplies the light on other objects. 0 or more; 1, the default, is the emitted light.
    pub intensity: f32,
    /// Whether the lights cast shadows. Off by default. If on, meshes and volumes cast shadows, and
    /// the volume's own smoke absorbs light only in the directions where there is smoke, provided that
    /// [`VdbQuality::shadows`](crate::VdbQuality::shadows) and
    /// [`VdbCamera::mesh_shadows`](crate::VdbCamera::mesh_shadows) are on. Each light then has a
    /// shadow map with six faces, so reduce their number with [`max_lights`](Self::max_lights).
    pub shadows: bool,
    /// The illuminance in lux at which the light of a fire ends. More than 0; 1 by default, which on
    /// a white surface is less than an 8-bit step at Bevy's default exposure. Smaller values extend
    /// the range of the lights, and with it their cost. At ten times this illuminance, the falloff
    /// towards the end of the range takes away 2 %.
    pub min_illuminance: f32,
}

impl Default for VdbEmissionLight {
    fn default() -> Self {
        Self { max_lights: 8, intensity: 1.0, shadows: false, min_illuminance: 1.0 }
    }
}

impl VdbEmissionLight {
    /// The component with values out of range replaced by the nearest valid ones, and NaNs by the
    /// defaults.
    pub(super) fn nearest_valid(&self) -> Self {
        let sound = |x: f32, otherwise: f32| if x.is_nan() { otherwise } else { x };
        Self {
            max_lights: self.max_lights.clamp(1, 32),
            intensity: sound(self.intensity, 1.0).clamp(0.0, 1e15),
            shadows: self.shadows,
            min_illuminance: sound(self.min_illuminance, 1.0).clamp(1e-6, 1e15),
        }
    }
}
