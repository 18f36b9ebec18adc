//! The values of an emissive grid, summarised by place.

use std::collections::BTreeMap;

use glam::{DAffine3, DVec3, IVec3, Vec3};

use super::cells::{self, Cells, Lattice};
use crate::pack::PackedGrid;

/// The largest number of blocks, before those without values are left out.
const MAX_DENSE: u64 = 1 << 14;
/// The largest number of blocks.
pub(super) const MAX_BLOCKS: usize = 1 << 10;
/// log₂ of the edge of the smallest blocks, in voxels.
const SMALLEST: u32 = 2;
/// Ranges of values that a block tells apart.
const BINS: usize = 16;
/// Blocks whose values are all below this fraction of the largest one are merged.
const COLD: f32 = 0.5;
/// log₂ of the number of blocks along each edge that are merged.
const COLD_MERGE: i32 = 2;
/// log₂ of the edge of blocks from which on the borders of tiles need no precision.
pub(super) const COARSE: u32 = 5;

/// The values of a packed fog grid by place: a summary from which the power of any emission can be
/// computed that is a function of the value, without another look at the grid.
///
/// The grid is divided into at most 1,024 blocks, and the values of each into 16 ranges. Of each
/// range, the volume, the centroid, and the mean and the standard deviation of its trilinear
/// interpolant are kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ValueBlocks {
    /// The ranges of all blocks, one block after the other.
    bins: Vec<Bin>,
    /// For each block, its first range, and the place of its largest values.
    blocks: Vec<Block>,
    /// The cell of index space that positions are relative to.
    base: IVec3,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Bin {
    /// Volume in voxels.
    volume: f32,
    centroid: Vec3,
    mean: f32,
    deviation: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Block {
    first: u32,
    hottest: Vec3,
}

/// Light from a block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Source {
    /// The centroid of the light, in the file's world.
    pub position: Vec3,
    /// The intensity: emission per unit of volume, integrated over the file's world.
    pub intensity: Vec3,
}

/// Sums over the values of a range.
#[derive(Clone, Copy, Default)]
struct Sums {
    volume: f64,
    place: DVec3,
    value: f64,
    square: f64,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.volume += other.volume;
        self.place += other.place;
        self.value += other.value;
        self.square += other.square;
    }

    fn bin(&self) -> Bin {
        let mean = self.value / self.volume;
        let variance = self.square / self.volume - mean * mean;
        Bin {
            volume: self.volume as f32,
            centroid: (self.place / self.volume).as_vec3(),
            mean: mean as f32,
            deviation: variance.max(0.0).sqrt() as f32,
        }
    }
}

type Histogram = [Sums; BINS];

impl ValueBlocks {
    /// The summary of a grid that was packed as fog.
    pub fn new(grid: &PackedGrid) -> Self {
        let (Some(occupied), true) = (grid.occupied, grid.majorant > 0.0) else {
            return Self::default();
        };
        let lattice = Lattice::over(occupied, SMALLEST, MAX_DENSE);
        let mut dense = vec![Histogram::default(); lattice.cubes()];
        cells::visit(grid, lattice.log2_edge >= COARSE, |cells| {
            lattice.divide(cells, |cube, part| add_cells(&mut dense[cube], part, grid.majorant));
        });
        let mut blocks = BTreeMap::new();
        for (cube, histogram) in dense.into_iter().enumerate() {
            if histogram.iter().all(|own| own.volume == 0.0) {
                continue;
            }
            let at = lattice.cube(cube);
            // The coldest ranges are the lowest.
            let hot = histogram[(COLD * BINS as f32) as usize..].iter().any(|own| own.volume > 0.0);
            let at = if hot { at } else { at >> COLD_MERGE };
            merge(&mut blocks, (hot, at.to_array()), &histogram);
        }
        while blocks.len() > MAX_BLOCKS {
            let finer = std::mem::take(&mut blocks);
            for ((hot, at), histogram) in finer {
                merge(&mut blocks, (hot, at.map(|c| c >> 1)), &histogram);
            }
        }
        Self::of(blocks.into_values(), grid)
    }

    fn of(histograms: impl Iterator<Item = Box<Histogram>>, grid: &PackedGrid) -> Self {
        let mut all = Self { base: grid.base, ..Self::default() };
        for histogram in histograms {
            let first = all.bins.len() as u32;
            all.bins.extend(histogram.iter().filter(|own| own.volume > 0.0).map(Sums::bin));
            let (mut place, mut weights) = (DVec3::ZERO, 0.0);
            for bin in &all.bins[first as usize..] {
                let weight = f64::from(bin.volume) * f64::from(bin.mean / grid.majorant).powi(8);
                place += weight * bin.centroid.as_dvec3();
                weights += weight;
            }
            let hottest = if weights > 0.0 {
                (place / weights).as_vec3()
            } else {
                all.bins[first as usize].centroid
            };
            all.blocks.push(Block { first, hottest });
        }
        all
    }

