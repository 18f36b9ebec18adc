//! What part of the light passes a fog.

use vdb_core::pack::PackKind;
use vdb_core::synth::Random;
use vdb_probe::judge::fog::{HOMOGENEOUS, Judge, TRANSMITTANCE};
use vdb_probe::judge::given::{self, Targets};
use vdb_probe::judge::{Scene, Tally};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Suite, hash, send};
use crate::grids::{self, Named, Tree};
use crate::report::{Bound, Row};

pub const KIND: PackKind = PackKind::Fog;

/// Rays of each grid of the matrix in the short form, of either kind.
const RAYS: usize = 3_000;
/// The same with ends, and from far away nearly along an axis.
const ENDED: usize = 1_500;
const CREEPING: usize = 1_500;

/// The row of a case.
pub fn row(group: &'static str, case: &str, bound: f64, tally: &Tally) -> Row {
    let row = Row::new(group, case, "transmittance", Bound::Max(bound), tally);
    row.and(tally.steep, "thin edges of dense fog")
}

/// All rows of given rays.
pub fn run(suite: &mut Suite) {
    for Named { name, make } in grids::fogs() {
        if suite.wants(&format!("fog: {name}")) {
            given_rays(suite, &name, &make());
        }
    }
}

fn given_rays(suite: &mut Suite, name: &str, tree: &Tree) {
    let scene = Scene::new(suite.gpu, tree, KIND).expect("there is a density");
    let targets = Targets::new(tree, &scene.grid);
    let bound = if name.starts_with("homogeneous") { HOMOGENEOUS } else { TRANSMITTANCE };
    let judge = Judge::new(&scene, targets.reach(), bound);
    for (kind, make, count) in [
        ("random", given::plain as given::Make, RAYS),
        ("hard", given::hard, RAYS),
        ("ends", given::ended, ENDED),
        ("creeping", given::creeping, CREEPING),
    ] {
        let make = |random: &mut Random| make(random, &targets, &scene.grid);
        let seed = hash(name) ^ hash(kind);
        let judge =
            |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
        let tally = send(suite, &scene, seed, count * suite.some_times(), &make, &judge);
        let row = row("fog", &format!("{name}, {kind}"), bound, &tally);
        suite.report.add(row, &tally);
    }
}
