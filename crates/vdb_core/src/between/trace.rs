//! Paths along a flow.

use glam::DVec3;

use super::velocity::FlowSampler;

/// The most steps of a path: twice what [`MAX_DISPLACEMENT`](super::frame::MAX_DISPLACEMENT) takes in
/// steps of a voxel.
const STEPS: usize = 256;

/// The longest step, as a part of the time between two frames.
const LONGEST: f64 = 0.125;

/// Where a point at a time `t` is at a time `end`, by midpoint steps of at most about a voxel.
pub(super) fn traced(flow: &mut FlowSampler, p: DVec3, t: f64, end: f64) -> DVec3 {
    let (mut p, mut t) = (p, t);
    let way = (end - t).signum();
    for _ in 0..STEPS {
        let left = (end - t).abs();
        if left <= 0.0 {
            break;
        }
        let v = flow.at(p, t);
        let step = left.min(LONGEST).min(v.length().recip()).max(1.0 / STEPS as f64).min(left);
        let middle = flow.at(p + 0.5 * way * step * v, t + 0.5 * way * step);
        p += way * step * middle;
        t = if step == left { end } else { t + way * step };
    }
    p
}
