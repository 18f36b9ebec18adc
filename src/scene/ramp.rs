//! Transfer functions: the optical properties of fog as a function of its values.

use bevy::prelude::*;

/// Maps the values of a fog volume to its optical properties: a transfer function, for scientific data
/// such as CT scans, and for art, such as smoke that is blue where thin and orange where thick.
///
/// For a value `v` of the [`VdbVolume`](crate::VdbVolume)'s grid, interpolated trilinearly,
///
/// - the extinction coefficient is `density_scale · extinction(v)`, in 1 / world unit, in place of
///   `density_scale · v`;
/// - the single-scattering albedo is `base_color · color(v)`, times the
///   [`VdbColorGrid`](crate::VdbColorGrid) if there is one;
/// - the emission coefficient is `emission(v)`, in cd/m² per world unit. A layer of thickness `d` that
///   absorbs nothing has the luminance `emission · d`. It does not depend on `density_scale`, and
///   lights no other object.
///
/// `density_scale` and `base_color` are those of the [`VdbMaterial`](crate::VdbMaterial). The three
/// functions are linear between [stops](Self::stops), and constant below the first and above the last
/// one. The mapping is applied after the interpolation and integrated over all values along each
/// stretch of a ray, so even the thinnest shell is visible.
///
/// Only values above 0 exist in fog: where all samples around a point are 0 or less, the space is
/// empty, whatever the ramp says. Data with negative values, such as Hounsfield units, need an offset
/// when the grid is made. A first stop with an extinction of 0 avoids a hard edge at the border of
/// the stored values.
///
/// Volumes cast and receive shadows according to their mapped extinction. Surfaces ignore ramps, and
/// so do the rays of [`VdbSpatialQuery`](crate::VdbSpatialQuery).
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// let [blue, orange] = [Color::srgb(0.5, 0.7, 1.0), Color::srgb(1.0, 0.5, 0.2)];
/// // Extinction is the density, up to 1, as without a ramp.
/// let ramp = VdbRamp::new([
///     VdbRampStop { value: 0.0, extinction: 0.0, color: blue, ..default() },
///     VdbRampStop { value: 1.0, extinction: 1.0, color: orange, ..default() },
/// ]);
/// commands.spawn((VdbVolume(assets.load("smoke.vdb")), ramp));
/// # }
/// ```
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbRamp {
    /// The points of the functions, in any order. Where two have the same value, the functions jump
    /// from the first to the second. Without stops, the ramp has no effect.
    pub stops: Vec<VdbRampStop>,
}

/// A point of a [`VdbRamp`]. Numbers that are negative, infinite or NaN are replaced by the nearest
/// valid ones, with a warning.
#[derive(Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq)]
pub struct VdbRampStop {
    /// The value of the grid. 0 by default.
    pub value: f32,
    /// The extinction coefficient for a `density_scale` of 1, in 1 / world unit. 0 or more, 0 by
    /// default.
    pub extinction: f32,
    /// The single-scattering albedo. White by default.
    pub color: Color,
    /// The emission coefficient, in cd/m² per world unit. 0 or more, black by default.
    pub emission: LinearRgba,
}

impl VdbRamp {
    /// A ramp with these stops.
    pub fn new(stops: impl IntoIterator<Item = VdbRampStop>) -> Self {
        Self { stops: stops.into_iter().collect() }
    }
}

impl Default for VdbRamp {
    /// Extinction equals the value, from 0 to 1.
    fn default() -> Self {
        let stop = |value| VdbRampStop { value, extinction: value, ..default() };
        Self::new([stop(0.0), stop(1.0)])
    }
}

impl Default for VdbRampStop {
    fn default() -> Self {
        Self { value: 0.0, extinction: 0.0, color: Color::WHITE, emission: LinearRgba::BLACK }
    }
}
