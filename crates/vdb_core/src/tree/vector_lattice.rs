//! Means of vectors over cubes of voxels.

use glam::{DVec3, IVec3, U64Vec3, UVec3};
use half::f16;

use super::{ValueAt, Vdb543};

/// The most points of a lattice: half a megabyte.
const MAX_POINTS: u64 = 1 << 16;

/// log₂ of the edge of the smallest cubes, in voxels: those of leaves.
const SMALLEST: u32 = 3;

/// A coarse form of a vector grid, for smooth look-ups at a low cost: the means of the active
/// values in cubes of voxels, at the points of a dense lattice that covers all of them.
#[derive(Clone, Debug, PartialEq)]
pub struct VectorLattice {
    /// The lowest voxel of the first cube. Cubes are aligned to multiples of their edge.
    pub origin: IVec3,
    /// log₂ of the edge of a cube in voxels: 3 or more.
    pub log2_edge: u32,
    /// The number of cubes along each axis: 1 or more, at most 65,536 in all.
    pub size: UVec3,
    /// What the means are multiples of: the largest magnitude of a component.
    pub largest: f32,
    /// The means, x fastest, as 16-bit floats: x and y in the first word, from the lower bits, z in
    /// the second one, whose upper half is 1, or 0 for a cube without active values.
    pub means: Vec<[u32; 2]>,
}

impl VectorLattice {
    /// The lattice of a tree; `None` if nothing in it is active. Components that are not finite
    /// count as zero.
    pub fn new(tree: &Vdb543<[f32; 3]>) -> Option<Self> {
        let bbox = tree.active_bbox()?;
        let cubes = |log2_edge: u32| {
            let [low, high] = [bbox.min, bbox.max].map(|corner| (corner >> log2_edge).as_i64vec3());
            (high - low + 1).as_u64vec3()
        };
        // Twice the edge is an eighth of the points, or fewer along axes that are short.
        let log2_edge = (SMALLEST..31)
            .find(|log2_edge| product(cubes(*log2_edge)).is_some_and(|all| all <= MAX_POINTS))?;
        let size = cubes(log2_edge).as_uvec3();
        let first = bbox.min >> log2_edge;
        let mut sums = vec![(DVec3::ZERO, 0.0); size.element_product() as usize];
        for value in tree.active_values() {
            add(&mut sums, &value, first, log2_edge, size);
        }
        let means: Vec<_> =
            sums.iter().map(|(sum, weight)| (*weight > 0.0).then(|| *sum / *weight)).collect();
        let largest = means.iter().flatten().map(|mean| mean.abs().max_element());
        let largest = largest.fold(0.0, f64::max);
        let unit = if largest > 0.0 { largest.recip() } else { 0.0 };
        Some(Self {
            origin: first << log2_edge,
            log2_edge,
            size,
            largest: largest as f32,
            means: means.into_iter().map(|mean| words(mean, unit)).collect(),
        })
    }
}

fn product(size: U64Vec3) -> Option<u64> {
    size.x.checked_mul(size.y)?.checked_mul(size.z)
}

/// Adds a value to the cubes that it is in. A tile is in one cube, or fills whole cubes.
fn add(
    sums: &mut [(DVec3, f64)],
    value: &ValueAt<[f32; 3]>,
    first: IVec3,
    log2_edge: u32,
    size: UVec3,
) {
    let vector = value.value.map(|x| if x.is_finite() { f64::from(x) } else { 0.0 });
    let vector = DVec3::from_array(vector);
    let low = ((value.origin >> log2_edge) - first).as_uvec3();
    let edge = 1_u32 << value.log2_dim.saturating_sub(log2_edge);
    let voxels = (3 * value.log2_dim.min(log2_edge)).min(1023) as i32;
    let weight = 2.0_f64.powi(voxels);
    let high = (low + edge).min(size);
    for z in low.z..high.z {
        for y in low.y..high.y {
            for x in low.x..high.x {
                let sum = &mut sums[((z * size.y + y) * size.x + x) as usize];
                sum.0 += weight * vector;
                sum.1 += weight;
            }
        }
    }
}

