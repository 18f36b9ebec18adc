//! How much the densities of a fog change from voxel to voxel.

use glam::IVec3;

use super::layout::{BRICK_VALUES, LEAF_VALUES, brick_slot};

/// The distances of [`FogDetail::differences`], in voxels.
const DISTANCES: [usize; 3] = [1, 2, 4];

/// How much the densities of a fog change from voxel to voxel, which decides how densely they and the light in them
/// have to be sampled. Measured in up to 256 leaves when a grid is packed as a whole, or read; densities are
/// relative to [`PackedGrid::majorant`](super::PackedGrid::majorant). Differences across leaves do not count, but for
/// those with the next voxels on the high sides. In fogs without leaves, only the thickness is measured; they and
/// surfaces have the differences and the mean of an even fog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FogDetail {
    /// The second differences `v(i - h) - 2 v(i) + v(i + h)` at distances `h` of 1, 2 and 4 voxels along the axes: the
    /// root of their mean square over voxels `i` of leaves that are not empty.
    pub differences: [f32; 3],
    /// The mean density of these voxels.
    pub mean: f32,
    /// The mean number of voxels that are not empty on a line along an axis, over the lines that pass through leaves
    /// or tiles; the largest of the three axes. 0 for surfaces.
    pub thickness: f32,
}

impl FogDetail {
    /// The same density everywhere.
    pub(super) const EVEN: Self = Self { differences: [0.0; 3], mean: 1.0, thickness: 0.0 };

    /// Measures the bricks of leaves, but not the thickness. Also returns the fraction of their voxels that are not
    /// empty.
    pub(super) fn of(
        bricks: impl Iterator<Item = [f32; BRICK_VALUES]>,
        majorant: f32,
    ) -> (Self, f64) {
        let mut sums = Sums::default();
        bricks.for_each(|brick| sums.add(&brick));
        (sums.relative_to(majorant), sums.filled())
    }
}

#[derive(Default)]
struct Sums {
    squares: [f64; 3],
    differences: [u64; 3],
    densities: f64,
    /// Voxels that are not empty.
    voxels: u64,
    leaves: u64,
}

impl Sums {
    /// Adds the voxels of a leaf that are not empty, and their second differences within its brick.
    fn add(&mut self, brick: &[f32; BRICK_VALUES]) {
        const STRIDES: [usize; 3] = [90, 10, 1];
        self.leaves += 1;
        for voxel in 0..LEAF_VALUES {
            let at = [voxel >> 6, voxel >> 3 & 7, voxel & 7];
            let slot = brick_slot(IVec3::from_array(at.map(|axis| axis as i32)));
            let density = brick[slot];
            if density <= 0.0 {
                continue;
            }
            self.densities += f64::from(density);
            self.voxels += 1;
            for (axis, stride) in STRIDES.into_iter().enumerate() {
                for (i, distance) in DISTANCES.into_iter().enumerate() {
                    if at[axis] >= distance && at[axis] + distance <= 8 {
                        let (low, high) =
                            (brick[slot - distance * stride], brick[slot + distance * stride]);
                        self.squares[i] += f64::from(low - 2.0 * density + high).powi(2);
                        self.differences[i] += 1;
                    }
                }
            }
        }
    }

    fn relative_to(&self, majorant: f32) -> FogDetail {
        if self.voxels == 0 || majorant <= 0.0 {
            return FogDetail::EVEN;
        }
        // Unless a file is damaged, the majorant is the largest density.
        let relative = |value: f64, most: f64| (value / f64::from(majorant)).min(most) as f32;
        let differences = std::array::from_fn(|i| {
            relative((self.squares[i] / self.differences[i].max(1) as f64).sqrt(), 2.0)
        });
        let mean = relative(self.densities / self.voxels as f64, 1.0);
        FogDetail { differences, mean, ..FogDetail::EVEN }
    }

