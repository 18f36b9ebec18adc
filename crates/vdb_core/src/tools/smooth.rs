//! Volumes without their details.

use std::sync::Arc;

use super::build::{Formula, build, uppers};
use super::grid::{floats, level_set, pass, replaced};
use super::nodes::{Leaf, State};
use super::redistance::redistanced;
use super::samples::{Samples, Voxels, content, one_value, tile_at};
use super::{Redistance, ToolError};
use crate::tree::{Found, IVec3, Node, Vdb543};
use crate::work::{Stop, debug_options};
use crate::{Grid, GridClass, Limits, ProgressFn};

/// How values are smoothed once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// The surface of a level set moves towards the centre of its curvature, by a sixth of a voxel
    /// times the sum of both principal curvatures per voxel: what is small vanishes first.
    MeanCurvature,
    /// The mean of the voxels up to `width` away along each axis.
    Mean {
        /// From 1 to 8 voxels.
        width: u32,
    },
    /// Four such means in a row: nearly a Gaussian with a standard deviation of
    /// `sqrt(4/3 · width · (width + 1))` voxels.
    Gaussian {
        /// From 1 to 8 voxels.
        width: u32,
    },
}

/// Options of [`smooth`].
#[derive(Clone)]
pub struct Smooth {
    /// How values are smoothed once.
    pub filter: Filter,
    /// How often: 1 to 1,000 times.
    pub iterations: u32,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl Smooth {
    /// Once, with default limits.
    pub fn new(filter: Filter) -> Self {
        Self { filter, iterations: 1, limits: Limits::default(), progress: None }
    }
}

debug_options!(Smooth { filter, iterations, limits });

/// The most iterations.
const MOST_ITERATIONS: u32 = 1000;
/// The widest mean, in voxels on each side.
const MOST_WIDTH: u32 = 8;

/// Smooths a level set, or the values of another grid.
///
/// The distances of a level set are filtered within its band, and computed anew after each
/// iteration. The values of all other grids are filtered everywhere, so fog spreads into the voxels
/// around it, and its integral stays as it is.
///
/// Values that are not finite count as the background.
///
/// # Errors
/// If the grid is not of floats, the filter is one for level sets and the grid is none, a level set
/// has voxels that are no cubes, a setting is out of its range, no surface is left, the result would
/// exceed the limits, or it was cancelled.
pub fn smooth(grid: &Grid, options: &Smooth) -> Result<Grid, ToolError> {
    let tree = floats(grid)?;
    let bad = |setting, value: u32, range| {
        Err(ToolError::BadSetting { setting, value: f64::from(value), range })
    };
    if !(1..=MOST_ITERATIONS).contains(&options.iterations) {
        return bad("the number of iterations", options.iterations, "from 1 to 1000");
    }
    let weights = match options.filter {
        Filter::MeanCurvature => None,
        Filter::Mean { width } | Filter::Gaussian { width } => {
            if !(1..=MOST_WIDTH).contains(&width) {
                return bad("the width of the filter", width, "from 1 to 8 voxels");
            }
            let means = if matches!(options.filter, Filter::Mean { .. }) { 1 } else { 4 };
            Some(weights(width as usize, means))
        }
    };
    match (grid.class == GridClass::LevelSet, weights) {
        (true, weights) => smoothed_level_set(grid, weights, options),
        (false, Some(weights)) => Ok(replaced(grid, smoothed_fog(tree, &weights, options)?)),
        (false, None) => Err(ToolError::NotLevelSet { class: grid.class.name() }),
    }
}

/// The weights of a mean of `2 width + 1` values, applied several times.
fn weights(width: usize, times: u32) -> Vec<f32> {
    let mean = vec![1.0 / (2 * width + 1) as f64; 2 * width + 1];
    let mut all = vec![1.0];
    for _ in 0..times {
        let mut next = vec![0.0; all.len() + mean.len() - 1];
        for (i, a) in all.iter().enumerate() {
            for (j, b) in mean.iter().enumerate() {
                next[i + j] += a * b;
            }
        }
        all = next;
    }
    all.into_iter().map(|weight| weight as f32).collect()
}

fn smoothed_level_set(
    grid: &Grid,
    weights: Option<Vec<f32>>,
    options: &Smooth,
) -> Result<Grid, ToolError> {
    let (tree, edge, half_width) = level_set(grid)?;
    let passes = u64::from(options.iterations);
    let mut made: Option<Vdb543<f32>> = None;
    for done in 0..options.iterations {
        let own = made.as_ref().unwrap_or(tree);
        let formula = Band { tree: own, weights: weights.as_deref() };
        let uppers = own.entries().map(|(origin, _)| origin.to_array()).collect();
        let filtered = build(own.background(), uppers, &formula, &options.limits, None)
            .map_err(|stop| stopped(stop, tree))?;
        // The flow reaches one voxel on each side, so that the band has room for two steps of it.
        let has_room = weights.is_none() && done % 2 == 0 && half_width >= 3.0;
        if has_room && done + 1 < options.iterations {
            made = Some(filtered);
            continue;
        }
        let again = Redistance {
            half_width,
            limits: options.limits.clone(),
            progress: pass(options.progress.as_ref(), done.into(), passes),
            ..Redistance::default()
        };
        // What came before is not needed any more, and takes memory.
        made = None;
        made.replace(redistanced(&filtered, edge, &again).map_err(|error| match error {
            ToolError::NoTriangles => {
                ToolError::NothingLeft { after: format!("Smoothed {} times", done + 1) }
            }
            other => other,
        })?);
    }
    Ok(replaced(grid, made.unwrap_or_else(|| tree.clone())))
}

fn smoothed_fog(
    tree: &Vdb543<f32>,
    weights: &[f32],
    options: &Smooth,
) -> Result<Vdb543<f32>, ToolError> {
    let passes = u64::from(options.iterations);
    let mut made = None;
    for done in 0..options.iterations {
        let own = made.as_ref().unwrap_or(tree);
        let formula = Fog { tree: own, weights };
        let progress = pass(options.progress.as_ref(), done.into(), passes);
        let reach = formula.reach();
        let voxels = tree.active_voxel_count() as f64;
        let uppers = uppers(content(own).map(|own| own.widened(reach)))
            .ok_or(ToolError::TooManyVoxels { voxels, limit: options.limits.tree_bytes })?;
        let next = build(own.background(), uppers, &formula, &options.limits, progress.as_ref());
        made = Some(next.map_err(|stop| stopped(stop, tree))?);
    }
    Ok(made.unwrap_or_else(|| tree.clone()))
}

fn stopped(stop: Stop, tree: &Vdb543<f32>) -> ToolError {
    ToolError::stopped(stop, tree.active_voxel_count() as f64)
}

/// The means of the values in the band of a level set, or its flow by curvature.
struct Band<'a> {
    tree: &'a Vdb543<f32>,
    weights: Option<&'a [f32]>,
}

