//! First voxels where the f32 of the traversal is computed otherwise, as compilers may do it:
//! `docs/reference/accuracy.md` lists what they may do.

use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::{Blocky, Occupied};
use vdb_probe::judge::given::{self, Targets, chunks};
use vdb_probe::judge::{Scene, Tally, judged, voxels};
use vdb_probe::{Alterations, Probe, ProbeHit, ProbeKind, ProbeRay};

use crate::case::{Suite, hash};
use crate::grids::{self, Named};
use crate::report::{Bound, Row};
use crate::voxels::KIND;

/// Rays of each grid and each kind.
const RAYS: usize = 10_000;

const PASSED: &str = "(mirrored.frac - T_ERROR) + (t * (1.0 - T_ERROR)) * mirrored.speed";
const PLANES: &str = "return (vec3<f32>(plane) - mirrored.frac) * mirrored.inverse;";
const PLANE: &str =
    "return (cells - component_f(mirrored.frac, axis)) * component_f(mirrored.inverse, axis);";
const INVERSE: &str = "1.0 / max(speed, vec3(MIN_SPEED)),";

/// What WGSL permits.
const PERMITTED: [(&str, Alterations); 5] = [
    (
        "product and sum fused",
        &[(PASSED, "fma(vec3(t * (1.0 - T_ERROR)), mirrored.speed, mirrored.frac - T_ERROR)")],
    ),
    (
        "sum in another order",
        &[(PASSED, "mirrored.frac + ((t * (1.0 - T_ERROR)) * mirrored.speed - T_ERROR)")],
    ),
    // WGSL permits 2.5 units in the last place.
    (
        "inverse 3 units too large",
        &[(INVERSE, "(1.0 / max(speed, vec3(MIN_SPEED))) * (1.0 + 3.0 / 8388608.0),")],
    ),
    (
        "inverse 3 units too small",
        &[(INVERSE, "(1.0 / max(speed, vec3(MIN_SPEED))) * (1.0 - 3.0 / 8388608.0),")],
    ),
    (
        "quotients instead of inverses",
        &[(
            PLANES,
            "return (vec3<f32>(plane) - mirrored.frac) / max(mirrored.speed, vec3(MIN_SPEED));",
        )],
    ),
];

/// What it does not permit, because the result is less accurate: the difference is small where the two products are
/// not.
const DISTRIBUTED: Alterations = &[
    (PLANES, "return vec3<f32>(plane) * mirrored.inverse - mirrored.frac * mirrored.inverse;"),
    (
        PLANE,
        "let inverse = component_f(mirrored.inverse, axis);
         return cells * inverse - component_f(mirrored.frac, axis) * inverse;",
    ),
];

pub fn run(suite: &mut Suite) {
    if !suite.wants("altered: ") {
        return;
    }
    for (name, alterations) in PERMITTED {
        let tally = send(suite, alterations);
        add(suite, name, Bound::Max(f64::from(T_ERROR)), &tally);
    }
    let tally = send(suite, DISTRIBUTED);
    // If this is not noticed, neither would anything else be.
    assert!(tally.wrong > 0, "distributed products are accurate enough");
    add(suite, "products distributed, against WGSL", Bound::None, &tally);
}

fn add(suite: &mut Suite, name: &str, bound: Bound, tally: &Tally) {
    // The rays are not counted, because the shaders are not those that the suite is about.
    suite.report.add(Row { again: true, ..Row::new("altered", name, "of t", bound, tally) }, tally);
}

/// Random rays, hard ones and ones with ends through an altered kernel.
fn send(suite: &Suite, alterations: Alterations) -> Tally {
    let probe = Probe::altered(suite.gpu, ProbeKind::Voxels, alterations);
    let some = ["truss", "random voxels, 1 %", "checkerboard"];
    let solids = grids::solids().into_iter().filter(|grid| some.contains(&grid.name.as_str()));
    let solids = solids.map(|Named { name, make }| (name, make()));
    let grids = solids.chain([("offset 2^30".to_owned(), grids::ball(1 << 30))]);
    let mut sum = Tally::default();
    for (name, tree) in grids {
        let scene = Scene::new(suite.gpu, &tree, KIND).expect("there are voxels");
        let targets = Targets::new(&tree, &scene.grid);
        let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
        let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| {
            voxels::judge(&scene, &oracle, ray, hit, tally);
        };
        for (kind, make) in
            [given::plain as given::Make, given::hard, given::ended].into_iter().enumerate()
        {
            let make = |random: &mut _| make(random, &targets, &scene.grid);
            let seed = suite.seed_of(hash(&name) ^ kind as u64);
            let rays = chunks(seed, 0, RAYS, &make);
            let hits = probe.send(&scene.on_gpu, &rays);
            sum = sum.merge(judged(suite.gpu, &rays, &hits, &judge));
        }
    }
    sum
}
