//! Conversions of numbers for shaders.

use bevy::math::{Affine3A, DAffine3, DMat3};

/// Replaces negative numbers and NaN by 0, and infinity by the largest `f32`: WGSL may assume that
/// there are no infinities and NaNs.
pub(crate) fn non_negative(x: f32) -> f32 {
    if x > 0.0 { x.min(f32::MAX) } else { 0.0 }
}

/// Converts a transform to f64.
pub(crate) fn affine(m: Affine3A) -> DAffine3 {
    DAffine3 {
        matrix3: DMat3::from_cols(
            m.matrix3.x_axis.as_dvec3(),
            m.matrix3.y_axis.as_dvec3(),
            m.matrix3.z_axis.as_dvec3(),
        ),
        translation: m.translation.as_dvec3(),
    }
}

/// The fractional part of a multiple of the golden ratio, in [0, 1): an additive recurrence with
/// low discrepancy.
pub(crate) fn golden(frame: u32) -> f32 {
    (f64::from(frame) * 0.618_033_988_749_895).fract() as f32
}
