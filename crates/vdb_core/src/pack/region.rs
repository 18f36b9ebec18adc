//! The cells of a grid to pack.

use glam::IVec3;

use super::bits;
use super::kind::PackKind;
use super::layout::{LEAF_BITS, LEAF_MASK_WORDS, mask_bit};
use crate::tree::CoordBox;

/// The cells of a grid to pack.
#[derive(Clone, Copy, Debug)]
pub(super) struct Region {
    /// The cells that rays can meet.
    cells: CoordBox,
    /// These cells and those that are packed with them.
    packed: CoordBox,
}

impl Region {
    /// Everywhere.
    pub const ALL: Self = Self {
        cells: CoordBox { min: IVec3::MIN, max: IVec3::MAX },
        packed: CoordBox { min: IVec3::MIN, max: IVec3::MAX },
    };

    /// The region of a grid in which rays can meet only these cells.
    pub fn new(kind: PackKind, cells: Option<CoordBox>) -> Self {
        let Some(cells) = cells else { return Self::ALL };
        let packed = match kind {
            PackKind::Smooth { .. } => CoordBox {
                min: cells.min.saturating_sub(IVec3::ONE),
                max: cells.max.saturating_add(IVec3::ONE),
            },
            PackKind::Surface { .. } | PackKind::Fog => cells,
        };
        Self { cells, packed }
    }

    /// Whether any cell of a cube is packed.
    pub fn touches(&self, cube: CoordBox) -> bool {
        self.packed.intersection(cube).is_some()
    }

    /// The part of a box that rays can meet.
    pub fn met(&self, cells: Option<CoordBox>) -> Option<CoordBox> {
        cells.and_then(|cells| cells.intersection(self.cells))
    }

    /// The cells of a leaf's mask that are packed; `None` if none are.
    pub fn packed_mask(
        &self,
        mask: [u32; LEAF_MASK_WORDS],
        origin: IVec3,
    ) -> Option<[u32; LEAF_MASK_WORDS]> {
        let within = within(mask, origin, self.packed);
        within.iter().any(|word| *word != 0).then_some(within)
    }

    /// The box around the cells of a leaf's mask that rays can meet.
    pub fn mask_box(&self, mask: &[u32; LEAF_MASK_WORDS], origin: IVec3) -> Option<CoordBox> {
        bits::mask_box(&within(*mask, origin, self.cells), origin)
    }
}

/// The cells of a leaf's mask in a box.
fn within(
    mut mask: [u32; LEAF_MASK_WORDS],
    origin: IVec3,
    bounds: CoordBox,
) -> [u32; LEAF_MASK_WORDS] {
    let cube = CoordBox::cube(origin, LEAF_BITS);
    if bounds.intersection(cube) == Some(cube) {
        return mask;
    }
    let cells = (0..512).map(|i| IVec3::new(i >> 6, i >> 3 & 7, i & 7));
    for cell in cells.filter(|cell| !bounds.contains(origin + *cell)) {
        let (word, bit) = mask_bit(cell);
        mask[word] &= !(1 << bit);
    }
    mask
}
