//! Level sets that grow or shrink.

use std::sync::Arc;

use super::grid::{level_set, pass, replaced};
use super::redistance::redistanced;
use super::{Redistance, ToolError};
use crate::work::debug_options;
use crate::{Grid, Limits, ProgressFn};

/// Options of [`offset`].
#[derive(Clone)]
pub struct Offset {
    /// The distance in world units by which the surface moves: outwards, or inwards if it is
    /// negative. At most 1,000 voxels.
    pub distance: f64,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl Offset {
    /// By a distance in world units, with default limits.
    pub fn new(distance: f64) -> Self {
        Self { distance, limits: Limits::default(), progress: None }
    }
}

debug_options!(Offset { distance, limits });

/// The most voxels to move by.
const FARTHEST: f64 = 1000.0;
/// The most voxels that the surface moves at once, however wide the band is.
const STEP: f64 = 4.0;
/// Voxels of a band beyond a surface in it: both ends of an edge that the surface crosses are as near.
const MARGIN: f64 = 1.0;

/// Half widths are quotients of floats, such as 2.9999998.
const ROUNDING: f64 = 1e-5;

/// Moves the surface of a level set outwards by a distance, or inwards by a negative one. All
/// distances are computed anew, in a band as wide as before.
///
/// Outwards, convex edges become round; inwards, what is thinner than twice the distance vanishes.
/// Both together, outwards and back, close gaps that are narrower than that.
///
/// # Errors
/// If the grid is no level set of floats with cubic voxels, the distance is out of its range, if no
/// surface is left, the result would exceed the limits, or it was cancelled.
pub fn offset(grid: &Grid, options: &Offset) -> Result<Grid, ToolError> {
    let (tree, edge, half_width) = level_set(grid)?;
    let voxels = options.distance / edge;
    // NaN is in no range.
    if !(-FARTHEST..=FARTHEST).contains(&voxels) {
        let (setting, range) = ("the offset in voxels", "from -1000 to 1000");
        return Err(ToolError::BadSetting { setting, value: voxels, range });
    }
    // As far as the band reaches. A wider one would take more time than it saves.
    let farthest = (f64::from(half_width) - MARGIN).clamp(MARGIN, STEP);
    let steps = (voxels.abs() / farthest - ROUNDING).ceil().max(1.0) as u64;
    let step = voxels / steps as f64;
    let needed = (step.abs() + MARGIN) as f32;
    let is_narrow = f64::from(half_width) < f64::from(needed) - 10.0 * ROUNDING;
    let passes = steps + u64::from(is_narrow);
    let moved = |iso: f64, is_last: bool, done: u64| Redistance {
        half_width: if is_last { half_width } else { needed.max(half_width) },
        iso: (iso * edge) as f32,
        limits: options.limits.clone(),
        progress: pass(options.progress.as_ref(), done, passes),
    };
    let mut made = None;
    if is_narrow {
        made = Some(redistanced(tree, edge, &moved(0.0, false, 0))?);
    }
    for done in 0..steps {
        let pass = done + u64::from(is_narrow);
        let moved = moved(step, done + 1 == steps, pass);
        let next = redistanced(made.as_ref().unwrap_or(tree), edge, &moved);
        made = Some(next.map_err(|error| match error {
            ToolError::NoTriangles => {
                let after = (done + 1) as f64 * step;
                ToolError::NothingLeft { after: format!("Moved by {after:.2} voxels") }
            }
            other => other,
        })?);
    }
    Ok(replaced(grid, made.unwrap_or_else(|| tree.clone())))
}
