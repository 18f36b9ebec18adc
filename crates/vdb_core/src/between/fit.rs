//! The unit of a velocity grid, found by trying.

use glam::DVec3;
use rayon::prelude::*;

use super::frame::Frame;
use super::place::Pair;
use super::sample::Sampler;
use super::trace::traced;
use super::velocity::Flow;
use crate::Error;
use crate::tree::{LeafNode, Node};

/// At most as many voxels of each frame are compared.
const POINTS: u64 = 4096;
/// Displacements of the fastest voxel that are tried, in voxels: from ¼ to 90, by factors of √2.
const TRIED: i32 = 18;
/// Steps of the search between two of them; each divides the interval by 1.6.
const STEPS: usize = 6;
/// The error that is left, relative to leaving the first frame where it is, must be less.
const USEFUL: f64 = 0.9;

/// Finds the scale of velocities, in world units from one frame to the next per unit, by which the
/// first frame, carried along them, is most like the second. `None` if there are no velocities in
/// both frames, or if carrying the first frame hardly helps.
///
/// # Errors
/// Those of [`in_between`](super::in_between) for grids of the wrong types.
pub fn fit_velocity_scale(from: Frame, to: Frame) -> Result<Option<f64>, Error> {
    let (Some(a), Some(b)) = (from.velocity, to.velocity) else { return Ok(None) };
    let pair = Pair::new(from.grid, to.grid)?;
    let points = points(&pair);
    // Scales are relative to one world unit.
    let flow = Flow::new(&pair, a, b, 1.0)?;
    let fastest = fastest(&flow, &points);
    if !(fastest > 0.0 && fastest.is_finite()) {
        return Ok(None);
    }
    let error = |log: f64| error(&pair, &flow, &points, log.exp2() / fastest);
    let tried: Vec<f64> = (0..TRIED).map(|i| f64::from(i) * 0.5 - 2.0).collect();
    let errors: Vec<f64> = tried.iter().map(|log| error(*log)).collect();
    let Some(best) = (0..errors.len()).min_by(|i, k| errors[*i].total_cmp(&errors[*k])) else {
        return Ok(None);
    };
    let (mut low, mut high) = (tried[best] - 0.5, tried[best] + 0.5);
    // Golden-section search.
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..STEPS {
        let (x, y) = (high - golden * (high - low), low + golden * (high - low));
        if error(x) < error(y) { high = y } else { low = x }
    }
    let found = 0.5 * (low + high);
    let still = self::error(&pair, &flow, &points, 0.0);
    Ok((error(found) < USEFUL * still).then(|| found.exp2() / fastest))
}

/// Voxels of both frames.
fn points(pair: &Pair) -> Vec<DVec3> {
    let mut points = Vec::new();
    for frame in [&pair.from, &pair.to] {
        let every = (frame.tree.active_voxel_count() / POINTS).max(1) as usize;
        let active = frame.tree.leaves().flat_map(|leaf| {
            leaf.value_mask()
                .iter_on()
                .map(move |slot| leaf.origin() + LeafNode::<f32, 3>::slot_offset(slot))
        });
        points.extend(active.step_by(every).map(|ijk| frame.first(ijk.as_dvec3())));
    }
    points
}

/// The largest displacement, less the fastest percent, before it is limited.
fn fastest(flow: &Flow, points: &[DVec3]) -> f64 {
    // So small that no displacement is limited.
    const SMALL: f64 = 1e-9;
    let mut sampler = flow.sampler(SMALL);
    let mut speeds: Vec<f64> = points.iter().map(|p| sampler.at(*p, 0.5).length()).collect();
    speeds.sort_by(f64::total_cmp);
    speeds.get(speeds.len() * 99 / 100).map_or(0.0, |speed| speed / SMALL)
}

/// The sum of the differences between the first frame, carried to the time of the second, and the second.
fn error(pair: &Pair, flow: &Flow, points: &[DVec3], scale: f64) -> f64 {
    let errors: Vec<f64> = points
        .par_iter()
        .map_init(
            || (flow.sampler(scale), Sampler::new(pair.from.tree), Sampler::new(pair.to.tree)),
            |(flow, from, to), p| {
                let carried = from.linear(pair.from.own(traced(flow, *p, 1.0, 0.0)));
                (carried - to.linear(pair.to.own(*p))).abs()
            },
        )
        .collect();
    // In the same order each time, so that the result is the same.
    errors.iter().sum()
}
