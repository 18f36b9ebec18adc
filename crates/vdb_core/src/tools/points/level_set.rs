//! Level sets of points.

use std::f64::consts::PI;

use super::PointsToLevelSet;
use super::balls::{Ball, Balls};
use super::nodes::{Effect, Fill, Filled, build};
use crate::tools::ToolError;
use crate::tools::nodes::Leaf;
use crate::tree::{IVec3, Node, Vdb543};
use crate::work::Work;

/// Steps of the work.
const STEPS: u64 = 1000;

/// The tree of the union of some balls.
pub(super) fn level_set(
    balls: Balls,
    half_width: f64,
    options: &PointsToLevelSet,
) -> Result<Vdb543<f32>, ToolError> {
    let shell = |ball: &Ball| 4.0 * PI * ball.radius * ball.radius * 2.0 * half_width;
    let voxels = balls.balls.iter().map(shell).sum();
    let stopped = |stop| ToolError::stopped(stop, voxels);
    let work = Work::new(options.progress.as_ref(), STEPS, options.limits.tree_bytes);
    work.take(size_of_val(&*balls.balls) as u64).map_err(stopped)?;
    let background = (half_width * options.voxel_size) as f32;
    let union = Union { half_width, scale: options.voxel_size, background };
    let steps = |done, all: u64| done * STEPS / all.max(1);
    let tree = build(&balls.balls, background, &union, &work, &steps).map_err(stopped)?;
    work.finish().map_err(stopped)?;
    Ok(tree)
}

/// The union of balls.
struct Union {
    /// In voxels.
    half_width: f64,
    /// The edge of a voxel in world units.
    scale: f64,
    /// The half width in world units.
    background: f32,
}

impl Fill for Union {
    fn reach(&self, ball: &Ball) -> f64 {
        ball.radius + self.half_width
    }

    fn effect(&self, ball: &Ball, origin: IVec3, log2_dim: u32) -> Effect {
        let low = origin.as_dvec3();
        let high = low + f64::from((1_u32 << log2_dim) - 1);
        let nearest = (ball.center.clamp(low, high) - ball.center).length();
        let farthest = (ball.center - low).abs().max((ball.center - high).abs()).length();
        if nearest >= ball.radius + self.half_width {
            Effect::None
        } else if farthest <= ball.radius - self.half_width {
            Effect::All((-self.background, false))
        } else {
            Effect::Some
        }
    }

    fn fill<'a>(&self, balls: impl Iterator<Item = &'a Ball>, origin: IVec3) -> Filled {
        let mut distances = [self.half_width; Leaf::SIZE];
        let last = origin + (Leaf::DIM as i32 - 1);
        for ball in balls {
            let [low, high] = ball.voxels(self.reach(ball));
            let (low, high) = (low.max(origin), high.min(last));
            for x in low.x..=high.x {
                for y in low.y..=high.y {
                    let line = ((x - origin.x) * 8 + (y - origin.y)) * 8 - origin.z;
                    for z in low.z..=high.z {
                        let voxel = IVec3::new(x, y, z).as_dvec3();
                        let distance = (voxel - ball.center).length() - ball.radius;
                        let nearest = &mut distances[(line + z) as usize];
                        *nearest = nearest.min(distance);
                    }
                }
            }
        }
        let mut leaf = Leaf::filled(origin, self.background, false);
        for (slot, distance) in distances.into_iter().enumerate() {
            let distance = (distance * self.scale) as f32;
            // Compared as a float, so that active values are less than the background.
            leaf.value_mask_mut().set(slot, distance.abs() < self.background);
            leaf.values_slice_mut()[slot] = distance.clamp(-self.background, self.background);
        }
        match leaf.uniform() {
            Some(state) => Filled::Tile(state),
            None => Filled::Leaf(leaf),
        }
    }
}