/// A mean, in units of the largest component.
fn words(mean: Option<DVec3>, unit: f64) -> [u32; 2] {
    let bits = |x: f64| u32::from(f16::from_f64(x).to_bits());
    mean.map_or([0; 2], |mean| {
        let mean = mean * unit;
        [bits(mean.x) | bits(mean.y) << 16, bits(mean.z) | bits(1.0) << 16]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::Tree;

    fn mean(lattice: &VectorLattice, at: [u32; 3]) -> Option<DVec3> {
        let index = (at[2] * lattice.size.y + at[1]) * lattice.size.x + at[0];
        let [xy, zw] = lattice.means[index as usize];
        let number = |word: u32, shift: u32| f16::from_bits((word >> shift) as u16).to_f64();
        let vector = DVec3::new(number(xy, 0), number(xy, 16), number(zw, 0));
        (number(zw, 16) == 1.0).then(|| f64::from(lattice.largest) * vector)
    }

    #[test]
    fn means_are_of_active_voxels_alone() {
        let mut tree = Tree::new([9.0; 3]);
        tree.set(IVec3::new(-1, 0, 0), [-4.0, 0.0, 1.0]);
        tree.set(IVec3::new(-8, 7, 7), [-2.0, f32::NAN, 3.0]);
        tree.set(IVec3::new(8, 0, 0), [0.0, 1.0, 0.0]);
        let lattice = VectorLattice::new(&tree).unwrap();
        assert_eq!((lattice.origin, lattice.log2_edge), (IVec3::new(-8, 0, 0), 3));
        assert_eq!((lattice.size, lattice.largest), (UVec3::new(3, 1, 1), 3.0));
        let is_near = |at: [u32; 3], expected: [f64; 3]| {
            let off = mean(&lattice, at).unwrap() - DVec3::from_array(expected);
            assert!(off.length() < 1e-3, "{at:?}: {off}");
        };
        is_near([0, 0, 0], [-3.0, 0.0, 2.0]);
        is_near([2, 0, 0], [0.0, 1.0, 0.0]);
        assert_eq!(mean(&lattice, [1, 0, 0]), None);
    }

    #[test]
    fn tiles_fill_the_cubes_that_they_cover() {
        let mut tree = Tree::new([0.0; 3]);
        tree.insert_tile(IVec3::ZERO, [1.0, 0.0, 0.0], true);
        tree.set(IVec3::new(4096, 0, 0), [0.0, 1.0, 0.0]);
        let lattice = VectorLattice::new(&tree).unwrap();
        assert_eq!((lattice.size, lattice.log2_edge), (UVec3::new(33, 32, 32), 7));
        for at in [[0; 3], [31; 3], [31, 0, 5]] {
            assert_eq!(mean(&lattice, at), Some(DVec3::X), "{at:?}");
        }
        assert_eq!(mean(&lattice, [32, 0, 0]), Some(DVec3::Y));
        assert_eq!(mean(&lattice, [32, 1, 0]), None);
    }

    #[test]
    fn nothing_has_no_lattice_and_a_wide_tree_a_coarse_one() {
        let mut tree = Tree::new([0.0; 3]);
        assert_eq!(VectorLattice::new(&tree), None);
        tree.set(IVec3::splat(i32::MIN), [0.0; 3]);
        tree.set(IVec3::splat(i32::MAX), [0.0, 0.0, -0.0]);
        let lattice = VectorLattice::new(&tree).unwrap();
        assert!(u64::from(lattice.size.element_product()) <= MAX_POINTS);
        assert_eq!((lattice.size, lattice.log2_edge), (UVec3::splat(32), 27));
        assert_eq!((lattice.origin, lattice.largest), (IVec3::splat(i32::MIN), 0.0));
        assert_eq!(mean(&lattice, [31; 3]), Some(DVec3::ZERO));
        assert_eq!(mean(&lattice, [1; 3]), None);
    }
}
