//! The fog and its light, sampled in the octants of the cells.

use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::lattice::{Lattice, count};

/// A value so large that nothing behind it is seen, and so small that sums over eight are finite.
const LARGEST: f32 = 1e30;

/// The fog at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FogSample {
    /// Extinction per unit of length, 0 or more; or a density, which [`Optics`](super::Optics) scales.
    pub extinction: f32,
    /// The optical depth towards the light, 0 or more; or an integral of the density.
    pub depth: f32,
}

/// A fog and one light at infinity, sampled once for all channels: in the middle of the eight octants of
/// each cell of a lattice.
#[derive(Clone, Debug, PartialEq)]
pub struct FogOctants {
    pub(super) lattice: Lattice,
    /// Of a lattice with twice the cells along each axis; `extinction` is per edge of a whole cell.
    pub(super) samples: Vec<FogSample>,
}

impl FogOctants {
    /// Calls `sample` for the middle of each octant, in the frame of the lattice, in parallel.
    pub fn new(lattice: Lattice, sample: impl Fn(DVec3) -> FogSample + Sync) -> Self {
        let size = 2 * lattice.size;
        let mut samples = vec![FogSample::default(); count(size)];
        let rows = samples.par_chunks_mut(size.x as usize).enumerate();
        rows.for_each(|(row, samples)| {
            let (y, z) = (row as u32 % size.y, row as u32 / size.y);
            for (x, at) in (0..).zip(samples) {
                let octant = UVec3::new(x, y, z).as_dvec3() + 0.5;
                let FogSample { extinction, depth } =
                    sample(lattice.low + 0.5 * lattice.edge * octant);
                let thickness = (f64::from(extinction) * lattice.edge) as f32;
                *at = FogSample {
                    extinction: thickness.clamp(0.0, LARGEST),
                    depth: depth.clamp(0.0, LARGEST),
                };
            }
        });
        Self { lattice, samples }
    }
}
