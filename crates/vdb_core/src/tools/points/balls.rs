//! The balls of points, in the space of the new voxels.

use glam::DVec3;

use crate::PointGrid;
use crate::tools::ToolError;
use crate::tree::IVec3;

/// A number for each point.
#[derive(Clone, Debug, PartialEq)]
pub enum PointNumber {
    /// The same number for all points.
    Constant(f64),
    /// An attribute that has one float per point.
    Attribute {
        /// The name of the attribute, such as `pscale`.
        name: String,
        /// A factor for its values.
        scale: f64,
    },
}

/// The farthest coordinate, in voxels. Coordinates of voxels have 32 bits.
const FARTHEST: f64 = (1_u32 << 30) as f64;

/// A ball in index space. All lengths are in voxels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    pub center: DVec3,
    pub radius: f64,
    /// Density times volume in voxels. Fog divides it by the sum of its weights.
    pub mass: f64,
}

impl Ball {
    /// The first and the last voxel in a box, at most `reach` from the centre along each axis.
    pub fn voxels(&self, reach: f64) -> [IVec3; 2] {
        [(self.center - reach).ceil().as_ivec3(), (self.center + reach).floor().as_ivec3()]
    }
}

/// The balls of all points.
pub(super) struct Balls {
    pub balls: Vec<Ball>,
}

impl Balls {
    /// The balls of points, without mass.
    pub fn new(
        points: &PointGrid,
        voxel_size: f64,
        radius: &PointNumber,
    ) -> Result<Self, ToolError> {
        if points.points.is_empty() {
            return Err(ToolError::NoPoints);
        }
        let radii = Numbers::new(points, radius, "the radius")?;
        let ball = |(point, world): (usize, DVec3)| {
            let center = world / voxel_size;
            let radius = radii.of(point)? / voxel_size;
            let voxels = center.abs().max_element() + radius;
            // NaN is caught by the second condition.
            match () {
                () if !world.is_finite() => {
                    Err(ToolError::PointNotFinite { point, position: world.to_array() })
                }
                () if voxels.is_nan() || voxels > FARTHEST => {
                    Err(ToolError::PointTooFar { point, voxels, limit: FARTHEST })
                }
                () => Ok(Ball { center, radius, mass: 0.0 }),
            }
        };
        let balls = points.world_positions().enumerate().map(ball);
        Ok(Self { balls: balls.collect::<Result<_, _>>()? })
    }
}

/// The numbers of all points.
pub(super) struct Numbers<'a> {
    setting: &'static str,
    values: Option<&'a [f32]>,
    factor: f64,
}

impl<'a> Numbers<'a> {
    pub fn new(
        points: &'a PointGrid,
        number: &PointNumber,
        setting: &'static str,
    ) -> Result<Self, ToolError> {
        let (values, factor) = match number {
            PointNumber::Constant(value) => (None, *value),
            PointNumber::Attribute { name, scale } => {
                let values = points.points.floats(name);
                let missing = || ToolError::NoSuchAttribute { name: name.clone() };
                (Some(values.ok_or_else(missing)?), *scale)
            }
        };
        if !factor.is_finite() || factor < 0.0 {
            let range = "a number from 0";
            return Err(ToolError::BadSetting { setting, value: factor, range });
        }
        Ok(Self { setting, values, factor })
    }

    /// The number of a point.
    pub fn of(&self, point: usize) -> Result<f64, ToolError> {
        let value = self.values.map_or(1.0, |values| f64::from(values[point])) * self.factor;
        if value.is_finite() && value >= 0.0 {
            return Ok(value);
        }
        Err(ToolError::BadPointValue { setting: self.setting, point, value })
    }
}
