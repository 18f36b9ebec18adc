//! The first voxel and its face: exact, for every ray.

use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::standard::{self, Upper};
use vdb_core::reference::{Blocky, Face};
use vdb_core::tree::IVec3;

use super::scene::{Scene, reproduced};
use super::tally::Tally;
use crate::probe::{ProbeHit, ProbeRay};

/// Holds an answer against the reference tracer.
pub fn judge(
    scene: &Scene,
    oracle: &Blocky<'_, Upper>,
    ray: &ProbeRay,
    hit: &ProbeHit,
    tally: &mut Tally,
) {
    let exact = scene.exact(ray);
    let expected = standard::first_voxel(oracle, &exact);
    let found = (hit.hit != 0)
        .then(|| (IVec3::from_array(hit.cell).wrapping_add(scene.grid.base), hit.axis));
    let truth = expected.map(|hit| (hit.ijk, hit.face.map_or(3, |face: Face| face.axis.into())));
    tally.met += u64::from(expected.is_some());
    let mut wrong = found != truth;
    if wrong {
        let same = matches!((found, truth), (Some((a, _)), Some((b, _))) if a == b);
        tally.wrong_faces += u64::from(same);
    } else if let Some(expected) = expected {
        let t = f64::from(hit.t);
        let error = if expected.t == t { 0.0 } else { (t - expected.t).abs() / expected.t.abs() };
        tally.errors.add(error);
        wrong |= error > f64::from(T_ERROR);
    }
    if wrong || !scene.is_sound(hit) {
        tally.wrong += 1;
        tally.show(|| {
            format!(
                "{}: {found:?} at {} after {} steps, not {expected:?}",
                reproduced(ray),
                hit.t,
                hit.steps
            )
        });
    }
}
