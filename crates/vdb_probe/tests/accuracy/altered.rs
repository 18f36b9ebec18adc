//! First voxels and smooth surfaces where the f32 of the shaders is computed otherwise, as compilers may do it:
//! `docs/reference/accuracy.md` lists what they may do.

use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::{Blocky, Occupied};
use vdb_probe::judge::given::{self, Targets, chunks};
use vdb_probe::judge::smooth::{FARTHEST_OFF, Judge, USUALLY_OFF};
use vdb_probe::judge::{Scene, Tally, judged, voxels};
use vdb_probe::{Alterations, Probe, ProbeHit, ProbeKind, ProbeRay};

use crate::case::{Suite, hash};
use crate::grids::{self, Named, Tree};
use crate::report::{Bound, Row};
use crate::smooth;
use crate::voxels::KIND;

/// Rays of each grid and each kind.
const RAYS: usize = 10_000;

const PASSED: &str = "(mirrored.frac - T_ERROR) + (t * (1.0 - T_ERROR)) * mirrored.speed";
const PLANES: &str = "return (vec3<f32>(plane) - mirrored.frac) * mirrored.inverse;";
const PLANE: &str =
    "return (cells - component_f(mirrored.frac, axis)) * component_f(mirrored.inverse, axis);";
const INVERSE: &str = "1.0 / max(speed, vec3(MIN_SPEED)),";

// WGSL permits 2.5 units in the last place.
const INVERSE_LARGE: Alterations =
    &[(INVERSE, "(1.0 / max(speed, vec3(MIN_SPEED))) * (1.0 + 3.0 / 8388608.0),")];
const INVERSE_SMALL: Alterations =
    &[(INVERSE, "(1.0 / max(speed, vec3(MIN_SPEED))) * (1.0 - 3.0 / 8388608.0),")];

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
    ("inverse 3 units too large", INVERSE_LARGE),
    ("inverse 3 units too small", INVERSE_SMALL),
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

/// What WGSL permits in the search for smooth surfaces.
const PERMITTED_SMOOTH: [(&str, Alterations); 2] = [
    ("smooth, inverse 3 units too large", INVERSE_LARGE),
    ("smooth, inverse 3 units too small", INVERSE_SMALL),
];

/// The margin is too small by a thousandth of the largest corner, so cells are rejected in which the ray dips through the
/// surface by less than that.
const TOO_CERTAIN: Alterations = &[(
    "(2.0 * T_ERROR) * largest_corner",
    "(2.0 * T_ERROR) * largest_corner - 0.001 * largest_corner",
)];

pub fn run(suite: &mut Suite) {
    if !suite.wants("altered: ") {
        return;
    }
    for (name, alterations) in PERMITTED {
        let tally = send(suite, alterations);
        add(suite, name, Bound::Max(f64::from(T_ERROR)), &tally);
    }
    for (name, alterations) in PERMITTED_SMOOTH {
        let tally = send_smooth(suite, alterations);
        add(suite, name, Bound::Quantile(USUALLY_OFF, FARTHEST_OFF), &tally);
    }
    let tally = send_smooth(suite, TOO_CERTAIN);
    assert!(tally.wrong > 0, "no ray notices that cells are rejected which have roots");
    add(suite, "smooth, cells rejected that have roots", Bound::None, &tally);
    let tally = send(suite, DISTRIBUTED);
    // On a software adapter this must be noticed, or the test could notice nothing. Compilers of GPUs may fuse the second
    // product with the difference, which removes most of the error.
    let is_noticed = tally.wrong > 0 || !suite.gpu.is_software();
    assert!(is_noticed, "distributed products are accurate enough");
    add(suite, "products distributed, against WGSL", Bound::None, &tally);
}

fn add(suite: &mut Suite, name: &str, bound: Bound, tally: &Tally) {
    // The rays are not counted, because the shaders are not those that the suite is about.
    let unit = if name.starts_with("smooth") { "voxels" } else { "of t" };
    suite.report.add(Row { again: true, ..Row::new("altered", name, unit, bound, tally) }, tally);
}

/// Random rays, hard ones and ones with ends through an altered kernel, to first voxels.
fn send(suite: &Suite, alterations: Alterations) -> Tally {
    let probe = Probe::altered(suite.gpu, ProbeKind::Voxels, alterations);
    let some = ["truss", "random voxels, 1 %", "checkerboard"];
    let solids = grids::solids().into_iter().filter(|grid| some.contains(&grid.name.as_str()));
    let solids = solids.map(|Named { name, make }| (name, make()));
    let grids = solids.chain([("offset 2^30".to_owned(), grids::ball(1 << 30))]);
    grids.fold(Tally::default(), |sum, (name, tree)| {
        let scene = Scene::new(suite.gpu, &tree, KIND).expect("there are voxels");
        let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
        let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| {
            voxels::judge(&scene, &oracle, ray, hit, tally);
        };
        let kinds: [given::Make; 3] = [given::plain, given::hard, given::ended];
        sum.merge(send_to(suite, &probe, &name, &tree, &scene, kinds, i32::MAX, &judge))
    })
}

/// How far from a grid's own origin rays to smooth surfaces may begin, in voxels: wrong answers to rays from farther
/// away take long to judge.
const FARTHEST: i32 = 1 << 16;

/// Random, hard and creeping rays through an altered kernel, to smooth surfaces.
fn send_smooth(suite: &Suite, alterations: Alterations) -> Tally {
    let probe = Probe::altered(suite.gpu, ProbeKind::Smooth, alterations);
    let some = ["sphere", "gyroid", "noise of both signs"];
    let grids = grids::level_sets().into_iter().filter(|grid| some.contains(&grid.name.as_str()));
    grids.fold(Tally::default(), |sum, Named { name, make }| {
        let tree = make();
        let scene = Scene::new(suite.gpu, &tree, smooth::KIND).expect("there is a surface");
        let judge = Judge::new(&scene);
        let judge =
            |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
        let kinds: [given::Make; 3] = [given::plain, given::hard, given::creeping];
        sum.merge(send_to(suite, &probe, &name, &tree, &scene, kinds, FARTHEST, &judge))
    })
}

/// Rays of several kinds to one grid, if they begin less than `farthest` voxels from its own origin.
fn send_to(
    suite: &Suite,
    probe: &Probe,
    name: &str,
    tree: &Tree,
    scene: &Scene,
    kinds: [given::Make; 3],
    farthest: i32,
    judge: &(dyn Fn(&ProbeRay, &ProbeHit, &mut Tally) + Sync),
) -> Tally {
    let targets = Targets::new(tree, &scene.grid);
    let kinds = kinds.into_iter().enumerate();
    kinds.fold(Tally::default(), |sum, (kind, make)| {
        let make = |random: &mut _| make(random, &targets, &scene.grid);
        let seed = suite.seed_of(hash(name) ^ kind as u64);
        let mut rays = chunks(seed, 0, RAYS, &make);
        rays.retain(|ray| ray.cell.into_iter().all(|c| c.abs() < farthest));
        let hits = probe.send(&scene.on_gpu, &rays);
        sum.merge(judged(suite.gpu, &rays, &hits, judge))
    })
}
