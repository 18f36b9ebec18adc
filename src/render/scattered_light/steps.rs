//! The steps of a solution: which shader runs on which lattice, from coarse to fine.

use bevy::math::UVec3;
use bytemuck::{Pod, Zeroable};
use vdb_core::scattering::{MAX_CELLS, relaxation_factors};

use super::lattice::CellLattice;

/// The struct of `scattered_light/solve.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Step {
    pub size: [u32; 3],
    pub first: u32,
    pub coarse_size: [u32; 3],
    pub coarse_first: u32,
    pub channels: u32,
    pub edge: f32,
    pub relaxation: f32,
    pub first_layer: u32,
    pub axes: [[f32; 4]; 3],
}

/// The entry points of `scattered_light/solve.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Program {
    Gather,
    Coarsen,
    Sweep,
    Relax,
    Refine,
    Store,
}

impl Program {
    pub const ALL: [(Self, &str); 6] = [
        (Self::Gather, "gather"),
        (Self::Coarsen, "coarsen"),
        (Self::Sweep, "sweep"),
        (Self::Relax, "relax"),
        (Self::Refine, "refine"),
        (Self::Store, "store"),
    ];
}

/// The directions of the radiance.
pub(super) const DIRECTIONS: u32 = 14;
/// The edge of the workgroups of cells, and the invocations of the others.
const GROUP_EDGE: u32 = 4;
const GROUP_SIZE: u32 = 64;

/// The iterations on each lattice, from the coarsest, and the least eigenvalue that they are made for: of the part
/// that escapes or is absorbed.
const ITERATIONS: [(usize, f64); 3] = [(12, 0.02), (8, 0.05), (8, 0.1)];
/// The same while light or fog changes a little from frame to frame: each frame goes on with the next `UPDATES`
/// iterations of this cycle.
const UPDATE_CYCLE: (usize, f64) = (8, 0.3);
const UPDATES: usize = 2;

/// Cells in front of the lattices of all solutions, for the coarser lattices of one.
pub(super) fn coarse_cells(channels: u32) -> u32 {
    let edges = [MAX_CELLS / 2, MAX_CELLS / 4];
    channels * edges.map(|edge| edge * edge * edge).iter().sum::<u32>()
}

/// Where a solution is stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Its first cell in the buffers.
    pub first: u32,
    /// Its first layer of texels.
    pub first_layer: u32,
    pub channels: u32,
}

/// The largest eigenvalue of what escapes, is absorbed, or is turned back, for the least anisotropy of all fogs: in
/// fog that scatters backwards, the flux changes its sign with each event.
fn largest_eigenvalue(least_anisotropy: f32) -> f64 {
    1.0 + f64::from(-least_anisotropy.min(0.0))
}

/// How a solution is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    /// From nothing.
    Anew,
    /// From the last one, by some iterations; this is the number of those before.
    Onwards(usize),
}

impl Way {
    /// The number of iterations of [`Way::Onwards`] after this.
    pub fn done(self) -> usize {
        match self {
            Self::Anew => 0,
            Self::Onwards(done) => (done + UPDATES) % UPDATE_CYCLE.0,
        }
    }
}

/// A shader to run, its workgroups, and its uniform.
pub(super) type Dispatch = (Program, UVec3, Step);

/// The shaders of a solution, in their order, after the octants are sampled. `least_anisotropy` is that of all fogs.
pub(super) fn steps(
    lattice: &CellLattice,
    place: Place,
    way: Way,
    least_anisotropy: f32,
) -> Vec<Dispatch> {
    let most = largest_eigenvalue(least_anisotropy);
    let levels = levels(lattice, place);
    let cells = |size: [u32; 3]| UVec3::from(size).map(|cells| cells.div_ceil(GROUP_EDGE));
    let mut all = vec![(Program::Gather, cells(levels[0].size), levels[0])];
    match way {
        Way::Anew => {
            for level in levels.iter().filter(|level| level.coarse_size[0] > 0) {
                all.push((Program::Coarsen, cells(level.coarse_size), *level));
            }
            for (level, (count, least)) in levels.iter().rev().zip(ITERATIONS) {
                all.push((Program::Refine, cells(level.size), *level));
                iterate(&mut all, *level, &relaxation_factors(count, [least, most]));
            }
        }
        Way::Onwards(done) => {
            let (count, least) = UPDATE_CYCLE;
            let cycle = relaxation_factors(count, [least, most]);
            let next: Vec<f32> = cycle.iter().cycle().skip(done).take(UPDATES).copied().collect();
            iterate(&mut all, levels[0], &next);
        }
    }
    let [x, y, z] = levels[0].size.map(|cells| cells + 2);
    let texels = [x, y, z * place.channels];
    all.push((Program::Store, cells(texels), levels[0]));
    all
}

