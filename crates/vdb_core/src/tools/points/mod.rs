//! Points to volumes: each point is a ball.
//!
//! The balls are sorted into the nodes of 128³ that they reach, and each node sorts its own into its
//! leaves. So a leaf only sees the balls near it, in the order of the points, and its values do not
//! depend on the number of threads.

mod balls;
mod fog;
mod level_set;
mod nodes;

use std::sync::Arc;

use self::balls::Balls;
pub use self::balls::PointNumber;
use super::ToolError;
use super::from_mesh::input;
use crate::work::debug_options;
use crate::{AnyTree, Grid, GridClass, Limits, PointGrid, ProgressFn};

/// Options of [`points_to_fog`].
#[derive(Clone)]
pub struct PointsToFog {
    /// The edge of a voxel in world units: positive.
    pub voxel_size: f64,
    /// The radius of a point in world units, at least 0.
    pub radius: PointNumber,
    /// The mean density within the radius of a point, at least 0.
    pub density: PointNumber,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl PointsToFog {
    /// Voxels of this size, points without a radius and with a density of 1, and default limits.
    pub fn new(voxel_size: f64) -> Self {
        Self {
            voxel_size,
            radius: PointNumber::Constant(0.0),
            density: PointNumber::Constant(1.0),
            limits: Limits::default(),
            progress: None,
        }
    }
}

debug_options!(PointsToFog { voxel_size, radius, density, limits });

/// Options of [`points_to_level_set`].
#[derive(Clone)]
pub struct PointsToLevelSet {
    /// The edge of a voxel in world units: positive.
    pub voxel_size: f64,
    /// The radius of a point in world units. Points with a radius of 0 are left out.
    pub radius: PointNumber,
    /// Voxels from the surface to either end of the band: 1 to 100. 3 by default, as OpenVDB's.
    pub half_width: f32,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl PointsToLevelSet {
    /// Voxels of this size, points of this radius, a band of three voxels on each side, and default
    /// limits.
    pub fn new(voxel_size: f64, radius: PointNumber) -> Self {
        let limits = Limits::default();
        Self { voxel_size, radius, half_width: 3.0, limits, progress: None }
    }
}

debug_options!(PointsToLevelSet { voxel_size, radius, half_width, limits });

/// Makes fog of points: the sum of the densities of all points.
///
/// The mass of a point is its density times the volume of a ball of its radius. It is distributed
/// over the voxels in that ball by the kernel (1 − d²/r²)³, where d is the distance from the point
/// and r its radius. The mass of a point whose radius is less than a voxel goes to the eight voxels
/// around it, by trilinear weights; a point without a radius has the volume of one voxel. So the sum
/// of all voxels times the volume of a voxel is the mass of all points.
///
/// Voxel (0, 0, 0) is at the origin of the world. Voxels with density are active. The result has the
/// name `density`.
///
/// # Errors
/// If there are no points, a position is not finite or more than 2³⁰ voxels away, an attribute is
/// missing, a radius or density is negative or not finite, the voxel size is not positive, the fog
/// would exceed the limits, or it was cancelled.
///
/// ```
/// use glam::DVec3;
/// use vdb_core::tools::{PointNumber, PointsToFog, points_to_fog};
/// use vdb_core::{PointGrid, Points};
///
/// let points = PointGrid::new("spray", Points::new(vec![DVec3::ZERO, DVec3::new(1.0, 0.5, 0.0)]));
/// let radius = PointNumber::Constant(0.3);
/// let fog = points_to_fog(&points, &PointsToFog { radius, ..PointsToFog::new(0.1) })?;
/// // The voxels that are less than three voxels from either point.
/// assert_eq!(fog.tree.active_voxel_count(), 2 * 93);
/// # Ok::<(), vdb_core::tools::ToolError>(())
/// ```
pub fn points_to_fog(points: &PointGrid, options: &PointsToFog) -> Result<Grid, ToolError> {
    let transform = input::transform(options.voxel_size)?;
    let balls = Balls::new(points, options.voxel_size, &options.radius)?;
    let tree = fog::fog(points, balls, options)?;
    let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
    grid.class = GridClass::FogVolume;
    grid.transform = transform;
    Ok(grid)
}

/// Makes the level set of points: the union of their balls.
///
/// Each voxel of the band gets the exact distance to the surface of the nearest ball, negative in a
/// ball. Where balls overlap, this is less deep than the distance to the surface of their union;
/// [`redistance`](super::redistance()) restores that. Balls that are smaller than about a voxel may
/// fall between the voxels, and then have no surface.
///
/// A voxel is active where the distance is less than the half width. The rest is inactive and holds
/// ± the half width, as tiles where a whole node does. Voxel (0, 0, 0) is at the origin of the
/// world. The result has the name `surface`.
///
/// # Errors
/// If no point has a radius above 0, a position is not finite or more than 2³⁰ voxels away, an
/// attribute is missing, a radius is negative or not finite, an option is out of its range, the
/// level set would exceed the limits, or it was cancelled.
///
/// ```
/// use glam::DVec3;
/// use vdb_core::tools::{PointNumber, PointsToLevelSet, points_to_level_set};
/// use vdb_core::{PointGrid, Points};
///
/// let points = Points::new(vec![DVec3::ZERO, DVec3::X]).with_floats("pscale", vec![0.5, 0.7]);
/// let points = PointGrid::new("drops", points.expect("two points have two radii"));
/// let radius = PointNumber::Attribute { name: "pscale".to_owned(), scale: 1.0 };
/// let surface = points_to_level_set(&points, &PointsToLevelSet::new(0.05, radius))?;
/// assert!(surface.tree.active_voxel_count() > 10_000);
/// # Ok::<(), vdb_core::tools::ToolError>(())
/// ```
pub fn points_to_level_set(
    points: &PointGrid,
    options: &PointsToLevelSet,
) -> Result<Grid, ToolError> {
    let transform = input::transform(options.voxel_size)?;
    let half_width = input::half_width(options.half_width)?;
    let mut balls = Balls::new(points, options.voxel_size, &options.radius)?;
    balls.balls.retain(|ball| ball.radius > 0.0);
    if balls.balls.is_empty() {
        return Err(ToolError::NoRadii);
    }
    let tree = level_set::level_set(balls, half_width, options)?;
    let mut grid = Grid::new("surface", AnyTree::Float(tree.into()));
    grid.class = GridClass::LevelSet;
    grid.transform = transform;
    Ok(grid)
}
