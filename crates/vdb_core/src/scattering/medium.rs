//! The fog and the light's first scattering on a lattice, at each level of detail.

use glam::{UVec3, Vec2};
use rayon::prelude::*;

use super::lattice::{cells, count, index};
use super::octants::FogOctants;

/// The largest optical depth of a cell.
const OPAQUE: f32 = 1e30;

/// What is known of the cells of a lattice before any light is scattered.
pub(super) struct Medium {
    pub size: UVec3,
    /// `v σ h`: the scaled optical depth along an edge, from the mean extinction of the cell.
    pub thickness: Vec<f32>,
    /// `e1`: the fraction of the light that arrives, `exp(-v τ)`, as the fog in and around the cell sees it.
    pub arriving: Vec<f32>,
}

impl Medium {
    /// For samples of which `coefficient` is the extinction at a density of 1, scaled by `v`.
    ///
    /// `arriving` is weighted by density over a hat two cells wide, as interpolation spreads the light of a
    /// cell over such a hat: means over octants, then (1 3 3 1) / 8 along each axis.
    pub fn new(octants: &FogOctants, coefficient: f32, v: f32) -> Self {
        let (size, samples) = (octants.lattice.size, &octants.samples);
        let scale = coefficient * v;
        let arriving: Vec<f32> =
            samples.par_iter().map(|sample| (-scale * sample.depth).exp()).collect();
        let weighted = samples.par_iter().zip(&arriving);
        let mut hats: Vec<Vec2> =
            weighted.map(|(sample, e)| sample.extinction * Vec2::new(*e, 1.0)).collect();
        let mut hat_size = 2 * size;
        for axis in 0..3 {
            hats = narrowed(&hats, &mut hat_size, axis);
        }
        let mean = |cell: UVec3, value: &dyn Fn(usize) -> f32| {
            let octants = cells(UVec3::splat(2)).map(|octant| index(2 * cell + octant, 2 * size));
            octants.map(value).sum::<f32>() / 8.0
        };
        let thickness = cells(size)
            .map(|cell| (scale * mean(cell, &|at| samples[at].extinction)).min(OPAQUE))
            .collect();
        let hat_arriving = |(cell, hat): (UVec3, &Vec2)| match hat.y > 0.0 {
            true => hat.x / hat.y,
            false => mean(cell, &|at| arriving[at]),
        };
        Self { size, thickness, arriving: cells(size).zip(&hats).map(hat_arriving).collect() }
    }

    /// The medium with cells twice as wide; the last ones may reach beyond the lattice, where there is no
    /// fog. `None` for a single cell.
    pub fn coarser(&self) -> Option<Self> {
        if self.size == UVec3::ONE {
            return None;
        }
        let size = self.size.map(|cells| cells.div_ceil(2));
        let (mut thickness, mut arriving) = (vec![0.0; count(size)], vec![0.0; count(size)]);
        for (at, cell) in cells(size).enumerate() {
            let parts = cells(UVec3::splat(2)).map(|part| 2 * cell + part);
            let parts = parts.filter(|part| part.cmplt(self.size).all());
            let (mut sum, mut number) = (Vec2::ZERO, 0.0);
            for part in parts.map(|part| index(part, self.size)) {
                sum += self.thickness[part] / 8.0 * Vec2::new(self.arriving[part], 1.0);
                arriving[at] += self.arriving[part];
                number += 1.0;
            }
            // Along an edge twice as long.
            thickness[at] = (2.0 * sum.y).min(OPAQUE);
            arriving[at] = if sum.y > 0.0 { sum.x / sum.y } else { arriving[at] / number };
        }
        Some(Self { size, thickness, arriving })
    }
}

/// The means over octants along one axis, by the kernel (1 3 3 1) / 8 around each cell; there is nothing
/// outside.
fn narrowed(octants: &[Vec2], size: &mut UVec3, axis: usize) -> Vec<Vec2> {
    let from = *size;
    size[axis] /= 2;
    let stride = index(UVec3::AXES[axis], from);
    let hat = |mut cell: UVec3| {
        cell[axis] *= 2;
        let (first, is_last) = (index(cell, from), cell[axis] + 2 == from[axis]);
        let before = if cell[axis] == 0 { Vec2::ZERO } else { octants[first - stride] };
        let after = if is_last { Vec2::ZERO } else { octants[first + 2 * stride] };
        (before + 3.0 * (octants[first] + octants[first + stride]) + after) / 8.0
    };
    cells(*size).map(hat).collect()
}
