//! What part of the light passes a fog.

use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, standard};
use vdb_core::synth::Random;
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Scene, Suite, hash, reproduced, send};
use crate::given::{self, Targets};
use crate::grids::{self, Named, Tree, Upper};
use crate::report::{Bound, Row};
use crate::tally::Tally;

pub const KIND: PackKind = PackKind::Fog;

/// Of transmittance, absolute.
pub const TRANSMITTANCE: f64 = 1e-3;
/// The same of a homogeneous medium.
const HOMOGENEOUS: f64 = 1e-4;

/// Rays of each grid of the matrix in the short form, of either kind.
const RAYS: usize = 3_000;
/// The same with ends, and from far away nearly along an axis.
const ENDED: usize = 1_500;
const CREEPING: usize = 1_500;

/// Optical depths of a grid from end to end, at its greatest density. Each ray is judged at all.
pub const DEPTHS: [f64; 7] = [1e-9, 1e-3, 1.0, 10.0, 1e3, 1e6, 1e9];
/// Of the optical depth of the grid from end to end: a ray's is right to this. From a depth of
/// 1e3 on, light that passes thin edges alone can be off by more than a thousandth for that.
const DEPTH: f64 = 1.0 / (1 << 21) as f64;
const DENSE: f64 = 2e3;

/// What judges the answers about a grid.
pub struct Judge<'a> {
    scene: &'a Scene<'a>,
    fog: Fog<'a, Upper>,
    /// Extinctions per unit of density and voxel.
    scales: Vec<f64>,
    bound: f64,
}

impl<'a> Judge<'a> {
    /// `reach`: voxels from end to end.
    pub fn new(scene: &'a Scene<'a>, reach: f64, bound: f64) -> Self {
        let most = f64::from(scene.grid.majorant) * reach;
        let scales = DEPTHS.into_iter().map(|depth| depth / most).collect();
        Self { scene, fog: Fog::new(scene.tree), scales, bound }
    }

    /// Holds an answer against the reference tracer.
    pub fn judge(&self, ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally) {
        let exact = self.scene.exact(ray);
        let depth = standard::optical_depth(&self.fog, &exact);
        let mut worst = 0.0_f64;
        let mut thin = false;
        for (scale, whole) in self.scales.iter().zip(DEPTHS) {
            // As the shader does it, in f32.
            let own = (*scale as f32 * hit.optical_length).min(100.0);
            let own = f64::from((-own).exp());
            let scale = f64::from(*scale as f32);
            let error = (own - (-scale * depth.value).exp()).abs();
            let off = (f64::from(hit.optical_length) - depth.value).abs() * scale;
            if error > self.bound && whole > DENSE && off <= DEPTH * whole {
                thin = true;
            } else {
                worst = worst.max(error);
            }
        }
        tally.steep += u64::from(thin);
        tally.met += u64::from(depth.value > 0.0);
        tally.errors.add(worst);
        if worst > self.bound || !self.scene.is_sound(hit) {
            tally.wrong += 1;
            tally.show(|| format!("{}: {worst}, {hit:?}, not {depth:?}", reproduced(ray)));
        }
    }
}

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
