//! A grid in both forms, the one that is judged and the one that judges.

use rayon::prelude::*;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::reference::Ray;
use vdb_core::tree::{IVec3, Vdb543};

use super::tally::Tally;
use crate::gpu::Gpu;
use crate::probe::{GpuGrid, ProbeHit, ProbeRay};

/// A grid, packed and on the GPU.
pub struct Scene<'a> {
    /// What the reference tracer reads.
    pub tree: &'a Vdb543<f32>,
    /// The packed grid, with its samples unchanged.
    pub grid: PackedGrid,
    /// What the shaders read.
    pub on_gpu: GpuGrid,
}

impl<'a> Scene<'a> {
    /// Packs and uploads a small grid. `None`, where there is nothing to see.
    ///
    /// # Panics
    /// If the grid is too large to be packed.
    pub fn new(gpu: &Gpu, tree: &'a Vdb543<f32>, kind: PackKind) -> Option<Self> {
        let grid = PackedGrid::new(tree, kind).expect("the grids of the suite are small");
        grid.occupied?;
        let on_gpu = GpuGrid::new(gpu, &grid);
        Some(Self { tree, grid, on_gpu })
    }

    /// The iso-value of a surface; 0 for fog.
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

    /// The largest number of steps that a traversal takes: the cells of the box along its three edges.
    pub fn most_steps(&self) -> u64 {
        self.grid.occupied.map_or(0, |bounds| bounds.dim().iter().sum())
    }

    /// Whether an answer meets the conditions that hold for every answer.
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

/// Rays that are judged by one thread at a time.
const JUDGED: usize = 1024;

/// Mesa's llvmpipe ends a shader after 65,535 iterations of all its loops together, so its answers to
/// rays with this many steps or more say nothing about the shader. Those of a GPU do.
const LLVMPIPE_STEPS: u32 = 2000;

/// Judges the answers to rays.
///
/// # Panics
/// If there are fewer answers than rays, or more.
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
