//! Distances and signs of the voxels of a leaf.

use std::ops::Range;

use super::band::Band;
use super::crossings::Crossings;
use super::triangle::{LANES, SLACK, Triangle};
use crate::tools::nodes::Leaf;
use crate::tree::grow::{Built, built};
use crate::tree::{IVec3, Node};
use crate::work::{Stop, Work};

const EDGE: usize = Leaf::DIM as usize;
const GROUPS: usize = Leaf::SIZE / LANES;

/// A leaf near some triangles, or a tile if none of its voxels is in the band.
pub(super) fn build<'a>(
    triangles: impl Iterator<Item = &'a Triangle>,
    origin: IVec3,
    band: &Band,
    crossings: &Crossings,
    work: &Work,
) -> Result<Built<Leaf>, Stop> {
    let farthest = band.half_width * band.half_width;
    let mut nearest = Nearest {
        squares: [[farthest; LANES]; GROUPS],
        bounds: [[farthest as f32 + SLACK; LANES]; GROUPS],
    };
    for triangle in triangles {
        nearest.lower(triangle, origin, band.half_width);
    }
    let squares = nearest.squares.as_flattened();
    if squares.iter().all(|&square| square >= farthest) {
        let winding = crossings.at(origin.x, origin.y, origin.z);
        return Ok(Built::Tile(band.far(winding), false));
    }
    work.take(size_of::<Leaf>() as u64)?;
    let mut leaf = Leaf::filled(origin, band.background, false);
    for (line, squares) in squares.chunks_exact(EDGE).enumerate() {
        let (x, y) = ((line / EDGE) as i32, (line % EDGE) as i32);
        let windings = crossings.upwards(origin.x + x, origin.y + y, origin.z);
        for (z, (square, winding)) in squares.iter().zip(windings).enumerate() {
            let distance = (square.sqrt() * band.scale) as f32;
            let far = band.far(winding);
            // Compared as a float, so that active values are less than the background.
            let active = distance < band.background;
            let slot = line * EDGE + z;
            leaf.values_slice_mut()[slot] = if active { distance.copysign(far) } else { far };
            leaf.value_mask_mut().set(slot, active);
        }
    }
    Ok(built(leaf))
}

/// The voxels of a leaf between two coordinates relative to it. Without SSE 4.1, `ceil` and `floor`
/// are calls that took half of the time of everything here.
fn voxels(low: f64, high: f64) -> Range<i32> {
    let low = low.clamp(0.0, EDGE as f64);
    let high = high.clamp(-1.0, (EDGE - 1) as f64);
    let down = low as i32;
    let first = down + i32::from(f64::from(down) < low);
    first..if high < 0.0 { 0 } else { high as i32 + 1 }
}

/// Squared distances of the voxels of a leaf, in groups along z.
struct Nearest {
    squares: [[f64; LANES]; GROUPS],
    /// The same in f32, [`SLACK`] larger.
    bounds: [[f32; LANES]; GROUPS],
}

impl Nearest {
    /// Lowers the distances to those from a triangle where these are less.
    fn lower(&mut self, triangle: &Triangle, origin: IVec3, half_width: f64) {
        let start = origin.as_dvec3();
        let disc = triangle.disc(start);
        // Relative to the leaf.
        let (low, high) = (triangle.low - start, triangle.high - start);
        let zs = voxels(low.z - half_width, high.z + half_width);
        if zs.is_empty() {
            return;
        }
        let groups = zs.start as usize / LANES..=(zs.end - 1) as usize / LANES;
        let outside = |at: f64, low: f64, high: f64| (low - at).max(at - high).max(0.0);
        for x in voxels(low.x - half_width, high.x + half_width) {
            let dx = outside(f64::from(x), low.x, high.x);
            for y in voxels(low.y - half_width, high.y + half_width) {
                let dy = outside(f64::from(y), low.y, high.y);
                if dx * dx + dy * dy >= half_width * half_width {
                    continue;
                }
                let line = (x as usize * EDGE + y as usize) * (EDGE / LANES);
                for group in groups.clone() {
                    let p = IVec3::new(x, y, (group * LANES) as i32);
                    if disc.can_lower(p.as_vec3(), &self.bounds[line + group]) {
                        let squares = &mut self.squares[line + group];
                        triangle.lower(start + p.as_dvec3(), squares);
                        self.bounds[line + group] = squares.map(|square| square as f32 + SLACK);
                    }
                }
            }
        }
    }
}
