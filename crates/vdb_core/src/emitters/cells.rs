//! All cells of a packed fog grid that have a density.

use glam::IVec3;

use crate::pack::{PackedGrid, traverse};
use crate::tree::CoordBox;

/// A cube of equal cells, or one cell.
pub(super) struct Cells {
    /// The lowest cell, relative to the grid's base.
    pub origin: IVec3,
    /// log₂ of the edge.
    pub log2_edge: u32,
    /// The samples at the corners of each cell, `x·4 + y·2 + z`.
    pub corners: [f32; 8],
}

/// Edge of a leaf: log₂.
const LEAF: u32 = 3;

/// Visits all cells that have a density. Where `coarse`, cells at the border of a tile may get the
/// value of the tile, eight voxels deep.
pub(super) fn visit(grid: &PackedGrid, coarse: bool, mut found: impl FnMut(&Cells)) {
    let Some(occupied) = grid.occupied else { return };
    let widest = occupied.dim().into_iter().max().unwrap_or(1);
    let log2_edge = widest.next_power_of_two().ilog2().clamp(LEAF, 30);
    let first = occupied.min >> log2_edge as i32;
    let last = occupied.max >> log2_edge as i32;
    let mut visitor = Visitor { grid, occupied, coarse, found: &mut found };
    for x in first.x..=last.x {
        for y in first.y..=last.y {
            for z in first.z..=last.z {
                visitor.cube(IVec3::new(x, y, z) << log2_edge as i32, log2_edge);
            }
        }
    }
}

struct Visitor<'a, F> {
    grid: &'a PackedGrid,
    occupied: CoordBox,
    coarse: bool,
    found: &'a mut F,
}

impl<F: FnMut(&Cells)> Visitor<'_, F> {
    fn cube(&mut self, origin: IVec3, log2_edge: u32) {
        let Some(inside) = self.occupied.intersection(CoordBox::cube(origin, log2_edge)) else {
            return;
        };
        let span = traverse::locate(self.grid, inside.min, 0);
        let is_border = self.coarse && log2_edge == LEAF && span.occupied() && span.constant();
        if span.log_dim >= log2_edge || is_border {
            if span.occupied() {
                let corners = traverse::corners(self.grid, span, inside.min);
                (self.found)(&Cells { origin, log2_edge, corners });
            }
            return;
        }
        let half = log2_edge - 1;
        for child in 0..8 {
            let offset = IVec3::new(child >> 2, child >> 1 & 1, child & 1);
            self.cube(origin + (offset << half as i32), half);
        }
    }
}

/// A lattice of cubes, aligned to multiples of their edge, over the occupied box of a grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    /// log₂ of the edge of a cube, in voxels.
    pub log2_edge: u32,
    /// The number of the first cube on each axis, counted from the grid's base.
    pub low: IVec3,
    /// The number of cubes on each axis.
    pub size: IVec3,
}

impl Lattice {
    /// The finest lattice of at most `most` cubes with edges of `2^smallest` voxels or more.
    pub fn over(occupied: CoordBox, smallest: u32, most: u64) -> Self {
        let of = |log2_edge: u32| {
            let (low, high) = (occupied.min >> log2_edge as i32, occupied.max >> log2_edge as i32);
            (low, (high.as_i64vec3() - low.as_i64vec3() + 1).as_u64vec3())
        };
        let is_small = |log2_edge: &u32| {
            let size = of(*log2_edge).1;
            size.x.saturating_mul(size.y).saturating_mul(size.z) <= most
        };
        let log2_edge = (smallest..31).find(is_small).unwrap_or(31);
        let (low, size) = of(log2_edge);
        Self { log2_edge, low, size: size.as_ivec3() }
    }

    /// The number of cubes.
    pub fn cubes(&self) -> usize {
        self.size.as_u64vec3().element_product() as usize
    }

    /// The index of a cube: z fastest.
    pub fn index(&self, cube: IVec3) -> usize {
        ((cube.x * self.size.y + cube.y) * self.size.z + cube.z) as usize
    }

    /// The cube with an index.
    pub fn cube(&self, index: usize) -> IVec3 {
        let (size, index) = (self.size.as_u64vec3(), index as u64);
        let xy = index / size.z;
        IVec3::new((xy / size.y) as i32, (xy % size.y) as i32, (index % size.z) as i32)
    }

    /// Calls `found` with the index of each cube of the lattice that some cells lie in, and the
    /// part of the cells in it.
    pub fn divide(&self, cells: &Cells, mut found: impl FnMut(usize, &Cells)) {
        let first = (cells.origin >> self.log2_edge as i32) - self.low;
        if cells.log2_edge <= self.log2_edge {
            found(self.index(first), cells);
            return;
        }
        // The cubes of a tile, which may extend beyond the box.
        let end = (first + (1 << (cells.log2_edge - self.log2_edge))).min(self.size);
        let begin = first.max(IVec3::ZERO);
        for x in begin.x..end.x {
            for y in begin.y..end.y {
                for z in begin.z..end.z {
                    let cube = IVec3::new(x, y, z);
                    let origin = (cube + self.low) << self.log2_edge as i32;
                    let part = Cells { origin, log2_edge: self.log2_edge, ..*cells };
                    found(self.index(cube), &part);
                }
            }
        }
    }
}
