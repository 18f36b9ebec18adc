//! A case: a grid, a question, a source of rays, and what judges the answers.

use std::sync::mpsc::sync_channel;

use vdb_core::pack::PackKind;
use vdb_core::synth::Random;
use vdb_probe::judge::given::chunks;
use vdb_probe::judge::{Scene, Tally, judged};
use vdb_probe::{Gpu, Probe, ProbeHit, ProbeRay};

use crate::report::Report;

/// What all cases share.
pub struct Suite<'a> {
    pub gpu: &'a Gpu,
    /// Factor on the numbers of rays.
    pub times: usize,
    pub seed: u64,
    /// Cases whose names contain one of these are run; all, if there are none.
    pub filters: Vec<String>,
    pub report: Report,
    pub voxels: Probe<'a>,
    pub smooth: Probe<'a>,
    pub fog: Probe<'a>,
}

impl<'a> Suite<'a> {
    /// The factor for what is slow to judge, smooth surfaces and fog: a hundred times will do.
    pub fn some_times(&self) -> usize {
        self.times.min(100)
    }

    pub fn wants(&self, name: &str) -> bool {
        self.filters.is_empty() || self.filters.iter().any(|part| name.contains(part.as_str()))
    }

    /// The seed of a case, from that of the suite.
    pub fn seed_of(&self, case: u64) -> u64 {
        self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ case
    }

    pub fn probe(&self, kind: PackKind) -> &Probe<'a> {
        match kind {
            PackKind::Surface { .. } => &self.voxels,
            PackKind::Smooth { .. } => &self.smooth,
            PackKind::Fog => &self.fog,
        }
    }
}

/// The number of a name, to begin a sequence of random numbers with.
pub fn hash(name: &str) -> u64 {
    // FNV-1a.
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// Rays that are sent at once, at most.
const BATCH: usize = 1 << 20;

/// Sends `count` rays through a grid and judges every one. The GPU and the judges work at the same
/// time, in batches, so that memory does not grow with the number of rays.
pub fn send(
    suite: &Suite,
    scene: &Scene,
    seed: u64,
    count: usize,
    make: &(dyn Fn(&mut Random) -> ProbeRay + Sync),
    judge: &(dyn Fn(&ProbeRay, &ProbeHit, &mut Tally) + Sync),
) -> Tally {
    let seed = suite.seed_of(seed);
    let probe = suite.probe(scene.grid.kind);
    std::thread::scope(|scope| {
        let (sender, receiver) = sync_channel(1);
        scope.spawn(move || {
            for first in (0..count).step_by(BATCH) {
                let rays = chunks(seed, first, (count - first).min(BATCH), make);
                let hits = probe.send(&scene.on_gpu, &rays);
                if sender.send((rays, hits)).is_err() {
                    return;
                }
            }
        });
        receiver.into_iter().fold(Tally::default(), |tally, (rays, hits)| {
            tally.merge(judged(suite.gpu, &rays, &hits, judge))
        })
    })
}
