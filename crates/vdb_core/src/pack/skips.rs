//! Empty-space skipping: for each empty cell and each of the eight octants of directions, the
//! largest empty cube that begins at the cell.
//!
//! A ray never turns back on any axis, so only the cells in its own octant matter. The cube can
//! therefore be larger than one centred on the cell, and takes three bits per octant. Sizes that
//! three bits cannot represent are rounded down.

use glam::IVec3;

/// log₂ of the cells per edge of a chunk.
pub(super) const CHUNK_BITS: i32 = 4;
const EDGE: usize = 1 << CHUNK_BITS;

/// The occupied cells of a chunk: for each x and y a row along z, one bit per cell.
pub(super) type Chunk = [[u16; EDGE]; EDGE];

/// Edges of cubes by code; [`layout::skip`](super::layout::skip) has the same.
pub(super) const SIZES: [usize; 8] = [1, 2, 3, 4, 6, 8, 12, 16];

/// A chunk and those that follow it in one octant, mirrored so that they follow upwards: rows of 32
/// cells along z.
type Window = [[u32; 2 * EDGE]; 2 * EDGE];

/// Whether a direction is negative on an axis: octant bits 4, 2, 1 for x, y, z.
fn turned(octant: u32) -> [bool; 3] {
    [octant & 4 != 0, octant & 2 != 0, octant & 1 != 0]
}

fn empty_cells<'a>(octant: u32, chunk_at: &impl Fn(IVec3) -> Option<&'a Chunk>) -> Window {
    let turned = turned(octant);
    let mut window = [[u32::MAX; 2 * EDGE]; 2 * EDGE];
    for part in 0..8 {
        let part = IVec3::new(part >> 2, part >> 1 & 1, part & 1);
        let step = IVec3::from_array(turned.map(|turned| if turned { -1 } else { 1 }));
        let Some(chunk) = chunk_at(part * step) else { continue };
        for (x, plane) in chunk.iter().enumerate() {
            let x = if turned[0] { EDGE - 1 - x } else { x } + EDGE * part.x as usize;
            for (y, &row) in plane.iter().enumerate() {
                let y = if turned[1] { EDGE - 1 - y } else { y } + EDGE * part.y as usize;
                let row = if turned[2] { row.reverse_bits() } else { row };
                window[x][y] &= !(u32::from(row) << (EDGE * part.z as usize));
            }
        }
    }
    window
}

/// Given the cells at which a cube of some size is empty, finds those at which a cube larger by
/// `shift` is empty, for the first `edge` rows and planes. The larger cube is covered by cubes of
/// the first size at both ends of each axis, provided `shift` does not exceed that size. Cells
/// beyond the window are never needed: a cube of 16 that begins in the chunk ends at cell 30 or
/// before.
fn grown(cubes: &Window, shift: usize, edge: usize) -> Window {
    let mut window = *cubes;
    for plane in &mut window[..edge + shift] {
        for row in &mut plane[..edge + shift] {
            *row &= *row >> shift;
        }
        // Rows further on are still unchanged.
        for y in 0..edge {
            plane[y] &= plane[y + shift];
        }
    }
    for x in 0..edge {
        let (here, ahead) = window.split_at_mut(x + shift);
        for (row, ahead) in here[x][..edge].iter_mut().zip(&ahead[0]) {
            *row &= ahead;
        }
    }
    window
}

/// The codes of all cells of a chunk, three bits per octant, z fastest; they are meaningless for
/// occupied cells. `chunk_at` returns the chunk itself for zero, and its neighbours by their
/// offset; a missing chunk is empty.
pub(super) fn codes<'a>(chunk_at: impl Fn(IVec3) -> Option<&'a Chunk>) -> Vec<u32> {
    let mut codes = vec![0; EDGE * EDGE * EDGE];
    for octant in 0..8 {
        let one = empty_cells(octant, &chunk_at);
        let two = grown(&one, 1, 30);
        let three = grown(&two, 1, EDGE);
        let four = grown(&two, 2, 28);
        let six = grown(&four, 2, EDGE);
        let eight = grown(&four, 4, 24);
        let twelve = grown(&eight, 4, EDGE);
        let sixteen = grown(&eight, 8, EDGE);
        let turned = turned(octant);
        let place = |c: usize, turned: bool| if turned { EDGE - 1 - c } else { c };
        for x in 0..EDGE {
            for y in 0..EDGE {
                let first =
                    place(x, turned[0]) << (2 * CHUNK_BITS) | place(y, turned[1]) << CHUNK_BITS;
                // A larger empty cube contains all smaller ones, so the code is the number of sizes
                // that fit, less one.
                let at = |window: &Window| window[x][y];
                let high = at(&six);
                let middle = at(&three) & !high | at(&twelve);
                let low = at(&two) & !at(&three)
                    | at(&four) & !high
                    | at(&eight) & !at(&twelve)
                    | at(&sixteen);
                if low | middle | high == 0 {
                    continue;
                }
                for (z, code) in codes[first..first + EDGE].iter_mut().enumerate() {
                    let z = place(z, turned[2]);
                    let three_bits = low >> z & 1 | (middle >> z & 1) << 1 | (high >> z & 1) << 2;
                    *code |= three_bits << (3 * octant);
                }
            }
        }
    }
    codes
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
