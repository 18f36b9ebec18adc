//! Every grid of the corpus of files that the loader would show, as it would show it.

use std::path::{Path, PathBuf};

use vdb_core::pack::PackKind;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::{Blocky, Occupied};
use vdb_core::synth::Random;
use vdb_core::{AnyTree, GridClass, VdbFile};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Scene, Suite, hash, send};
use crate::given::{self, Targets};
use crate::grids::Tree;
use crate::report::{Bound, Row};
use crate::tally::Tally;
use crate::{fog, smooth, voxels};

/// Rays of each grid in the short form, by what is asked.
const RAYS: [usize; 3] = [2_000, 500, 300];

/// The corpus, or `None` with a line that says so: it is large and not part of the repository.
fn corpus() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = std::env::var_os("VDB_SHARED").map_or(beside, PathBuf::from);
    let corpus = shared.join("corpus");
    if !corpus.is_dir() {
        eprintln!(
            "SKIPPED: no corpus of .vdb files at {} (set VDB_SHARED to the folder that has it)",
            corpus.display()
        );
        return None;
    }
    Some(corpus)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("the corpus can be read");
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.expect("the corpus can be read").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "vdb"))
        .collect();
    files.sort();
    files
}

/// As `src/loader.rs` decides it.
fn is_level_set(class: GridClass, tree: &Tree) -> bool {
    match class {
        GridClass::LevelSet => true,
        GridClass::FogVolume => false,
        GridClass::Unknown | GridClass::Staggered => {
            tree.background() > 0.0 && tree.values().any(|value| value.value < 0.0)
        }
    }
}

/// What one question has come to.
#[derive(Default)]
struct Sum {
    tally: Tally,
    grids: usize,
}

pub fn run(suite: &mut Suite) {
    if !suite.wants("corpus: ") {
        return;
    }
    let Some(corpus) = corpus() else { return };
    let mut sums: [Sum; 3] = Default::default();
    let mut endless = 0;
    for path in ["openvdb-written", "real"].iter().flat_map(|folder| files(&corpus.join(folder))) {
        let file = match VdbFile::open(&path) {
            Ok(file) => file,
            Err(error) => panic!("{error}"),
        };
        for grid in file.grids {
            let AnyTree::Float(tree) = &grid.tree else { continue };
            if grid.transform.linear().is_none() {
                continue;
            }
            let name = format!("{}, {}", path.display(), grid.unique_name);
            if is_level_set(grid.class, tree) {
                send_through(suite, &mut sums[0], &name, tree, voxels::KIND);
                send_through(suite, &mut sums[1], &name, tree, smooth::KIND);
            } else {
                // A dense background would fill all of space; it is shown inside of nodes alone.
                match tree.background() > 0.0 {
                    true => endless += 1,
                    false => send_through(suite, &mut sums[2], &name, tree, fog::KIND),
                }
            }
        }
    }
    let [level_sets, surfaces, fogs] = sums;
    let case = format!("{} level sets as voxels", level_sets.grids);
    let bound = Bound::Max(f64::from(T_ERROR));
    suite.report.add(Row::new("corpus", case, "of t", bound, &level_sets.tally), &level_sets.tally);
    let case = format!("{} level sets, smooth", surfaces.grids);
    smooth::add_rows(suite, "corpus", &case, &surfaces.tally, false);
    let case = format!("{} fogs ({endless} without an end left out)", fogs.grids);
    let row = fog::row("corpus", &case, fog::TRANSMITTANCE, &fogs.tally);
    suite.report.add(row, &fogs.tally);
}

fn send_through(suite: &Suite, sum: &mut Sum, name: &str, tree: &Tree, kind: PackKind) {
    let Some(scene) = Scene::new(suite.gpu, tree, kind) else { return };
    let capped = if kind == PackKind::Fog { fog::capped(tree) } else { None };
    let scene = Scene { tree: capped.as_ref().unwrap_or(tree), ..scene };
    let targets = Targets::new(tree, &scene.grid);
    if targets.is_empty() {
        return;
    }
    let make = |random: &mut Random| match random.below(2) {
        0 => given::plain(random, &targets, &scene.grid),
        _ => given::hard(random, &targets, &scene.grid),
    };
    let (seed, times) = (hash(name), suite.some_times());
    let mut tally = match kind {
        PackKind::Surface { .. } => {
            let oracle = Blocky::new(tree, Occupied::BelowIso(0.0));
            let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| {
                voxels::judge(&scene, &oracle, ray, hit, tally);
            };
            send(suite, &scene, seed, RAYS[0] * times, &make, &judge)
        }
        PackKind::Smooth { .. } => {
            let judge = smooth::Judge::new(&scene);
            let judge =
                |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
            send(suite, &scene, seed, RAYS[1] * times, &make, &judge)
        }
        PackKind::Fog => {
            let judge = fog::Judge::new(&scene, targets.reach(), fog::TRANSMITTANCE);
            let judge =
                |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
            send(suite, &scene, seed, RAYS[2] * times, &make, &judge)
        }
    };
    tally.examples.iter_mut().for_each(|example| *example = format!("{name}: {example}"));
    sum.tally = std::mem::take(&mut sum.tally).merge(tally);
    sum.grids += 1;
}
