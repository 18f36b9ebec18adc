//! Auxiliary grids of a volume: colour, emission and velocity.

use bevy::asset::UntypedAssetId;
use bevy::prelude::*;

use crate::{VdbGrid, VdbVectorGrid};

/// The largest emission coefficient, and the largest factor: no sum along a ray exceeds f32.
pub(crate) const MAX_EMISSION: f32 = 1e15;
/// The largest temperature in kelvin, and in kelvin per unit.
const MAX_KELVIN: f32 = 1e9;

/// Colours a volume with a vector grid, usually from the same file as the
/// [`VdbVolume`](crate::VdbVolume)'s grid (Houdini calls it `Cd`). Its value, in linear Rec. 709,
/// multiplies the material's base colour: at the hit point of a surface, and everywhere in fog,
/// which then has a varying albedo.
///
/// The grid may have a different transform from the volume's: both are placed in the world of their
/// file, which the entity's `Transform` maps to Bevy's. It is interpolated trilinearly, and has
/// the background value outside its samples. In fog, it is looked up at each step of a ray, or once for
/// each interval that shares its light ([`VdbQuality::fog_light_step`](crate::VdbQuality)). It
/// changes neither the density of fog nor the colour of `emissive`.
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbColorGrid(pub Handle<VdbVectorGrid>);

/// The velocity of a volume's contents, for motion vectors: temporal anti-aliasing and motion blur
/// then follow smoke instead of smearing it. Has no effect on cameras without a
/// `MotionVectorPrepass`, nor on pixels where more than half of the background is visible through
/// the fog.
///
/// The grid may have a different transform from the volume's: both are placed in the world of their
/// file. Velocities are averaged over 8³ voxels or more and interpolated, so smaller eddies move
/// with their surroundings. The offset of half a voxel in staggered grids is neglected.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// // The player sets the grid and the time step. Houdini's velocities are per second.
/// let smoke = assets.load_vdb_sequence("smoke/smoke_####.vdb");
/// commands.spawn((VdbPlayer::new(smoke), VdbVelocity::new(1.0)));
/// # }
/// ```
#[derive(Clone, Component, Debug, Default, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbVelocity {
    /// The velocities, along the axes of the file's world, which are those of the entity's local
    /// space.
    pub grid: Handle<VdbVectorGrid>,
    /// Units of the file's world per second at a velocity of 1: 1 for Houdini; for Blender's fluid
    /// caches 2.5 times the edge of a voxel, at its default time scale. 0, no motion, by default.
    pub scale: f32,
    /// Seconds of simulated time from the frame displayed in the previous update to the one displayed
    /// in this update: 0, the default, if they are the same; negative if time runs backwards.
    /// [`VdbPlayer`](crate::VdbPlayer) sets it. An app that replaces grids itself sets it in every
    /// update.
    pub time_step: f32,
}

impl VdbVelocity {
    /// Velocities of a [`VdbPlayer`](crate::VdbPlayer), which sets the grid and the time step.
    pub fn new(scale: f32) -> Self {
        Self { scale, ..Self::default() }
    }
}

/// Makes a volume emit light from a second grid: fire. For entities with a
/// [`VdbVolume`](crate::VdbVolume), whose density attenuates it.
///
/// With the emission coefficient `ε`, in cd/m² per world unit, the luminance along a ray is `L = ∫
/// T ε ds`, where `T` is the transmittance of all fog in front. A layer of thickness `d` without
/// smoke has the luminance `ε d`; one with absorption coefficient `σ` has `ε/σ · (1 - e^(-σd))`.
/// Fire is visible even where the density is zero. (A material's `emissive`, in contrast, is the
/// luminance of opaque fog.)
///
/// The grids are placed in the file's world, like the volume's, and may have different transforms.
/// They are interpolated trilinearly, and only positive values emit. Cameras see the light directly
/// and in reflections. It lights other objects with a
/// [`VdbEmissionLight`](crate::VdbEmissionLight).
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, PartialEq)]
pub enum VdbEmission {
    /// Black bodies: `ε = strength · B(scale · value + offset)`, with `B` the luminance and colour
    /// of a black body by Planck's law and the CIE 1931 observer.
    ///
    /// Programs store temperatures in different units. For kelvin, use a `scale` of 1. Where 1 stands
    /// for "hot", as in Houdini's and Blender's `temperature`, `scale` is that temperature in
    /// kelvin; Blender's Principled Volume uses 1,000. Blender's `flame`, from 0 to 1, runs from
    /// the ignition temperature to the maximum: with Blender's defaults, a `scale` and an `offset`
    /// of 1,500 each. Flames of candles and wood are at 1,100 to 1,900 K.
    Temperature {
        /// Positive values emit. The grid must be loaded as fog.
        grid: Handle<VdbGrid>,
        /// Kelvin per unit of the values. 0 or more.
        scale: f32,
        /// Kelvin added where the value is positive.
        offset: f32,
        /// The fraction of a black body's luminance emitted per world unit of depth, in 1 / world
        /// unit: by Kirchhoff's law, the absorption coefficient of the hot gas and soot. 0 or more.
        strength: f32,
    },
    /// Values as they are: `ε = color · value`.
    Scalar {
        /// Positive values emit. The grid must be loaded as fog.
        grid: Handle<VdbGrid>,
        /// Emission for a value of 1, in cd/m² per world unit.
        color: LinearRgba,
    },
    /// Colours: `ε = strength · value`.
    Color {
        /// Linear Rec. 709; positive values emit.
        grid: Handle<VdbVectorGrid>,
        /// Emission for a value of 1, in cd/m² per world unit. 0 or more.
        strength: f32,
    },
}

impl VdbEmission {
    /// Black bodies with temperatures in kelvin and a strength of 1.
    pub fn kelvin(grid: Handle<VdbGrid>) -> Self {
        Self::Temperature { grid, scale: 1.0, offset: 0.0, strength: 1.0 }
    }

    /// The asset ID of the grid.
    pub(crate) fn grid_id(&self) -> UntypedAssetId {
        match self {
            Self::Temperature { grid, .. } | Self::Scalar { grid, .. } => grid.id().untyped(),
            Self::Color { grid, .. } => grid.id().untyped(),
        }
    }

    /// Whether the emission has a grid, loaded or not.
    pub(crate) fn has_grid(&self) -> bool {
        match self {
            Self::Temperature { grid, .. } | Self::Scalar { grid, .. } => {
                *grid != Handle::default()
            }
            Self::Color { grid, .. } => *grid != Handle::default(),
        }
    }

    /// The emission with fields out of range replaced by the nearest valid values.
    pub(crate) fn nearest_valid(&self) -> Self {
        // `f32::max` returns the other operand if one is NaN.
        let within = |x: f32, most: f32| x.max(0.0).min(most);
        let mut emission = self.clone();
        match &mut emission {
            Self::Temperature { scale, offset, strength, .. } => {
                *scale = within(*scale, MAX_KELVIN);
                *offset = if offset.is_nan() { 0.0 } else { *offset };
                *offset = offset.clamp(-MAX_KELVIN, MAX_KELVIN);
                *strength = within(*strength, MAX_EMISSION);
            }
            Self::Scalar { color, .. } => {
                let sound = color.to_vec3().map(|x| within(x, MAX_EMISSION));
                *color = LinearRgba::from_vec3(sound).with_alpha(color.alpha);
            }
            Self::Color { strength, .. } => *strength = within(*strength, MAX_EMISSION),
        }
        emission
    }
}
