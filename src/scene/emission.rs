//! Further grids of a volume: what colours it, and what shines in it.

use bevy::prelude::*;

use crate::{VdbGrid, VdbVectorGrid};

/// A colour from place to place: a grid of vectors beside the one of a [`VdbVolume`](crate::VdbVolume),
/// as a rule of the same file (Houdini calls it `Cd`), whose value where a ray meets the surface multiplies
/// the material's base colour. Linear Rec.709.
///
/// The grid may have another transform than the volume's: both stand in the world of their file, which the
/// entity's `Transform` places. Between samples it is trilinear, and outside of them its background. Surfaces
/// alone are coloured; fog has the colour of its [`VdbMaterial`](crate::VdbMaterial).
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbColorGrid(pub Handle<VdbVectorGrid>);

/// Light that a volume sends of its own, out of a second grid: fire. For entities with a
/// [`VdbVolume`](crate::VdbVolume), whose density dims it.
///
/// A place with the emission coefficient `ε`, in cd/m² per world unit, adds `ε ds` to the luminance of a ray
/// that passes it for `ds`; what is before it dims that: `L = ∫ T ε ds`, with `T` the part of light that
/// the fogs of the scene let through. So a layer of thickness `L` without smoke has `ε L`, and one that
/// absorbs with the coefficient `σ` has `ε/σ · (1 - e^(-σL))`. What shines need not be dense: where the
/// density is zero, fire is seen as well. (The `emissive` of a material, in contrast, is the luminance of fog
/// where it is opaque.)
///
/// The grids stand in the file's world, as that of the volume does, and may have other transforms. Between
/// samples they are trilinear; only what is above zero shines. Their light is seen by cameras, directly and in
/// reflections; other things are not lit by it.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, PartialEq)]
pub enum VdbEmission {
    /// Black bodies: `ε = strength · B(scale · value + offset)`, with `B` the luminance and colour of a
    /// black body, by Planck's law and the CIE's observer of 1931.
    ///
    /// Programs write temperatures in units of their own. Kelvin have a `scale` of 1. Where 1 stands
    /// for something hot, as in Houdini's and Blender's `temperature`, `scale` is how hot in kelvin: 1,000
    /// is what Blender's Principled Volume takes. Blender's `flame`, from 0 to 1, goes from the
    /// temperature at which fuel burns to the highest one: a `scale` and an `offset` of 1,500 each by its
    /// defaults. Flames of candles and wood have 1,100 to 1,900 K.
    Temperature {
        /// What is above zero shines. Has to be one that is shown as fog.
        grid: Handle<VdbGrid>,
        /// Kelvin per unit of the values. 0 or more.
        scale: f32,
        /// Kelvin added to that, where the value is above zero.
        offset: f32,
        /// How much of a black body's luminance a world unit of depth has, in 1 / world unit: by Kirchhoff's
        /// law the absorption coefficient of the hot gas and soot. 0 or more.
        strength: f32,
    },
    /// Values as they are: `ε = color · value`.
    Scalar {
        /// What is above zero shines. Has to be one that is shown as fog.
        grid: Handle<VdbGrid>,
        /// For a value of 1, in cd/m² per world unit.
        color: LinearRgba,
    },
    /// Colours: `ε = strength · value`.
    Color {
        /// Linear Rec.709; what is above zero shines.
        grid: Handle<VdbVectorGrid>,
        /// cd/m² per world unit for a value of 1. 0 or more.
        strength: f32,
    },
}

impl VdbEmission {
    /// Black bodies whose temperatures are in kelvin, with a strength of 1.
    pub fn kelvin(grid: Handle<VdbGrid>) -> Self {
        Self::Temperature { grid, scale: 1.0, offset: 0.0, strength: 1.0 }
    }
}
