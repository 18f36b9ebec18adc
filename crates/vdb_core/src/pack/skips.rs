//! Empty-space skipping: for each empty cell and each of the eight octants of directions, the
//! largest empty cube that begins at the cell.
//!
//! A ray never turns back on any axis, so only the cells in its own octant matter. The cube can
//! therefore be larger than one centred on the cell, and takes three bits per octant. Sizes that
//! three bits cannot represent are rounded down.

use std::ops::Range;

use glam::IVec3;

use super::bits::transposed;

/// log₂ of the cells per edge of a chunk.
pub(super) const CHUNK_BITS: i32 = 4;
const EDGE: usize = 1 << CHUNK_BITS;

/// The occupied cells of a chunk: for each x and y a row along z, one bit per cell.
pub(super) type Chunk = [[u16; EDGE]; EDGE];

/// Edges of cubes by code; [`layout::skip`](super::layout::skip) has the same.
pub(super) const SIZES: [usize; 8] = [1, 2, 3, 4, 6, 8, 12, 16];

/// Cells per edge of a chunk with its neighbours.
const AROUND: usize = 3 * EDGE;

/// A set of cells of a chunk and its neighbours: rows along z, one bit per cell.
type Window = [[u64; AROUND]; AROUND];

/// One bit of the codes of all cells of a chunk: rows `x·16 + y`.
type Plane = [u16; EDGE * EDGE];

/// The bits of a cell's codes: three for each octant.
const BITS: usize = 24;

/// Whether a direction is negative on an axis: octant bits 4, 2, 1 for x, y, z.
fn turned(octant: u32) -> [bool; 3] {
    [octant & 4 != 0, octant & 2 != 0, octant & 1 != 0]
}

fn empty_cells<'a>(chunk_at: impl Fn(IVec3) -> Option<&'a Chunk>) -> Window {
    let mut window = [[u64::MAX; AROUND]; AROUND];
    for part in 0..27 {
        let part = IVec3::new(part / 9, part / 3 % 3, part % 3);
        let Some(chunk) = chunk_at(part - 1) else { continue };
        let [x, y, z] = part.to_array().map(|c| c as usize * EDGE);
        for (rows, plane) in window[x..].iter_mut().zip(chunk) {
            for (row, occupied) in rows[y..].iter_mut().zip(plane) {
                *row &= !(u64::from(*occupied) << z);
            }
        }
    }
    window
}

/// Given the cells at whose high sides a cube of some size is empty, finds those at which a cube
/// larger by `shift` is empty, for the rows and planes in a range. The larger cube is covered by
/// cubes of the first size at both ends of each axis, provided `shift` does not exceed that size.
fn grow(cubes: &Window, shift: usize, range: Range<usize>, larger: &mut Window) {
    for x in range.start..range.end + shift {
        let mut rows = cubes[x];
        rows.iter_mut().for_each(|row| *row &= *row >> shift);
        for (y, larger) in larger[x].iter_mut().enumerate().take(range.end).skip(range.start) {
            *larger = rows[y] & rows[y + shift];
        }
    }
    for x in range.clone() {
        let (here, ahead) = larger.split_at_mut(x + shift);
        let rows = here[x][range.clone()].iter_mut();
        rows.zip(&ahead[0][range.clone()]).for_each(|(row, ahead)| *row &= ahead);
    }
}

/// Changes the bits of all cells of a chunk at which the next larger cube is empty, too. `code` is
/// that of the cube.
fn add_cubes(code: usize, cubes: &Window, planes: &mut [Plane; BITS]) {
    let before = SIZES[code] - 1;
    for octant in 0..8 {
        // A cube that extends to lower cells begins that much before.
        let [x, y, z] = turned(octant).map(|turned| EDGE - if turned { before } else { 0 });
        // A larger empty cube contains all smaller ones, so the code is the number of sizes that
        // fit, less one. Each bit of a number changes when one more power of two is counted.
        for bit in (0..3).filter(|bit| code.is_multiple_of(1 << bit)) {
            let plane = &mut planes[3 * octant as usize + bit];
            for (own, rows) in plane.as_chunks_mut::<EDGE>().0.iter_mut().zip(&cubes[x..]) {
                for (own, row) in own.iter_mut().zip(&rows[y..]) {
                    *own ^= (row >> z) as u16;
                }
            }
        }
    }
}

/// The words of all cells of a chunk, from their bits.
fn spread(planes: &[Plane; BITS]) -> Vec<u32> {
    let mut codes = vec![0; EDGE * EDGE * EDGE];
    for (row, codes) in codes.as_chunks_mut::<EDGE>().0.iter_mut().enumerate() {
        let mut bytes = [[0_u8; EDGE]; 3];
        for (bytes, planes) in bytes.iter_mut().zip(planes.as_chunks::<8>().0) {
            let bits: [u16; 8] = std::array::from_fn(|bit| planes[bit][row]);
            let low = transposed(u64::from_le_bytes(bits.map(|bits| bits as u8)));
            let high = transposed(u64::from_le_bytes(bits.map(|bits| (bits >> 8) as u8)));
            bytes[..8].copy_from_slice(&low.to_le_bytes());
            bytes[8..].copy_from_slice(&high.to_le_bytes());
        }
        let [low, middle, high] = bytes;
        for (z, code) in codes.iter_mut().enumerate() {
            *code = u32::from(low[z]) | u32::from(middle[z]) << 8 | u32::from(high[z]) << 16;
        }
    }
    codes
}

