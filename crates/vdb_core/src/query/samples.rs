//! Samples of a grid, sanitised as for packing.

use glam::{DVec3, IVec3};

use super::local_ray::Passage;
use crate::pack::{PackKind, PackedGrid, density, distance, traverse};
use crate::tree::{Accessor, Found, InternalNode, LeafNode, Node, Vdb543};

type Leaf = LeafNode<f32, 3>;
type Upper = InternalNode<InternalNode<Leaf, 4>, 5>;

/// Reads samples from a tree, or from packed words if there is none.
#[derive(Debug)]
pub(super) enum Samples<'a> {
    Tree(TreeSamples<'a>),
    Packed(&'a PackedGrid),
}

impl<'a> Samples<'a> {
    pub fn new(tree: Option<&'a Vdb543<f32>>, packed: &'a PackedGrid) -> Self {
        match tree {
            Some(tree) => Self::Tree(TreeSamples::new(tree, packed.kind)),
            None => Self::Packed(packed),
        }
    }

    /// One sample; the background outside the 32-bit index space. `None` if it is not known.
    pub fn value(&mut self, ijk: [i64; 3]) -> Option<f32> {
        match self {
            Self::Tree(samples) => Some(samples.value(ijk)),
            Self::Packed(grid) => (0..8).find_map(|corner: usize| {
                let offset = CORNERS[corner].map(|c| c as i64);
                let cell = std::array::from_fn(|axis| ijk[axis].saturating_sub(offset[axis]));
                packed_corners(grid, cell).map(|Corners(values)| values[corner] as f32)
            }),
        }
    }

    /// The samples around the cell of a passage; `None` if they are not known.
    #[inline]
    pub fn of_passage(&mut self, grid: &PackedGrid, passage: &Passage) -> Option<Corners> {
        match self {
            Self::Tree(samples) => {
                let cell = passage.cell.wrapping_add(grid.base);
                Some(samples.corners(cell.to_array().map(i64::from)))
            }
            Self::Packed(_) => occupied_corners(grid, passage.span, passage.cell),
        }
    }

    /// The samples `ijk + {0, 1}³`; `None` if they are not known. Those of cells that can stop or
    /// dim a ray always are.
    pub fn corners(&mut self, ijk: [i64; 3]) -> Option<Corners> {
        match self {
            Self::Tree(samples) => Some(samples.corners(ijk)),
            Self::Packed(grid) => packed_corners(grid, ijk),
        }
    }
}

/// The samples `ijk + {0, 1}³` of a packed grid. Fog has them everywhere, a smooth surface in the
/// cells that it passes through, a surface of voxels nowhere.
fn packed_corners(grid: &PackedGrid, ijk: [i64; 3]) -> Option<Corners> {
    let unoccupied = || (grid.kind == PackKind::Fog).then_some(Corners([0.0; 8]));
    // Not only in the box that rays are clipped to: the part of a grid that is a page also has the
    // cells around it.
    let covered = |local: &IVec3| grid.covers(*local);
    let Some(local) = local_cell(grid, ijk).filter(covered) else { return unoccupied() };
    let span = traverse::locate(grid, local, 0);
    if span.occupied() { occupied_corners(grid, span, local) } else { unoccupied() }
}

/// The same for an occupied local cell.
#[inline]
fn occupied_corners(grid: &PackedGrid, span: traverse::Span, local: IVec3) -> Option<Corners> {
    let iso = match grid.kind {
        PackKind::Fog => 0.0,
        // The inside of a solid tile has no values.
        PackKind::Smooth { iso } if !span.constant() => f64::from(iso),
        PackKind::Smooth { .. } | PackKind::Surface { .. } => return None,
    };
    Some(Corners(traverse::corners(grid, span, local).map(|value| f64::from(value) + iso)))
}

/// A cell relative to the grid's base.
fn local_cell(grid: &PackedGrid, ijk: [i64; 3]) -> Option<IVec3> {
    let base = grid.base.to_array().map(i64::from);
    let local: [i64; 3] = std::array::from_fn(|axis| ijk[axis].saturating_sub(base[axis]));
    match local.map(i32::try_from) {
        [Ok(x), Ok(y), Ok(z)] => Some(IVec3::new(x, y, z)),
        _ => None,
    }
}

/// Reads samples of a tree, caching the last leaf.
#[derive(Debug)]
pub(super) struct TreeSamples<'a> {
    accessor: Accessor<'a, Upper>,
    background: f32,
    kind: PackKind,
}

