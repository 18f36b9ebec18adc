//! Every grid of the corpus of files that the loader would show, as it would show it.

use vdb_core::pack::PackKind;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::synth::Random;
use vdb_core::{AnyTree, VdbFile};
use vdb_probe::judge::fog::TRANSMITTANCE;
use vdb_probe::judge::given::{self, Targets};
use vdb_probe::judge::{Judge, Scene, Tally};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Suite, hash, send};
use crate::corpus_files::{corpus, files};
use crate::grids::Tree;
use crate::report::{Bound, Row};
use crate::{fog, smooth, voxels};

/// Rays of each grid in the short form, by what is asked.
const RAYS: [usize; 3] = [2_000, 500, 300];

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
    for path in
        ["openvdb-written", "real"].iter().flat_map(|folder| files(&corpus.join(folder), "vdb"))
    {
        let file = match VdbFile::open(&path) {
            Ok(file) => file,
            Err(error) => panic!("{error}"),
        };
        for grid in file.grids {
            let AnyTree::Float(tree) = &grid.tree else { continue };
            if grid.transform.linear().is_none() {
                continue;
            }
            // The rays' seed: not of where a checkout lies.
            let file = path.file_name().unwrap_or_default().display();
            let name = format!("{file}, {}", grid.unique_name);
            match PackKind::suited(grid.class, tree) {
                PackKind::Surface { .. } | PackKind::Smooth { .. } => {
                    send_through(suite, &mut sums[0], &name, tree, voxels::KIND);
                    send_through(suite, &mut sums[1], &name, tree, smooth::KIND);
                }
                // A dense background would fill all of space; it is shown inside of nodes alone.
                PackKind::Fog if tree.background() > 0.0 => endless += 1,
                PackKind::Fog => send_through(suite, &mut sums[2], &name, tree, fog::KIND),
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
    let row = fog::row("corpus", &case, TRANSMITTANCE, &fogs.tally);
    suite.report.add(row, &fogs.tally);
}

fn send_through(suite: &Suite, sum: &mut Sum, name: &str, tree: &Tree, kind: PackKind) {
    let Some(scene) = Scene::new(suite.gpu, tree, kind) else { return };
    let targets = Targets::new(tree, &scene.grid);
    if targets.is_empty() {
        return;
    }
    let make = |random: &mut Random| match random.below(3) {
        0 => given::plain(random, &targets, &scene.grid),
        1 => given::hard(random, &targets, &scene.grid),
        _ => given::ended(random, &targets, &scene.grid),
    };
    let (seed, times) = (hash(name), suite.some_times());
    let rays = match kind {
        PackKind::Surface { .. } => RAYS[0],
        PackKind::Smooth { .. } => RAYS[1],
        PackKind::Fog => RAYS[2],
    };
    let judge = Judge::new(&scene, targets.reach());
    let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
    let mut tally = send(suite, &scene, seed, rays * times, &make, &judge);
    tally.examples.iter_mut().for_each(|example| *example = format!("{name}: {example}"));
    sum.tally = std::mem::take(&mut sum.tally).merge(tally);
    sum.grids += 1;
}