impl Formula for Band<'_> {
    type Scratch = Scratch;

    fn tile(&self, origin: IVec3, log2_dim: u32) -> Option<State> {
        tile_at(self.tree, origin, log2_dim)
    }

    fn fill(&self, leaf: &mut Leaf, scratch: &mut Scratch) {
        let Found::Leaf(own) = self.tree.find(leaf.origin()) else { return };
        let background = self.tree.background();
        let reach = self.weights.map_or(1, |weights| weights.len() as i64 / 2);
        let voxels = Voxels::around(leaf.origin(), Leaf::TOTAL_LOG2_DIM, reach);
        scratch.samples.read(&mut self.tree.accessor(), background, voxels);
        for value in &mut scratch.samples.values {
            *value = if value.is_nan() { background } else { value.clamp(-background, background) };
        }
        match self.weights {
            Some(weights) => scratch.convolve(weights, leaf.values_slice_mut()),
            None => scratch.flow(leaf.values_slice_mut()),
        }
        *leaf.value_mask_mut() = own.value_mask().clone();
        let values = leaf.values_slice_mut().iter_mut().zip(own.values_slice());
        for (value, &before) in values {
            // Beyond the band nothing is known, and nothing changes.
            *value = if before.abs() < background { *value } else { before };
        }
    }
}

/// The means of all values.
struct Fog<'a> {
    tree: &'a Vdb543<f32>,
    weights: &'a [f32],
}

impl Fog<'_> {
    fn reach(&self) -> i64 {
        self.weights.len() as i64 / 2
    }
}

