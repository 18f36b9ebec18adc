//! Transforms from index space (voxels) to world space.

use glam::{DAffine3, DMat3, DVec3};

use crate::Error;

/// The transform of a grid from index space to world space, as stored in its file.
///
/// Positions match OpenVDB's bit for bit: each kind of map is evaluated in OpenVDB's order of
/// operations, in f64. In index space, voxel `ijk` is centred at the point `ijk`.
#[derive(Clone, Debug, PartialEq)]
pub struct Transform {
    pub(crate) map: Map,
}

/// The kinds of map in OpenVDB.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Map {
    UniformScale(DVec3),
    Scale(DVec3),
    Translation(DVec3),
    UniformScaleTranslate { scale: DVec3, translation: DVec3 },
    ScaleTranslate { scale: DVec3, translation: DVec3 },
    Unitary(Affine),
    Affine(Affine),
    NonlinearFrustum(Frustum),
}

/// A 4×4 matrix in row-major order, multiplied by row vectors from the left, and its inverse.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Affine {
    pub(crate) rows: [[f64; 4]; 4],
    inverse: DAffine3,
}

/// A box in index space, tapered into a camera frustum and placed by a linear map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frustum {
    /// Corners of the box in index space.
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
    /// The width of the near plane divided by that of the far plane.
    pub(crate) taper: f64,
    /// The distance between the planes divided by the width of the near plane.
    pub(crate) depth: f64,
    pub(crate) second: Affine,
}

impl Affine {
    /// `None` if the matrix is singular, or its last column is not (0, 0, 0, 1).
    pub(crate) fn new(rows: [[f64; 4]; 4]) -> Option<Self> {
        let affine = forward(&rows);
        let inverse = affine.inverse();
        let last: [f64; 4] = std::array::from_fn(|i| rows[i][3]);
        let det = affine.matrix3.determinant();
        (last == [0.0, 0.0, 0.0, 1.0] && det != 0.0 && inverse.is_finite() && affine.is_finite())
            .then_some(Self { rows, inverse })
    }

    /// The matrix of a linear map, under the same conditions.
    pub(crate) fn from_linear(world_from_index: DAffine3) -> Option<Self> {
        let DAffine3 { matrix3: m, translation: t } = world_from_index;
        let row = |v: DVec3, w: f64| [v.x, v.y, v.z, w];
        Self::new([row(m.x_axis, 0.0), row(m.y_axis, 0.0), row(m.z_axis, 0.0), row(t, 1.0)])
    }

    fn apply(&self, p: DVec3) -> DVec3 {
        let m = &self.rows;
        let axis = |i: usize| p.x * m[0][i] + p.y * m[1][i] + p.z * m[2][i] + m[3][i];
        DVec3::new(axis(0), axis(1), axis(2))
    }
}

fn forward(m: &[[f64; 4]; 4]) -> DAffine3 {
    let row = |i: usize| DVec3::new(m[i][0], m[i][1], m[i][2]);
    DAffine3 { matrix3: DMat3::from_cols(row(0), row(1), row(2)), translation: row(3) }
}

impl Frustum {
    fn extents(&self) -> DVec3 {
        self.max - self.min
    }

    fn gamma(&self) -> f64 {
        (1.0 / self.taper - 1.0) / self.depth
    }

    fn apply(&self, p: DVec3) -> DVec3 {
        let size = self.extents();
        let mut out = p - self.min;
        out.x -= 0.5 * size.x;
        out.y -= 0.5 * size.y;
        out.z *= self.depth / size.z;
        let scale = (self.gamma() * out.z + 1.0) / size.x;
        out.x *= scale;
        out.y *= scale;
        self.second.apply(out)
    }

    fn apply_inverse(&self, p: DVec3) -> DVec3 {
        let size = self.extents();
        let mut out = self.second.inverse.transform_point3(p);
        let scale = size.x / (self.gamma() * out.z + 1.0);
        out.x = out.x * scale + 0.5 * size.x;
        out.y = out.y * scale + 0.5 * size.y;
        out.z /= self.depth / size.z;
        out + self.min
    }
}

impl Default for Transform {
    /// One voxel per world unit.
    fn default() -> Self {
        Self { map: Map::UniformScale(DVec3::ONE) }
    }
}

impl Transform {
    /// Cubic voxels of the given size, with voxel (0, 0, 0) at `translation`.
    ///
    /// `None` if the size is zero or not finite, or the translation is not finite.
    pub fn uniform(voxel_size: f64, translation: DVec3) -> Option<Self> {
        let scale = DVec3::splat(voxel_size);
        let map = if translation == DVec3::ZERO {
            Map::UniformScale(scale)
        } else {
            Map::UniformScaleTranslate { scale, translation }
        };
        Self { map }.checked().ok()
    }

    /// Any linear map; `None` if it is singular or not finite.
    pub fn affine(world_from_index: DAffine3) -> Option<Self> {
        Affine::from_linear(world_from_index).map(|affine| Self { map: Map::Affine(affine) })
    }

