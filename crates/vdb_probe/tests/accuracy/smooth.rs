//! Where a smooth surface is, and its normals.

use vdb_core::pack::PackKind;
use vdb_core::synth::Random;
use vdb_probe::judge::given::{self, Targets};
use vdb_probe::judge::smooth::{FARTHEST_OFF, Judge, NORMAL, USUALLY_OFF};
use vdb_probe::judge::{Scene, Tally};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Suite, hash, send};
use crate::grids::{self, Named, Tree};
use crate::report::{Bound, Row};

pub const KIND: PackKind = PackKind::Smooth { iso: 0.0 };

/// Of a voxel.
const POSITION: Bound = Bound::Quantile(USUALLY_OFF, FARTHEST_OFF);

/// Rays of each grid of the matrix in the short form, of either kind.
const RAYS: usize = 6_000;
/// The same with ends, from far away nearly along an axis, and through centres of cells.
const ENDED: usize = 3_000;
const CREEPING: usize = 3_000;
const CENTRED: usize = 3_000;

/// The two rows of a case: positions, and normals.
pub fn add_rows(suite: &mut Suite, group: &'static str, case: &str, tally: &Tally, again: bool) {
    let row = Row::new(group, case, "voxels", POSITION, tally);
    suite.report.add(Row { again, ..row }, tally);
    let mut row = Row::of_errors(
        group,
        format!("{case}, normals"),
        "degrees",
        Bound::Max(NORMAL),
        &tally.angles,
    );
    (row.wrong, row.again) = (tally.wrong_normals, true);
    suite.report.add(row.and(tally.steep, "within 1e-3 voxel"), tally);
}

/// All rows of given rays.
pub fn run(suite: &mut Suite) {
    let offsets = grids::offsets().map(|(name, tree)| (format!("offset {name}"), tree));
    let named = grids::crossings().into_iter().map(|Named { name, make }| (name, make()));
    for (name, tree) in named.chain(offsets) {
        if suite.wants(&format!("smooth: {name}")) {
            given_rays(suite, &name, &tree);
        }
    }
}

fn given_rays(suite: &mut Suite, name: &str, tree: &Tree) {
    let scene = Scene::new(suite.gpu, tree, KIND).expect("there is a surface");
    let targets = Targets::new(tree, &scene.grid);
    let judge = Judge::new(&scene);
    for (kind, make, count) in [
        ("random", given::plain as given::Make, RAYS),
        ("hard", given::hard, RAYS),
        ("ends", given::ended, ENDED),
        ("creeping", given::creeping, CREEPING),
        ("centred", given::centred, CENTRED),
    ] {
        let make = |random: &mut Random| make(random, &targets, &scene.grid);
        let seed = hash(name) ^ hash(kind);
        let judge =
            |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
        let tally = send(suite, &scene, seed, count * suite.some_times(), &make, &judge);
        add_rows(suite, "smooth", &format!("{name}, {kind}"), &tally, false);
    }
}