    /// The number of blocks.
    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Whether no value is positive.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.bins) + size_of_val(&*self.blocks)) as u64
    }

    /// The places of the blocks' largest values, in the file's world.
    pub fn hottest(&self, world_from_index: DAffine3) -> Vec<DVec3> {
        let place = |block: &Block| {
            world_from_index.transform_point3(self.base.as_dvec3() + block.hottest.as_dvec3())
        };
        self.blocks.iter().map(place).collect()
    }

    /// The light of each block, for an emission that is a function of the value: what is emitted
    /// per steradian by a unit of volume of the file's world, as RGB.
    pub fn sources(
        &self,
        world_from_index: DAffine3,
        emission: impl Fn(f32) -> [f32; 3],
    ) -> Vec<Source> {
        let voxel = world_from_index.matrix3.determinant().abs();
        let ends = self.blocks.iter().skip(1).map(|block| block.first as usize);
        let ends = ends.chain([self.bins.len()]);
        let sources = self.blocks.iter().zip(ends).map(|(block, end)| {
            let bins = &self.bins[block.first as usize..end];
            let (mut intensity, mut place, mut weights) = (DVec3::ZERO, DVec3::ZERO, 0.0);
            for bin in bins {
                // Two points with the mean and the deviation of the range: Gauss–Legendre
                // quadrature, if its values are spread evenly.
                let ends = [bin.mean - bin.deviation, bin.mean + bin.deviation];
                let [low, high] = ends.map(|value| emission(value.max(f32::MIN_POSITIVE)));
                let mean =
                    0.5 * (DVec3::from(low.map(f64::from)) + DVec3::from(high.map(f64::from)));
                let own = voxel * f64::from(bin.volume) * mean;
                let weight = own.element_sum();
                intensity += own;
                place += weight * bin.centroid.as_dvec3();
                weights += weight;
            }
            let place = if weights > 0.0 { place / weights } else { block.hottest.as_dvec3() };
            let place = world_from_index.transform_point3(self.base.as_dvec3() + place);
            Source { position: place.as_vec3(), intensity: intensity.as_vec3() }
        });
        sources.collect()
    }
}

fn merge(
    blocks: &mut BTreeMap<(bool, [i32; 3]), Box<Histogram>>,
    key: (bool, [i32; 3]),
    own: &Histogram,
) {
    let sums = blocks.entry(key).or_default();
    for (sum, own) in sums.iter_mut().zip(own) {
        sum.add(own);
    }
}

/// Gauss–Legendre quadrature on an interval of length 1: the points and their weights.
const ONE: [(f32, f32); 1] = [(0.5, 1.0)];
const TWO: [(f32, f32); 2] = [(0.211_324_87, 0.5), (0.788_675_1, 0.5)];
const FOUR: [(f32, f32); 4] = [
    (0.069_431_84, 0.173_927_42),
    (0.330_009_5, 0.326_072_58),
    (0.669_990_5, 0.326_072_58),
    (0.930_568_16, 0.173_927_42),
];

/// Adds the values of cells to a histogram of values up to `most`.
///
/// The luminance of a black body grows with about the fourteenth power of the temperature, so one
/// point is exact to 1 % where values differ by a twentieth, and two on each axis where they differ
/// by a quarter.
fn add_cells(histogram: &mut Histogram, cells: &Cells, most: f32) {
    let largest = cells.corners.iter().copied().fold(0.0, f32::max);
    let least = cells.corners.iter().copied().fold(f32::INFINITY, f32::min);
    if least >= 0.95 * largest {
        add_points(histogram, cells, most, &ONE);
    } else if least >= 0.75 * largest {
        add_points(histogram, cells, most, &TWO);
    } else {
        add_points(histogram, cells, most, &FOUR);
    }
}

fn add_points(histogram: &mut Histogram, cells: &Cells, most: f32, points: &[(f32, f32)]) {
    let edge = f64::from(1_u32 << cells.log2_edge);
    let origin = cells.origin.as_dvec3();
    let c = &cells.corners;
    for (x, of_x) in points {
        let plane: [f32; 4] = std::array::from_fn(|i| c[i] + (c[i + 4] - c[i]) * x);
        for (y, of_y) in points {
            let row = [0, 1].map(|i| plane[i] + (plane[i + 2] - plane[i]) * y);
            for (z, of_z) in points {
                let value = row[0] + (row[1] - row[0]) * z;
                if value > 0.0 {
                    let bin = (value / most * BINS as f32) as usize;
                    let volume = edge * edge * edge * f64::from(of_x * of_y * of_z);
                    let place = DVec3::new((*x).into(), (*y).into(), (*z).into());
                    let value = f64::from(value);
                    histogram[bin.min(BINS - 1)].add(&Sums {
                        volume,
                        place: volume * (origin + edge * place),
                        value: volume * value,
                        square: volume * value * value,
                    });
                }
            }
        }
    }
}