    /// The transform, if it can be inverted.
    pub(crate) fn checked(self) -> Result<Self, Error> {
        let (scale, translation) = match &self.map {
            Map::UniformScale(scale) | Map::Scale(scale) => (*scale, DVec3::ZERO),
            Map::Translation(translation) => (DVec3::ONE, *translation),
            Map::UniformScaleTranslate { scale, translation }
            | Map::ScaleTranslate { scale, translation } => (*scale, *translation),
            // An `Affine` always has an inverse.
            Map::Unitary(_) | Map::Affine(_) => return Ok(self),
            Map::NonlinearFrustum(frustum) => {
                let size = frustum.extents();
                let sound = size.is_finite()
                    && size.cmpne(DVec3::ZERO).all()
                    && frustum.taper.is_finite()
                    && frustum.taper != 0.0
                    && frustum.depth.is_finite()
                    && frustum.depth != 0.0;
                return sound.then_some(self).ok_or_else(|| {
                    Error::invalid("the frustum map has no extent, no taper or no depth")
                });
            }
        };
        let sound = scale.is_finite()
            && scale.recip().is_finite()
            && scale.cmpne(DVec3::ZERO).all()
            && translation.is_finite();
        sound.then_some(self).ok_or_else(|| {
            Error::invalid(format!(
                "a map of scale {scale} and translation {translation} has no inverse"
            ))
        })
    }

    /// The kind of map, as OpenVDB names it: `UniformScaleMap`, `ScaleMap`, `TranslationMap`,
    /// `UniformScaleTranslateMap`, `ScaleTranslateMap`, `UnitaryMap`, `AffineMap` or
    /// `NonlinearFrustumMap`.
    pub fn map_type(&self) -> &'static str {
        match &self.map {
            Map::UniformScale(_) => "UniformScaleMap",
            Map::Scale(_) => "ScaleMap",
            Map::Translation(_) => "TranslationMap",
            Map::UniformScaleTranslate { .. } => "UniformScaleTranslateMap",
            Map::ScaleTranslate { .. } => "ScaleTranslateMap",
            Map::Unitary(_) => "UnitaryMap",
            Map::Affine(_) => "AffineMap",
            Map::NonlinearFrustum(_) => "NonlinearFrustumMap",
        }
    }

    /// Whether the map is linear, as all but frustums are.
    pub fn is_linear(&self) -> bool {
        !matches!(self.map, Map::NonlinearFrustum(_))
    }

    /// The world position of a point in index space.
    pub fn world_from_index(&self, p: DVec3) -> DVec3 {
        match &self.map {
            Map::UniformScale(scale) | Map::Scale(scale) => p * *scale,
            Map::Translation(translation) => p + *translation,
            Map::UniformScaleTranslate { scale, translation }
            | Map::ScaleTranslate { scale, translation } => p * *scale + *translation,
            Map::Unitary(affine) | Map::Affine(affine) => affine.apply(p),
            Map::NonlinearFrustum(frustum) => frustum.apply(p),
        }
    }

    /// The point in index space at a world position.
    pub fn index_from_world(&self, p: DVec3) -> DVec3 {
        match &self.map {
            Map::UniformScale(scale) | Map::Scale(scale) => p * scale.recip(),
            Map::Translation(translation) => p - *translation,
            Map::UniformScaleTranslate { scale, translation }
            | Map::ScaleTranslate { scale, translation } => (p - *translation) * scale.recip(),
            Map::Unitary(affine) | Map::Affine(affine) => affine.inverse.transform_point3(p),
            Map::NonlinearFrustum(frustum) => frustum.apply_inverse(p),
        }
    }

    /// The corners of a frustum's box in index space; `None` for a linear map.
    pub(crate) fn frustum_box(&self) -> Option<[DVec3; 2]> {
        match &self.map {
            Map::NonlinearFrustum(frustum) => {
                Some([frustum.min.min(frustum.max), frustum.min.max(frustum.max)])
            }
            _ => None,
        }
    }

    /// Whether a world position is on the side of a frustum's apex that the frustum is on; always for
    /// a linear map.
    pub(crate) fn is_before_apex(&self, p: DVec3) -> bool {
        match &self.map {
            Map::NonlinearFrustum(frustum) => {
                let depth = frustum.second.inverse.transform_point3(p).z;
                frustum.gamma() * depth + 1.0 > 0.0
            }
            _ => true,
        }
    }

    /// The map as a matrix from index to world space; `None` for a frustum.
    pub fn linear(&self) -> Option<DAffine3> {
        Some(match &self.map {
            Map::UniformScale(scale) | Map::Scale(scale) => DAffine3::from_scale(*scale),
            Map::Translation(translation) => DAffine3::from_translation(*translation),
            Map::UniformScaleTranslate { scale, translation }
            | Map::ScaleTranslate { scale, translation } => {
                DAffine3 { matrix3: DMat3::from_diagonal(*scale), translation: *translation }
            }
            Map::Unitary(affine) | Map::Affine(affine) => forward(&affine.rows),
            Map::NonlinearFrustum(_) => return None,
        })
    }

    /// The size of the voxel at the origin of index space along its own axes, in world units.
    pub fn voxel_size(&self) -> DVec3 {
        let origin = self.world_from_index(DVec3::ZERO);
        let along = |axis: DVec3| (self.world_from_index(axis) - origin).length();
        DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z))
    }
}
