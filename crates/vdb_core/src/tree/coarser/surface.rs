//! Downsampling of surfaces: keeps thin parts, and extends the distances of the band.

use glam::Vec3;

use super::EDGE;
use super::alike::each;
use super::block::Block;

/// An unknown distance, beyond a band of `width`, becomes one beyond a band twice as wide.
pub(super) fn widened(value: f32, width: f32) -> f32 {
    if value.abs() < width { value } else { (2.0 * width).copysign(value) }
}

/// The samples of a coarser leaf, with two rings around it.
pub(super) struct Rings(Vec<f32>);

/// Edge of the rings, in samples.
const RINGED: usize = EDGE + 4;

fn ringed([x, y, z]: [usize; 3]) -> usize {
    (x * RINGED + y) * RINGED + z
}

impl Rings {
    /// The samples from a block that begins two finer samples before the outer ring.
    pub fn new(block: &Block, iso: f32) -> Self {
        let mut values = Vec::with_capacity(RINGED.pow(3));
        each([(0, RINGED as i64 - 1); 3], |c| {
            values.push(block.at(c.map(|c| 2 * c as usize + 2)));
            true
        });
        let mut rings = Self(values);
        if !block.values.iter().any(|value| *value < iso) {
            return rings;
        }
        let last = block.edge as i64 - 1;
        each([(1, last - 1); 3], |c| {
            let c = c.map(|c| c as usize);
            if block.at(c) < iso {
                rings.keep(block, iso, c);
            }
            true
        });
        rings
    }

    /// Ensures that the solid at a point of the block remains solid in an adjacent coarse sample.
    fn keep(&mut self, block: &Block, iso: f32, place: [usize; 3]) {
        // Points with an even coordinate are their own neighbours on both sides.
        let beside = (0..8).map(|i| {
            [0, 1, 2].map(|axis| {
                let (c, side) = (place[axis], i >> axis & 1);
                if c % 2 == 0 { c } else { c - 1 + 2 * side }
            })
        });
        if beside.clone().any(|at| block.at(at) < iso) || block.is_thick(place, iso) {
            return;
        }
        let Some(nearest) = beside.min_by(|a, b| block.at(*a).total_cmp(&block.at(*b))) else {
            return;
        };
        // Neighbours beyond the outer ring are not stored.
        let own = nearest.map(|c| (c / 2).wrapping_sub(1));
        if own.iter().all(|c| *c < RINGED) {
            let own = &mut self.0[ringed(own)];
            *own = own.min(block.at(place));
        }
    }

    /// Extends distances beyond a band of `width` to twice the width, along straight lines: the
    /// first ring beyond the band from the samples of the block, the second from the first.
    pub fn widen(&mut self, block: &Block, width: f32, voxel: f32) {
        self.0.iter_mut().for_each(|value| *value = widened(*value, width));
        let unknown = |value: f32| value.abs() >= 2.0 * width;
        let mut uphill: Vec<Option<Vec3>> = vec![None; self.0.len()];
        // For each row of the block, the samples within the band, one bit per sample.
        let bit = |(z, value): (usize, &f32)| u32::from(value.abs() < width) << z;
        let rows = block.values.chunks_exact(block.edge);
        let known: Vec<u32> = rows.map(|row| row.iter().enumerate().map(bit).sum()).collect();
        // Slopes of the block's samples, cached because several samples use each.
        let mut slopes: Vec<Option<Option<Vec3>>> = vec![None; block.values.len()];
        for ring in 1..=2 {
            let (values, directions) = (self.0.clone(), uphill.clone());
            let inner = (ring as i64, (RINGED - 1 - ring) as i64);
            each([inner; 3], |c| {
                let c = c.map(|c| c as usize);
                let mut line = Line::of(values[ringed(c)]);
                if !unknown(line.value) {
                    return true;
                }
                if ring == 1 {
                    for (x, y) in (-2..=2).flat_map(|x| (-2..=2).map(move |y| (x, y))) {
                        let [i, j] = [(c[0], x), (c[1], y)]
                            .map(|(c, side)| (2 * c as i64 + 2 + side) as usize);
                        let mut row = known[i * block.edge + j] >> (2 * c[2]) & 0x1f;
                        while row != 0 {
                            let z = row.trailing_zeros() as usize;
                            row &= row - 1;
                            let at = [i, j, 2 * c[2] + z];
                            let slope = &mut slopes[block.index(at)];
                            let slope = *slope.get_or_insert_with(|| block.uphill(at, width));
                            line.meet(block.at(at), slope, [x, y, z as i64 - 2], 0.5 * voxel);
                        }
                    }
                } else {
                    each([(-1, 1); 3], |side| {
                        let at = [0, 1, 2].map(|axis| (c[axis] as i64 + side[axis]) as usize);
                        line.meet(values[ringed(at)], directions[ringed(at)], side, voxel);
                        true
                    });
                }
                uphill[ringed(c)] = line.uphill;
                // An unknown distance is at least the width of the band.
                let found = line.value.abs().clamp(width, 2.0 * width);
                self.0[ringed(c)] = found.copysign(values[ringed(c)]);
                true
            });
        }
    }

    /// The samples of the leaf without the rings.
    pub fn inner(self) -> Vec<f32> {
        let own = 2..2 + EDGE;
        let rows = own.clone().flat_map(|x| own.clone().map(move |y| ringed([x, y, 2])));
        rows.flat_map(|row| &self.0[row..row + EDGE]).copied().collect()
    }
}

/// The line from a sample to the surface, estimated from neighbouring samples.
struct Line {
    is_inside: bool,
    /// The distance according to the best neighbour.
    value: f32,
    /// The direction in which distances grow there.
    uphill: Option<Vec3>,
    /// The cosine of the angle between that direction and the way from the neighbour; 1 is best.
    cosine: f32,
}

impl Line {
    fn of(value: f32) -> Self {
        Self { is_inside: value < 0.0, value, uphill: None, cosine: 0.0 }
    }

    /// Considers a neighbour `side` edges away, whose distance is extrapolated linearly along its
    /// direction. That is exact next to a plane.
    fn meet(&mut self, value: f32, uphill: Option<Vec3>, side: [i64; 3], edge: f32) {
        let Some(uphill) = uphill else { return };
        let way = Vec3::from_array(side.map(|side| -side as f32));
        let along = uphill.dot(way);
        let outwards = if self.is_inside { -along } else { along };
        if outwards.is_nan() || outwards <= 0.0 {
            return;
        }
        let cosine = outwards / way.length().max(1.0);
        if cosine > self.cosine {
            let value = value + along * edge;
            *self = Self { value, uphill: Some(uphill), cosine, ..*self };
        }
    }
}
