//! The first voxel and its face: exact, for every ray.

use vdb_core::pack::PackKind;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::{Blocky, Occupied};
use vdb_core::synth::Random;
use vdb_probe::judge::given::{self, Targets};
use vdb_probe::judge::voxels::judge;
use vdb_probe::judge::{Scene, Tally};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Suite, hash, send};
use crate::grids::{self, Named, Tree};
use crate::report::{Bound, Row};

pub const KIND: PackKind = PackKind::Surface { iso: 0.0 };

/// Rays of each grid of the matrix in the short form, of either kind.
pub const RAYS: usize = 22_000;
/// The same with ends.
pub const ENDED: usize = 40_000;

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
