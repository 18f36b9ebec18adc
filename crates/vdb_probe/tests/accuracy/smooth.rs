//! Where a smooth surface is, and its normals.

use vdb_core::pack::{PackKind, traverse};
use vdb_core::synth::Random;
use vdb_probe::judge::given::{self, Targets};
use vdb_probe::judge::smooth::{FARTHEST_OFF, Judge, NORMAL, USUALLY_OFF};
use vdb_probe::judge::{Scene, Tally, judged};
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
    let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
    for (kind, make, count) in [
        ("random", given::plain as given::Make, RAYS),
        ("hard", given::hard, RAYS),
        ("ends", given::ended, ENDED),
        ("creeping", given::creeping, CREEPING),
        ("centred", given::centred, CENTRED),
    ] {
        let make = |random: &mut Random| make(random, &targets, &scene.grid);
        let seed = hash(name) ^ hash(kind);
        let tally = send(suite, &scene, seed, count * suite.some_times(), &make, &judge);
        add_rows(suite, "smooth", &format!("{name}, {kind}"), &tally, false);
    }
    let rays = once_wrong(name);
    if !rays.is_empty() {
        let hits = suite.smooth.send(&scene.on_gpu, &rays);
        let tally = judged(suite.gpu, &rays, &hits, &judge);
        // No row of normals: of near-doubles there are none.
        let row = Row::new("smooth", format!("{name}, once wrong"), "voxels", POSITION, &tally);
        suite.report.add(row, &tally);
    }
}

/// Rays of the long form whose answers, or the judge's, were once wrong.
fn once_wrong(name: &str) -> Vec<ProbeRay> {
    let ray = |cell: [i32; 3], frac: [f32; 3], dir: [f32; 3], t_min, t_max| {
        let (cell, frac, dir) = (cell.into(), frac.into(), dir.into());
        traverse::Ray { cell, frac, dir, t_min, t_max }.into()
    };
    match name {
        "checkerboard" => vec![
            // Positions in f32 are off by more than a cell.
            ray(
                [50331779, -53477251, -58720145],
                [0.49999994, 0.5, 0.0],
                [-1.5, 1.59375, 1.75],
                0.0,
                1e30,
            ),
            // It begins in the surface, at 0.
            ray(
                [128, 135, 135],
                [0.8790755, 0.15396065, 0.5],
                [-2.3283064e-10, 1.1641532, 5.2794456e-11],
                -43469038000.0,
                25250435000.0,
            ),
        ],
        // It runs in the surface between the root and the one that is found.
        "truss" => vec![ray(
            [105, 138, 100],
            [0.9136392, 0.5, 0.0],
            [1.0027636, -9.536744e-10, 1.3440001],
            1e-45,
            30932992000.0,
        )],
        _ => Vec::new(),
    }
}