impl Formula for Fog<'_> {
    type Scratch = Scratch;

    fn tile(&self, origin: IVec3, log2_dim: u32) -> Option<State> {
        let one = one_value(self.tree, Voxels::around(origin, log2_dim, self.reach()))?;
        Some(if one.0.is_finite() { one } else { (self.tree.background(), one.1) })
    }

    fn fill(&self, leaf: &mut Leaf, scratch: &mut Scratch) {
        let background = self.tree.background();
        let voxels = Voxels::around(leaf.origin(), Leaf::TOTAL_LOG2_DIM, self.reach());
        scratch.samples.read(&mut self.tree.accessor(), background, voxels);
        // Means of zeros are zero, whatever the weights.
        for value in &mut scratch.samples.values {
            *value = if value.is_finite() { *value - background } else { 0.0 };
        }
        scratch.convolve(self.weights, leaf.values_slice_mut());
        let own = self.tree.find(leaf.origin());
        for slot in 0..Leaf::SIZE {
            let was_active = match &own {
                Found::Tile(tile) => tile.active,
                Found::Leaf(own) => own.value_mask().is_on(slot),
            };
            let value = leaf.values_slice()[slot];
            leaf.values_slice_mut()[slot] = value + background;
            leaf.value_mask_mut().set(slot, was_active || value != 0.0);
        }
    }
}

/// Values around a leaf, and sums of them.
#[derive(Default)]
struct Scratch {
    samples: Samples,
    along_x: Vec<f32>,
    along_xy: Vec<f32>,
}

const EDGE: usize = Leaf::DIM as usize;

impl Scratch {
    /// Weighted sums along x, y and z in turn: rows along z are added as a whole.
    fn convolve(&mut self, weights: &[f32], out: &mut [f32]) {
        let wide = EDGE + weights.len() - 1;
        self.along_x.clear();
        self.along_x.resize(EDGE * wide * wide, 0.0);
        for (x, sums) in self.along_x.chunks_exact_mut(wide * wide).enumerate() {
            for (i, weight) in weights.iter().enumerate() {
                add(sums, *weight, &self.samples.values[(x + i) * wide * wide..]);
            }
        }
        self.along_xy.clear();
        self.along_xy.resize(EDGE * EDGE * wide, 0.0);
        for (row, sums) in self.along_xy.chunks_exact_mut(wide).enumerate() {
            let (x, y) = (row / EDGE, row % EDGE);
            for (i, weight) in weights.iter().enumerate() {
                add(sums, *weight, &self.along_x[(x * wide + y + i) * wide..]);
            }
        }
        for (row, sums) in out.chunks_exact_mut(EDGE).enumerate() {
            sums.fill(0.0);
            for (i, weight) in weights.iter().enumerate() {
                add(sums, *weight, &self.along_xy[row * wide + i..]);
            }
        }
    }

    /// A step of the flow by mean curvature of S. Osher and R. Fedkiw, "Level Set Methods and Dynamic
    /// Implicit Surfaces", 2003, equations 1.8 and 4.5; a third of a square voxel long, as OpenVDB's.
    fn flow(&self, out: &mut [f32]) {
        let [dx, dy, dz] = self.samples.steps();
        let all = &self.samples.values;
        for (slot, out) in out.iter_mut().enumerate() {
            let offset = Leaf::slot_offset(slot).to_array().map(|c| c as usize + 1);
            let at = offset[0] * dx + offset[1] * dy + offset[2] * dz;
            let value = |at: usize| f64::from(all[at]);
            let own = value(at);
            let slope = |step: usize| (value(at + step) - value(at - step)) / 2.0;
            let bend = |step: usize| value(at + step) - 2.0 * own + value(at - step);
            let twist = |a: usize, b: usize| {
                let same = value(at + a + b) + value(at - a - b);
                (same - value(at + a - b) - value(at - a + b)) / 4.0
            };
            let [x, y, z] = [dx, dy, dz].map(slope);
            let [xx, yy, zz] = [dx, dy, dz].map(bend);
            let squared = x * x + y * y + z * z;
            let pure = x * x * (yy + zz) + y * y * (xx + zz) + z * z * (xx + yy);
            let mixed = x * y * twist(dx, dy) + y * z * twist(dy, dz) + x * z * twist(dx, dz);
            // The sum of both curvatures times the slope.
            let change = (pure - 2.0 * mixed) / squared;
            *out = if change.is_finite() { (own + change / 6.0) as f32 } else { own as f32 };
        }
    }
}

/// Adds some values times a weight.
fn add(sums: &mut [f32], weight: f32, values: &[f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
}