impl<'a> TreeSamples<'a> {
    fn new(tree: &'a Vdb543<f32>, kind: PackKind) -> Self {
        Self { accessor: tree.accessor(), background: tree.background(), kind }
    }

    fn sound(&self, value: f32) -> f32 {
        match self.kind {
            PackKind::Fog => density(value),
            PackKind::Surface { iso } | PackKind::Smooth { iso } => distance(value, iso),
        }
    }

    fn value(&mut self, ijk: [i64; 3]) -> f32 {
        let value = match ijk.map(i32::try_from) {
            [Ok(x), Ok(y), Ok(z)] => self.accessor.get(IVec3::new(x, y, z)),
            _ => self.background,
        };
        self.sound(value)
    }

    fn corners(&mut self, ijk: [i64; 3]) -> Corners {
        // One bit for each axis along which the cell reaches into the next leaf, in the order of the
        // bits of corner numbers.
        let across = [0, 1, 2].map(|axis| usize::from(ijk[axis] & 7 == 7) << (2 - axis));
        let across = across[0] | across[1] | across[2];
        if across == 0
            && let [Ok(x), Ok(y), Ok(z)] = ijk.map(i32::try_from)
        {
            // The common case: all samples are in one leaf or one tile.
            let cell = IVec3::new(x, y, z);
            return Corners(match self.accessor.find(cell) {
                Found::Leaf(leaf) => {
                    let (values, slot) = (leaf.values_slice(), Leaf::slot(cell));
                    CORNERS.map(|[x, y, z]| self.sound(values[slot + 64 * x + 8 * y + z]).into())
                }
                Found::Tile(tile) => [self.sound(tile.value).into(); 8],
            });
        }
        let mut values = [0.0; 8];
        // Leaf by leaf, so that each is looked up once.
        for leaf in (0..8).filter(|leaf| leaf & !across == 0) {
            for corner in (0..8).filter(|corner| corner & across == leaf) {
                let [x, y, z] = CORNERS[corner].map(|c| c as i64);
                // The index space ends long before i64 does.
                let at =
                    [ijk[0].saturating_add(x), ijk[1].saturating_add(y), ijk[2].saturating_add(z)];
                values[corner] = self.value(at).into();
            }
        }
        Corners(values)
    }
}

const CORNERS: [[usize; 3]; 8] =
    [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]];

/// The samples at the corners of a trilinear cell, `x·4 + y·2 + z`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners([f64; 8]);

fn mix(a: f64, b: f64, u: f64) -> f64 {
    a + (b - a) * u
}

impl Corners {
    /// The interpolant at a position in the cell, from 0 to 1 on each axis.
    #[inline]
    pub fn at(&self, u: DVec3) -> f64 {
        let c = &self.0;
        let z = |i: usize| mix(c[i], c[i + 1], u.z);
        let y = |i: usize| mix(z(i), z(i + 2), u.y);
        mix(y(0), y(4), u.x)
    }

    /// The gradient of the interpolant at a position in the cell, per voxel.
    pub fn gradient(&self, u: DVec3) -> DVec3 {
        let c = &self.0;
        let along = |step: usize, a: (usize, f64), b: (usize, f64)| {
            let slope = |i: usize| c[i + step] - c[i];
            let near = mix(slope(0), slope(a.0), a.1);
            let far = mix(slope(b.0), slope(a.0 + b.0), a.1);
            mix(near, far, b.1)
        };
        let (x, y, z) = ((4, u.x), (2, u.y), (1, u.z));
        DVec3::new(along(4, y, z), along(2, x, z), along(1, x, y))
    }
}