    /// The fraction of the voxels that are not empty.
    fn filled(&self) -> f64 {
        self.voxels as f64 / (self.leaves.max(1) as f64 * LEAF_VALUES as f64)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3Swizzles;

    use super::*;
    use crate::pack::{PackKind, PackOptions, PackedGrid, ValueFormat};
    use crate::synth::fog;
    use crate::tree::{CoordBox, Vdb543};

    /// Of an endless fog, in one leaf.
    fn detail(density: impl Fn(IVec3) -> f32, majorant: f32) -> FogDetail {
        let brick = std::array::from_fn(|i| {
            density(IVec3::from_array([i / 90, i / 10 % 9, i % 10].map(|axis| axis as i32)))
        });
        FogDetail::of([brick].into_iter(), majorant).0
    }

    #[test]
    fn differences_are_relative_to_the_majorant() {
        // Every other layer is half as dense, so along one axis of three every second difference between neighbours
        // is half the majorant, twice.
        let layers = detail(|at| if at.x & 1 == 0 { 8.0 } else { 4.0 }, 8.0);
        let [near, others @ ..] = layers.differences;
        assert!((near - 1.0 / f32::sqrt(3.0)).abs() < 1e-6 && others == [0.0; 2], "{layers:?}");
        assert_eq!(layers.mean, 0.75);
        assert_eq!(detail(|at| (at.x + at.y + at.z) as f32, 27.0).differences, [0.0; 3], "linear");
        let square = detail(|at| 1.0 + (at.x * at.x + at.y * at.y + at.z * at.z) as f32, 200.0);
        assert_eq!(square.differences, [0.01, 0.04, 0.16]);
    }

    #[test]
    fn packed_grids_are_measured_in_any_format() {
        let cloud = fog::cloud(40.0, 3);
        let [full, half, byte] =
            [ValueFormat::Full, ValueFormat::Half, ValueFormat::Byte].map(|format| {
                let options = PackOptions { format, ..PackOptions::default() };
                PackedGrid::with_options(&cloud, PackKind::Fog, &options).unwrap().detail
            });
        assert!(full.differences.is_sorted() && full.differences[0] > 0.01, "{full:?}");
        for other in [half, byte] {
            for (a, b) in full.differences.into_iter().zip(other.differences) {
                assert!((a / b - 1.0).abs() < 0.02, "{full:?} {other:?}");
            }
            assert!((full.mean / other.mean - 1.0).abs() < 0.01, "{full:?} {other:?}");
            assert!((full.thickness / other.thickness - 1.0).abs() < 0.01, "{full:?} {other:?}");
        }
        let tile = fog::block(CoordBox { min: IVec3::ZERO, max: IVec3::splat(127) }, 2.0);
        for (even, thickness) in [(tile, 128.0), (Vdb543::new(0.0), 0.0)] {
            let detail = PackedGrid::new(&even, PackKind::Fog).unwrap().detail;
            assert_eq!(FogDetail { thickness: 0.0, ..detail }, FogDetail::EVEN);
            assert!((detail.thickness - thickness).abs() < 10.0, "{detail:?}");
        }
    }

    #[test]
    fn all_parts_of_a_grid_are_measured() {
        // Rough on one side. With those at its low faces, the grid has 16³ leaves: every 16th would be at such a face.
        let cube = CoordBox { min: IVec3::splat(8), max: IVec3::splat(127) };
        let halves = |turn: fn(IVec3) -> IVec3| {
            // Nowhere quite the same, or else there would be tiles.
            let even = |at: IVec3| 1.0 - 1e-6 * (at.x + at.y + at.z) as f32;
            let is_rough = |at: IVec3| turn(at).x >= 64 && at.x & 1 == 1;
            let density = |at: IVec3| if is_rough(at) { 0.5 } else { even(at) };
            let tree = fog::from_values(cube, density);
            PackedGrid::new(&tree, PackKind::Fog).unwrap().detail.differences[0]
        };
        let expected = f32::sqrt(64.0 / 120.0 / 3.0);
        for turn in [|at: IVec3| at, |at: IVec3| at.yzx(), |at: IVec3| at.zxy()] {
            let found = halves(turn);
            assert!((found / expected - 1.0).abs() < 0.1, "{found} of {expected}");
        }
    }

    #[test]
    fn empty_voxels_do_not_count() {
        let alone = detail(|at| if at == IVec3::splat(4) { 3.0 } else { 0.0 }, 3.0);
        assert_eq!(alone, FogDetail { differences: [2.0; 3], mean: 1.0, thickness: 0.0 });
    }
}
