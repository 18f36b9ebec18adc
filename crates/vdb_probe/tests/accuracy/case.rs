//! A case: a grid, a question, a source of rays, and what judges the answers.

use std::sync::mpsc::sync_channel;

use rayon::prelude::*;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::reference::Ray;
use vdb_core::synth::Random;
use vdb_core::tree::{IVec3, Vdb543};
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeHit, ProbeRay};

use crate::report::Report;
use crate::tally::Tally;

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

/// A grid, packed and on the GPU.
pub struct Scene<'a> {
    pub tree: &'a Vdb543<f32>,
    pub grid: PackedGrid,
    pub on_gpu: GpuGrid,
}

impl<'a> Scene<'a> {
    /// `None`, where there is nothing to see.
    pub fn new(gpu: &Gpu, tree: &'a Vdb543<f32>, kind: PackKind) -> Option<Self> {
        let grid = PackedGrid::new(tree, kind).expect("the grids of the suite are small");
        grid.occupied?;
        let on_gpu = GpuGrid::new(gpu, &grid);
        Some(Self { tree, grid, on_gpu })
    }

    pub fn iso(&self) -> f32 {
        match self.grid.kind {
            PackKind::Surface { iso } | PackKind::Smooth { iso } => iso,
            PackKind::Fog => 0.0,
        }
    }

    /// The ray in index space whose numbers are those that the shader has: the half voxel between
    /// the lattice of voxels and index space is exact, as fractions have 24 bits. Denormal numbers
    /// count as zero in the traversal, on all hardware.
    pub fn exact(&self, ray: &ProbeRay) -> Ray {
        let cell = IVec3::from_array(ray.cell).wrapping_add(self.grid.base);
        let frac = glam::Vec3::from_array(ray.frac) + self.grid.kind.lattice_origin() as f32;
        let dir = glam::Vec3::from_array(ray.dir);
        Ray::new(cell, frac, dir).with_span(ray.t_min, ray.t_max).flushed()
    }

    /// More steps than this a traversal does not take: the cells of the box along its three edges.
    pub fn most_steps(&self) -> u64 {
        self.grid.occupied.map_or(0, |bounds| bounds.dim().iter().sum())
    }

    /// What holds of every answer.
    pub fn is_sound(&self, hit: &ProbeHit) -> bool {
        let finite = hit.t.is_finite()
            && hit.optical_length.is_finite()
            && hit.gradient.iter().all(|g| g.is_finite());
        finite && u64::from(hit.steps) <= self.most_steps()
    }
}

/// A ray as a line of Rust, to try it again.
pub fn reproduced(ray: &ProbeRay) -> String {
    let ProbeRay { cell, frac, dir, t_min, t_max, .. } = ray;
    format!(
        "traverse::Ray {{ cell: {cell:?}.into(), frac: {frac:?}.into(), dir: {dir:?}.into(), \
         t_min: {t_min:?}, t_max: {t_max:?} }}"
    )
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
/// Rays with a sequence of random numbers of their own.
const CHUNK: usize = 4096;
/// Rays that are judged by one thread at a time.
const JUDGED: usize = 1024;

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

/// Rays from a source, the same for the same seed.
pub fn chunks(
    seed: u64,
    first: usize,
    count: usize,
    make: &(dyn Fn(&mut Random) -> ProbeRay + Sync),
) -> Vec<ProbeRay> {
    let starts: Vec<usize> = (first..first + count).step_by(CHUNK).collect();
    let chunk = |start: usize| {
        let mut random = Random::new(seed ^ (start as u64).wrapping_mul(0xa24b_aed4_963e_e407));
        let rays = (start..(start + CHUNK).min(first + count)).map(|_| make(&mut random));
        rays.collect::<Vec<_>>()
    };
    starts.into_par_iter().flat_map_iter(chunk).collect()
}

/// Mesa's llvmpipe ends a shader after 65,535 iterations of all its loops together. From so many
/// steps of a traversal on, its answers tell nothing; a GPU's do.
const LLVMPIPE_STEPS: u32 = 2000;

/// Judges the answers to rays.
pub fn judged(
    gpu: &Gpu,
    rays: &[ProbeRay],
    hits: &[ProbeHit],
    judge: &(dyn Fn(&ProbeRay, &ProbeHit, &mut Tally) + Sync),
) -> Tally {
    let most_steps = if gpu.is_software() { LLVMPIPE_STEPS } else { u32::MAX };
    assert_eq!(rays.len(), hits.len(), "every ray has an answer");
    rays.par_chunks(JUDGED)
        .zip(hits.par_chunks(JUDGED))
        .map(|(rays, hits)| {
            let mut tally = Tally::default();
            for (ray, hit) in rays.iter().zip(hits) {
                tally.rays += 1;
                if hit.steps < most_steps {
                    judge(ray, hit, &mut tally);
                } else {
                    tally.cut += 1;
                }
            }
            tally
        })
        .reduce(Tally::default, Tally::merge)
}
