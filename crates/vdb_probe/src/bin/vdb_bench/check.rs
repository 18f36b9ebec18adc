//! Rays through a model, checked against the reference tracer: on the GPUs of users, a compiler may
//! be wrong that no test of this project has met.

use vdb_core::pack::PackKind;
use vdb_core::synth::Random;
use vdb_probe::judge::given::{self, Make, Targets, chunks};
use vdb_probe::judge::{Judge, Scene, Tally, judged};
use vdb_probe::{Gpu, Probe, ProbeHit, ProbeKind, ProbeRay};

use crate::camera::Camera;
use crate::model::{Kind, Model};

/// Where the random numbers begin: every report checks the same rays.
const SEED: u64 = 1;

/// What the rays through a model have come to.
pub struct Check {
    pub model: String,
    pub kind: Kind,
    pub tally: Tally,
}

impl Check {
    /// Checks the rays of an image from each camera, and as many others: at random, made to be hard,
    /// and with ends.
    pub fn new(
        gpu: &Gpu,
        model: &Model,
        kind: Kind,
        scene: &Scene,
        cameras: &[Camera],
    ) -> Result<Self, String> {
        let mut check = Self { model: model.name.clone(), kind, tally: Tally::default() };
        if scene.grid.occupied.is_none() {
            return Ok(check);
        }
        let probe = Probe::new(gpu, probe_kind(kind));
        let targets = Targets::new(scene.tree, &scene.grid);
        let judge = Judge::new(scene, targets.reach());
        let judge =
            |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
        let mut add = |rays: &[ProbeRay], hits: &[ProbeHit]| {
            let sum = std::mem::take(&mut check.tally);
            check.tally = sum.merge(judged(gpu, rays, hits, &judge));
        };
        let size = image_size(scene.grid.kind);
        for camera in cameras {
            let view = camera.rays(model, &scene.grid, size);
            let view = view.map_err(|error| format!("{}: {error}", model.name))?;
            let (rays, hits) = probe.picture(&scene.on_gpu, &view, size);
            add(&rays, &hits);
        }
        let makes = [given::plain as Make, given::hard, given::ended];
        let count = (size[0] * size[1]) as usize / makes.len();
        for (seed, make) in (SEED..).zip(makes) {
            let make = |random: &mut Random| make(random, &targets, &scene.grid);
            let rays = chunks(seed, 0, count, &make);
            add(&rays, &probe.send(&scene.on_gpu, &rays));
        }
        Ok(check)
    }
}

fn probe_kind(kind: Kind) -> ProbeKind {
    match kind {
        Kind::Voxels => ProbeKind::Voxels,
        Kind::Smooth => ProbeKind::Smooth,
        Kind::Fog => ProbeKind::Fog,
    }
}

/// The size of the image to check: a few seconds of work for the reference tracer on two cores.
fn image_size(kind: PackKind) -> [u32; 2] {
    match kind {
        PackKind::Surface { .. } => [512, 288],
        PackKind::Smooth { .. } => [256, 144],
        PackKind::Fog => [128, 72],
    }
}