/// The codes of all cells of a chunk, three bits per octant, z fastest; they are meaningless for
/// occupied cells. `chunk_at` returns the chunk itself for zero, and its neighbours by their
/// offset; a missing chunk is empty.
pub(super) fn codes<'a>(chunk_at: impl Fn(IVec3) -> Option<&'a Chunk>) -> Vec<u32> {
    // Cubes are found by their lowest cells, so that all octants share them. A cube of 16 that
    // begins in the last row of the chunk consists of two of 8, which begin 8 rows apart, and so on.
    const END: usize = 2 * EDGE;
    let mut planes = [[0; EDGE * EDGE]; BITS];
    let one = empty_cells(chunk_at);
    let [mut two, mut four, mut eight, mut other] = [[[0; AROUND]; AROUND]; 4];
    grow(&one, 1, 1..END + 14, &mut two);
    add_cubes(1, &two, &mut planes);
    grow(&two, 1, EDGE - 2..END, &mut other);
    add_cubes(2, &other, &mut planes);
    grow(&two, 2, 1..END + 12, &mut four);
    add_cubes(3, &four, &mut planes);
    grow(&four, 2, EDGE - 5..END, &mut other);
    add_cubes(4, &other, &mut planes);
    grow(&four, 4, 1..END + 8, &mut eight);
    add_cubes(5, &eight, &mut planes);
    grow(&eight, 4, EDGE - 11..END, &mut other);
    add_cubes(6, &other, &mut planes);
    grow(&eight, 8, 1..END, &mut other);
    add_cubes(7, &other, &mut planes);
    spread(&planes)
}

/// The occupied cells of a chunk and its neighbours, relative to the chunk's first cell, if there
/// are at most `most`.
pub(super) fn few_around<'a>(
    chunk_at: impl Fn(IVec3) -> Option<&'a Chunk>,
    most: usize,
) -> Option<Vec<IVec3>> {
    let mut cells = Vec::new();
    for i in 0..27 {
        let beside = IVec3::new(i / 9, i / 3 % 3, i % 3) - 1;
        let Some(chunk) = chunk_at(beside) else { continue };
        for (x, plane) in chunk.iter().enumerate() {
            for (y, &row) in plane.iter().enumerate().filter(|(_, row)| **row != 0) {
                if cells.len() + row.count_ones() as usize > most {
                    return None;
                }
                let inside = (0..EDGE).filter(|z| row >> z & 1 == 1);
                let cell = |z| (beside << CHUNK_BITS) + IVec3::new(x as i32, y as i32, z as i32);
                cells.extend(inside.map(cell));
            }
        }
    }
    Some(cells)
}

/// The code of an empty cell of a chunk with few occupied cells in and around it. Equal to that of
/// [`codes`], in time proportional to the number of occupied cells.
pub(super) fn code(cell: IVec3, occupied: &[IVec3]) -> u32 {
    let mut sizes = [EDGE as i32; 8];
    for other in occupied {
        let away = *other - cell;
        // A cube at the cell contains the other cell if its edge exceeds this distance.
        let distance = away.abs().max_element();
        for (octant, size) in sizes.iter_mut().enumerate() {
            let turned = turned(octant as u32);
            let ahead = |axis: usize| if turned[axis] { away[axis] <= 0 } else { away[axis] >= 0 };
            if ahead(0) && ahead(1) && ahead(2) {
                *size = distance.min(*size);
            }
        }
    }
    // For an occupied cell, the size 0 counts as 1.
    let code_of =
        |size: i32| SIZES.iter().filter(|own| **own <= size.max(1) as usize).count() as u32 - 1;
    (0..8).map(|octant| code_of(sizes[octant]) << (3 * octant)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::Random;
    use std::collections::HashMap;

    #[test]
    fn cubes_are_empty_and_could_not_be_larger() {
        let mut random = Random::new(3);
        for share in [2, 20, 300, 3000, 20_000] {
            let mut chunks: HashMap<IVec3, Chunk> = HashMap::new();
            for part in 0..27 {
                let part = IVec3::new(part / 9, part / 3 % 3, part % 3) - 1;
                if random.below(4) == 0 && part != IVec3::ZERO {
                    continue;
                }
                let row =
                    |_| (0..16).fold(0, |row, z| row | u16::from(random.below(share) == 0) << z);
                let mut row = row;
                chunks.insert(part, std::array::from_fn(|_| std::array::from_fn(&mut row)));
            }
            let occupied = |cell: IVec3| {
                chunks.get(&(cell >> 4)).is_some_and(|chunk| {
                    let at = cell & 15;
                    chunk[at.x as usize][at.y as usize] >> at.z & 1 == 1
                })
            };
            let codes = codes(|part| chunks.get(&part));
            let few = few_around(|part| chunks.get(&part), 27 * 4096).expect("there are no more");
            for _ in 0..2000 {
                let slot = random.below(4096) as usize;
                let cell = IVec3::new(slot as i32 >> 8, slot as i32 >> 4 & 15, slot as i32 & 15);
                if occupied(cell) {
                    continue;
                }
                if few.len() < 2000 {
                    assert_eq!(code(cell, &few), codes[slot], "{cell}");
                }
                for octant in 0..8 {
                    let step = turned(octant).map(|turned| if turned { -1 } else { 1 });
                    let is_empty = |size: usize| {
                        (0..size * size * size).all(|i| {
                            let at = [i / size / size, i / size % size, i % size];
                            let at = at.map(|c| c as i32);
                            !occupied(cell + IVec3::from_array(at) * IVec3::from_array(step))
                        })
                    };
                    let code = (codes[slot] >> (3 * octant) & 7) as usize;
                    assert!(is_empty(SIZES[code]), "{cell} octant {octant}: {code}");
                    assert!(code == 7 || !is_empty(SIZES[code + 1]), "{cell} octant {octant}");
                    let skip = super::super::layout::skip(codes[slot], octant);
                    assert_eq!(skip as usize + 1, SIZES[code]);
                }
            }
        }
    }
}
