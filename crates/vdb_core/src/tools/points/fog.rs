//! Fog of points.

use std::f64::consts::PI;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::PointsToFog;
use super::balls::{Ball, Balls, Numbers};
use super::nodes::{Effect, Fill, Filled, build};
use crate::PointGrid;
use crate::tools::ToolError;
use crate::tools::nodes::Leaf;
use crate::tree::{IVec3, Node, Vdb543};
use crate::work::Work;

/// Steps of each of the two passes.
const STEPS: u64 = 1000;

/// Balls between two reports.
const CHUNK: usize = 64;

/// The tree of the fog of some balls.
pub(super) fn fog(
    points: &PointGrid,
    mut balls: Balls,
    options: &PointsToFog,
) -> Result<Vdb543<f32>, ToolError> {
    let densities = Numbers::new(points, &options.density, "the density")?;
    let mut voxels = 0.0;
    for (point, ball) in balls.balls.iter_mut().enumerate() {
        let volume = volume(ball.radius);
        voxels += volume.max(8.0);
        ball.mass = densities.of(point)? * if ball.radius > 0.0 { volume } else { 1.0 };
    }
    let stopped = |stop| ToolError::stopped(stop, voxels);
    let work = Work::new(options.progress.as_ref(), 2 * STEPS, options.limits.tree_bytes);
    work.take(size_of_val(&*balls.balls) as u64).map_err(stopped)?;
    let (done, all) = (AtomicU64::new(0), balls.balls.len().div_ceil(CHUNK) as u64);
    let weigh = |balls: &mut [Ball]| {
        for ball in balls {
            ball.mass /= total_weight(ball);
        }
        work.report((done.fetch_add(1, Ordering::Relaxed) + 1) * STEPS / all)
    };
    balls.balls.par_chunks_mut(CHUNK).try_for_each(weigh).map_err(stopped)?;
    let steps = |done, all: u64| STEPS + done * STEPS / all.max(1);
    let tree = build(&balls.balls, 0.0, &Fog, &work, &steps).map_err(stopped)?;
    work.finish().map_err(stopped)?;
    Ok(tree)
}

/// The volume of a ball in voxels.
fn volume(radius: f64) -> f64 {
    4.0 / 3.0 * PI * radius.powi(3)
}

/// The least radius in voxels for a kernel. No voxel is farther than 0.87 from a point.
const LEAST: f64 = 1.0;

/// The weight of a voxel.
fn weight(ball: &Ball, voxel: DVec3) -> f64 {
    let offset = voxel - ball.center;
    if ball.radius < LEAST {
        let axes = (1.0 - offset.abs()).max(DVec3::ZERO);
        return axes.x * axes.y * axes.z;
    }
    let rest = 1.0 - offset.length_squared() / (ball.radius * ball.radius);
    if rest > 0.0 { rest * rest * rest } else { 0.0 }
}

/// The sum of the weights of all voxels.
fn total_weight(ball: &Ball) -> f64 {
    /// From here on, the sum is the integral to within 1e-7 of it.
    const LARGE: f64 = 32.0;
    if ball.radius < LEAST {
        return 1.0;
    }
    if ball.radius >= LARGE {
        return 64.0 / 315.0 * PI * ball.radius.powi(3);
    }
    let [low, high] = ball.voxels(ball.radius);
    let mut sum = 0.0;
    each_voxel(low, high, |voxel| sum += weight(ball, voxel.as_dvec3()));
    sum
}

fn each_voxel(low: IVec3, high: IVec3, mut visit: impl FnMut(IVec3)) {
    for x in low.x..=high.x {
        for y in low.y..=high.y {
            for z in low.z..=high.z {
                visit(IVec3::new(x, y, z));
            }
        }
    }
}

struct Fog;

impl Fill for Fog {
    fn reach(&self, ball: &Ball) -> f64 {
        ball.radius.max(LEAST)
    }

    fn effect(&self, ball: &Ball, origin: IVec3, log2_dim: u32) -> Effect {
        let low = origin.as_dvec3();
        let high = low + f64::from((1_u32 << log2_dim) - 1);
        let nearest = ball.center.clamp(low, high);
        // The weights of small balls reach the corners of a cube.
        let reach = if ball.radius < LEAST { 2.0 } else { ball.radius };
        let is_far = (nearest - ball.center).length_squared() >= reach * reach;
        if is_far || ball.mass <= 0.0 { Effect::None } else { Effect::Some }
    }

    fn fill<'a>(&self, balls: impl Iterator<Item = &'a Ball>, origin: IVec3) -> Filled {
        let mut sums = [0.0_f64; Leaf::SIZE];
        for ball in balls {
            let [low, high] = ball.voxels(self.reach(ball));
            let last = origin + (Leaf::DIM as i32 - 1);
            each_voxel(low.max(origin), high.min(last), |voxel| {
                let [x, y, z] = (voxel - origin).to_array().map(|c| c as usize);
                sums[(x * 8 + y) * 8 + z] += ball.mass * weight(ball, voxel.as_dvec3());
            });
        }
        let mut leaf = Leaf::filled(origin, 0.0, false);
        let mut any = false;
        for (slot, sum) in sums.into_iter().enumerate() {
            let density = sum as f32;
            if density > 0.0 {
                leaf.values_slice_mut()[slot] = density;
                leaf.value_mask_mut().set(slot, true);
                any = true;
            }
        }
        if any { Filled::Leaf(leaf) } else { Filled::Tile((0.0, false)) }
    }
}
