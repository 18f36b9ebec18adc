//! The cells in which scattered light is solved for.

use glam::{DVec3, UVec3};

/// The largest number of cells along an axis.
pub const MAX_CELLS: u32 = 32;

/// Cubic cells around a fog. Arrays over the cells have x fastest and z slowest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// The lowest corner of the first cell.
    pub low: DVec3,
    /// The edge of a cell, above 0.
    pub edge: f64,
    /// The number of cells along each axis, 1 to [`MAX_CELLS`].
    pub size: UVec3,
}

impl Lattice {
    /// A lattice around a box, with a margin of half a cell, or more along its shorter sides. Its longest side
    /// has `longest` cells, 2 to [`MAX_CELLS`]. The box must be finite; if it has no extent,
    /// it gets one cell with an edge of 1.
    pub fn around([low, high]: [DVec3; 2], longest: u32) -> Self {
        let extent = (high - low).max(DVec3::ZERO);
        let between = longest.clamp(2, MAX_CELLS) - 1;
        let edge = extent.max_element() / f64::from(between);
        let (edge, extent) = if edge.is_normal() { (edge, extent) } else { (1.0, DVec3::ZERO) };
        // Rounding must not add a cell to the longest side.
        let size = (extent / edge - 1e-6).ceil().max(DVec3::ZERO).as_uvec3() + 1;
        let low = low + 0.5 * (high - low) - 0.5 * edge * size.as_dvec3();
        Self { low, edge, size }
    }
}

/// The number of cells of a lattice.
pub(super) fn count(size: UVec3) -> usize {
    size.as_usizevec3().element_product()
}

/// The index of a cell in arrays.
pub(super) fn index(cell: UVec3, size: UVec3) -> usize {
    let (cell, size) = (cell.as_usizevec3(), size.as_usizevec3());
    cell.x + size.x * (cell.y + size.y * cell.z)
}

/// All cells, in the order of arrays.
pub(super) fn cells(size: UVec3) -> impl Iterator<Item = UVec3> {
    let plane = move |z| (0..size.y).map(move |y| (y, z));
    (0..size.z).flat_map(plane).flat_map(move |(y, z)| (0..size.x).map(move |x| UVec3 { x, y, z }))
}
