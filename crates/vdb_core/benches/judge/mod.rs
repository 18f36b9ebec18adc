//! The true distance to the surface of a level set, by brute force: which of two results is nearer to it.

use glam::{DVec3, IVec3};
use vdb_core::tree::Vdb543;

/// The distance of a point, in index space, to the nearest root of the trilinear interpolant; `reach`
/// if none is nearer. Negative where the interpolant is.
///
/// Nothing here is shared with the tools: in a box the interpolant has its extremes at the corners, so
/// a box has a root if the signs of its corners differ, and none otherwise. Boxes are cut into eight
/// until their edge is 1/256 of a voxel, so the result is off by less than 0.004 voxels.
pub fn distance(tree: &Vdb543<f32>, p: DVec3, reach: f64) -> f64 {
    let (low, high) = ((p - reach).floor().as_ivec3(), (p + reach).floor().as_ivec3());
    let mut nearest = reach;
    let mut accessor = tree.accessor();
    for x in low.x..=high.x {
        for y in low.y..=high.y {
            for z in low.z..=high.z {
                let origin = IVec3::new(x, y, z);
                let corners =
                    CORNERS.map(|corner| f64::from(accessor.get(origin + corner.as_ivec3())));
                cut(p, origin.as_dvec3(), 1.0, corners, &mut nearest);
            }
        }
    }
    let cell = p.floor();
    let corners = CORNERS.map(|corner| f64::from(accessor.get((cell + corner).as_ivec3())));
    if interpolated(corners, p - cell) < 0.0 { -nearest } else { nearest }
}

/// Corner `4x + 2y + z` of a box.
const CORNERS: [DVec3; 8] = [
    DVec3::new(0.0, 0.0, 0.0),
    DVec3::new(0.0, 0.0, 1.0),
    DVec3::new(0.0, 1.0, 0.0),
    DVec3::new(0.0, 1.0, 1.0),
    DVec3::new(1.0, 0.0, 0.0),
    DVec3::new(1.0, 0.0, 1.0),
    DVec3::new(1.0, 1.0, 0.0),
    DVec3::new(1.0, 1.0, 1.0),
];

fn interpolated(corners: [f64; 8], at: DVec3) -> f64 {
    let weight = |corner: DVec3| (DVec3::ONE - corner - at).abs().element_product();
    CORNERS.iter().zip(corners).map(|(corner, value)| weight(*corner) * value).sum()
}

/// Lowers `nearest` to the distance of the nearest root in a box.
fn cut(p: DVec3, low: DVec3, edge: f64, corners: [f64; 8], nearest: &mut f64) {
    if p.distance(p.clamp(low, low + edge)) >= *nearest {
        return;
    }
    // As in the tools, zero is outside.
    let inside = corners.iter().filter(|value| **value < 0.0).count();
    if inside == 0 || inside == 8 {
        return;
    }
    if edge <= 1.0 / 256.0 {
        *nearest = nearest.min(p.distance(low + edge / 2.0));
        return;
    }
    for part in CORNERS {
        let own = CORNERS.map(|corner| interpolated(corners, (part + corner) / 2.0));
        cut(p, low + part * edge / 2.0, edge / 2.0, own, nearest);
    }
}

/// How far two results are from the truth, where they differ by more than a voxel.
#[derive(Default)]
pub struct Judgement {
    /// Voxels that differ by more than one voxel, and those in which ours is nearer.
    count: u64,
    ours_nearer: u64,
    /// Voxels in which the sign is not that of the interpolant.
    signs: [u64; 2],
    /// The sums and the largest of the errors.
    sums: [f64; 2],
    most: [f64; 2],
    /// The voxel with the largest difference: where it is, ours, OpenVDB's and the truth.
    worst: Option<(IVec3, [f64; 3])>,
}

impl Judgement {
    /// Adds a voxel; all in voxels.
    pub fn add(&mut self, ijk: IVec3, values: [f64; 2], truth: f64) {
        let errors = values.map(|value| (value - truth).abs());
        self.count += 1;
        self.ours_nearer += u64::from(errors[0] < errors[1]);
        for side in 0..2 {
            self.signs[side] += u64::from((values[side] < 0.0) != (truth < 0.0));
            self.sums[side] += errors[side];
            self.most[side] = self.most[side].max(errors[side]);
        }
        let difference = |values: [f64; 2]| (values[0] - values[1]).abs();
        if self.worst.is_none_or(|(_, [a, b, _])| difference([a, b]) < difference(values)) {
            self.worst = Some((ijk, [values[0], values[1], truth]));
        }
    }

    /// Prints it.
    pub fn show(&self, task: &str) {
        let Some((ijk, [ours, theirs, truth])) = self.worst else { return };
        let mean = |side: usize| self.sums[side] / self.count as f64;
        eprintln!(
            "{task}: {} voxels differ by more than one; ours is nearer to the truth in {}. Errors are \
             {:.3} on average, at most {:.3}, with {} wrong signs; OpenVDB's {:.3}, {:.3} and {}. \
             Most at {ijk}: {ours:.3}, OpenVDB's {theirs:.3}, truly {truth:.3}",
            self.count,
            self.ours_nearer,
            mean(0),
            self.most[0],
            self.signs[0],
            mean(1),
            self.most[1],
            self.signs[1],
        );
    }
}
