//! Numbers on their way to shaders.

use bevy::math::{Affine3A, DAffine3, DMat3};

/// The number, or 0 where it is negative or NaN; infinity becomes the largest `f32`. WGSL has no
/// infinities.
pub(crate) fn non_negative(x: f32) -> f32 {
    if x > 0.0 { x.min(f32::MAX) } else { 0.0 }
}

/// The same transform in f64.
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

/// Multiples of the golden section, from 0 up to but not 1: spread evenly.
pub(crate) fn golden(frame: u32) -> f32 {
    (f64::from(frame) * 0.618_033_988_749_895).fract() as f32
}