fn iterate(all: &mut Vec<Dispatch>, level: Step, relaxations: &[f32]) {
    let [x, y, z] = level.size;
    let lines = x * y + y * z + z * x;
    let sweeps = UVec3::new(lines.div_ceil(GROUP_SIZE), DIRECTIONS, level.channels);
    let sums = UVec3::new((x * y * z).div_ceil(GROUP_SIZE), level.channels, 1);
    for relaxation in relaxations {
        let step = Step { relaxation: *relaxation, ..level };
        all.push((Program::Sweep, sweeps, step));
        all.push((Program::Relax, sums, step));
    }
}

/// The lattices of a solution, from the finest: each has half of the cells of the last along each axis, until there
/// are at most 8.
fn levels(lattice: &CellLattice, place: Place) -> Vec<Step> {
    let axis = |axis: bevy::math::DVec3| axis.as_vec3().extend(0.0).to_array();
    let finest = Step {
        size: lattice.size.to_array(),
        first: place.first,
        channels: place.channels,
        edge: 1.0,
        first_layer: place.first_layer,
        axes: [lattice.axes.x_axis, lattice.axes.y_axis, lattice.axes.z_axis].map(axis),
        ..Default::default()
    };
    let mut all = vec![finest];
    let mut first = 0;
    while let Some(last) = all.last_mut()
        && last.size.iter().max() > Some(&8)
    {
        last.coarse_size = last.size.map(|cells| cells.div_ceil(2));
        last.coarse_first = first;
        let coarser = Step {
            size: last.coarse_size,
            first,
            edge: 2.0 * last.edge,
            coarse_size: [0; 3],
            coarse_first: 0,
            ..*last
        };
        first += coarser.size.iter().product::<u32>() * coarser.channels;
        all.push(coarser);
    }
    all
}

#[cfg(test)]
mod tests {
    use bevy::math::{DMat3, DVec3};

    use super::*;

    fn lattice(size: UVec3) -> CellLattice {
        CellLattice { axes: DMat3::IDENTITY, corner: DVec3::ZERO, edge: 1.0, size }
    }

    const PLACE: Place = Place { first: 100_000, first_layer: 7, channels: 3 };

    #[test]
    fn fog_that_scatters_backwards_takes_smaller_steps() {
        let least = |anisotropy| {
            let all = steps(&lattice(UVec3::splat(32)), PLACE, Way::Anew, anisotropy);
            all.iter().map(|step| step.2.relaxation).filter(|own| *own > 0.0).fold(2.0, f32::min)
        };
        // The inverse of the largest eigenvalue, nearly.
        assert!((least(0.8) - 1.0).abs() < 0.01);
        assert!((least(-0.5) - 1.0 / 1.5).abs() < 0.01);
    }

    #[test]
    fn lattices_do_not_share_cells() {
        for size in [UVec3::splat(32), UVec3::new(32, 9, 17), UVec3::new(1, 32, 1), UVec3::splat(7)]
        {
            let all = levels(&lattice(size), PLACE);
            assert_eq!(all.len(), if size.max_element() > 16 { 3 } else { 1 });
            let mut end = 0;
            for level in &all[1..] {
                assert_eq!(level.first, end);
                end += level.size.iter().product::<u32>() * level.channels;
            }
            assert!(end <= coarse_cells(PLACE.channels));
            assert!(all.iter().all(|level| level.first_layer == 7 && level.channels == 3));
            assert_eq!(all[0].first, PLACE.first);
        }
    }

    #[test]
    fn a_solution_goes_from_coarse_to_fine_or_onwards() {
        let anew = steps(&lattice(UVec3::splat(32)), PLACE, Way::Anew, 0.0);
        let count = |of: &[Dispatch], program| of.iter().filter(|step| step.0 == program).count();
        assert_eq!(count(&anew, Program::Sweep), 28);
        assert_eq!(count(&anew, Program::Coarsen), 2);
        assert_eq!(count(&anew, Program::Refine), 3);
        let onwards = steps(&lattice(UVec3::splat(32)), PLACE, Way::Onwards(6), 0.0);
        assert_eq!(count(&onwards, Program::Sweep), UPDATES);
        assert_eq!(onwards.len(), 2 + 2 * UPDATES);
        assert_eq!(Way::Onwards(6).done(), 0);
    }
}
