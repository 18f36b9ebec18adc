//! The first voxel and its face: exact, for every ray.

use vdb_core::pack::PackKind;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::{Blocky, Face, Occupied, standard};
use vdb_core::synth::Random;
use vdb_core::tree::IVec3;
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Scene, Suite, hash, reproduced, send};
use crate::given::{self, Targets};
use crate::grids::{self, Named, Tree, Upper};
use crate::report::{Bound, Row};
use crate::tally::Tally;

pub const KIND: PackKind = PackKind::Surface { iso: 0.0 };

/// Rays of each grid of the matrix in the short form, of either kind.
pub const RAYS: usize = 22_000;
/// The same with ends.
pub const ENDED: usize = 40_000;

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

/// All rows of given rays.
pub fn run(suite: &mut Suite) {
    for Named { name, make } in grids::solids() {
        if suite.wants(&format!("voxels: {name}")) {
            given_rays(suite, &name, &make());
        }
    }
    for (name, tree) in grids::offsets() {
        if suite.wants(&format!("voxels: offset {name}")) {
            given_rays(suite, &format!("offset {name}"), &tree);
        }
    }
}

/// Random rays, hard ones and ones with ends through a grid.
fn given_rays(suite: &mut Suite, name: &str, tree: &Tree) {
    let scene = Scene::new(suite.gpu, tree, KIND).expect("there are voxels");
    let targets = Targets::new(tree, &scene.grid);
    let oracle = Blocky::new(tree, Occupied::BelowIso(0.0));
    let judge =
        |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge(&scene, &oracle, ray, hit, tally);
    for (kind, make, count) in [
        ("random", given::plain as given::Make, RAYS),
        ("hard", given::hard, RAYS),
        ("ends", given::ended, ENDED),
    ] {
        let make = |random: &mut Random| make(random, &targets, &scene.grid);
        let seed = hash(name) ^ hash(kind);
        let tally = send(suite, &scene, seed, count * suite.times, &make, &judge);
        let row = Row::new(
            "voxels",
            format!("{name}, {kind}"),
            "of t",
            Bound::Max(f64::from(T_ERROR)),
            &tally,
        );
        suite.report.add(row, &tally);
    }
}
