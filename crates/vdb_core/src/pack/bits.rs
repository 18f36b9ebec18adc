//! Sets of bits: leaves of 512 voxels in eight planes of 64, and matrices of 8 × 8.

use glam::IVec3;

use super::layout::{LEAF_MASK_WORDS, LEAF_VALUES};
use crate::tree::{CoordBox, LeafNode};

/// One bit per voxel: a plane for each x, with voxel (y, z) at bit `y·8 + z`.
pub(super) type Planes = [u64; 8];

/// Gathers the lowest bits of eight bytes in the highest byte of a product.
const GATHER: u64 = 0x0102_0408_1020_4080;

/// Transposes a matrix of 8 × 8 bits with one row per byte (H. S. Warren, "Hacker's
/// Delight", second edition, 7–3). It is its own inverse.
pub(crate) const fn transposed(rows: u64) -> u64 {
    let swap = (rows ^ (rows >> 7)) & 0x00aa_00aa_00aa_00aa;
    let rows = rows ^ swap ^ (swap << 7);
    let swap = (rows ^ (rows >> 14)) & 0x0000_cccc_0000_cccc;
    let rows = rows ^ swap ^ (swap << 14);
    let swap = (rows ^ (rows >> 28)) & 0x0000_0000_f0f0_f0f0;
    rows ^ swap ^ (swap << 28)
}

/// The voxels of a leaf that satisfy a predicate.
pub(super) fn planes(leaf: &LeafNode<f32, 3>, holds: impl Fn(f32) -> bool) -> Planes {
    let mut planes = [0; 8];
    for (plane, values) in planes.iter_mut().zip(leaf.values_slice().chunks_exact(64)) {
        // First a byte for each, in a loop over vectors.
        let mut bytes = [0_u8; 64];
        for (byte, &value) in bytes.iter_mut().zip(values) {
            *byte = holds(value).into();
        }
        for (y, row) in bytes.as_chunks().0.iter().enumerate() {
            *plane |= (u64::from_le_bytes(*row).wrapping_mul(GATHER) >> 56) << (8 * y);
        }
    }
    planes
}

/// The same bits in the order of a leaf's mask on the GPU: eight blocks of 4³.
pub(super) fn mask(planes: &Planes) -> [u32; LEAF_MASK_WORDS] {
    let mut blocks = [0_u64; 8];
    for (x, plane) in planes.iter().enumerate() {
        for y in 0..8 {
            let row = plane >> (8 * y) & 0xff;
            let block = (x >> 2) << 2 | (y >> 2) << 1;
            let shift = (x & 3) << 4 | (y & 3) << 2;
            blocks[block] |= (row & 0xf) << shift;
            blocks[block + 1] |= (row >> 4) << shift;
        }
    }
    std::array::from_fn(|i| (blocks[i / 2] >> (32 * (i & 1))) as u32)
}

/// The box around the set bits of a mask; `origin` is the origin of the leaf.
pub(super) fn mask_box(mask: &[u32], origin: IVec3) -> Option<CoordBox> {
    // For each axis, the coordinates from 0 to 7 at which any bit is set.
    let (mut xs, mut ys, mut zs) = (0_u32, 0_u32, 0_u32);
    for (i, pair) in mask.chunks_exact(2).enumerate().take(LEAF_VALUES / 64) {
        let bits = u64::from(pair[0]) | u64::from(pair[1]) << 32;
        let (x, y, z) = ((i >> 2) * 4, (i >> 1 & 1) * 4, (i & 1) * 4);
        let all_x = bits | bits >> 32;
        let all_x = (all_x | all_x >> 16) & 0xffff;
        let all_xy = all_x | all_x >> 8;
        let all_xy = (all_xy | all_xy >> 4) & 0xf;
        zs |= (all_xy as u32) << z;
        for n in 0..4 {
            xs |= u32::from(bits >> (16 * n) & 0xffff != 0) << (x + n);
            ys |= u32::from(all_x >> (4 * n) & 0xf != 0) << (y + n);
        }
    }
    let ends = |bits: u32| (bits.trailing_zeros() as i32, 31 - bits.leading_zeros() as i32);
    (xs != 0).then(|| {
        let ((x0, x1), (y0, y1), (z0, z1)) = (ends(xs), ends(ys), ends(zs));
        CoordBox { min: origin + IVec3::new(x0, y0, z0), max: origin + IVec3::new(x1, y1, z1) }
    })
}

#[cfg(test)]
mod tests {
    use super::super::layout::mask_bit;
    use super::*;
    use crate::synth::Random;
    use crate::tree::Node;

    #[test]
    fn bits_are_where_the_layout_says() {
        let mut random = Random::new(1);
        for round in 0..200 {
            let mut leaf = LeafNode::<f32, 3>::filled(IVec3::splat(80), 0.0, false);
            for value in leaf.values_slice_mut() {
                *value = f32::from(random.below(1 + round) == 0);
            }
            let mask = mask(&planes(&leaf, |value| value > 0.5));
            let mut expected: Option<CoordBox> = None;
            for slot in 0..LEAF_VALUES {
                let at = LeafNode::<f32, 3>::slot_offset(slot);
                let on = leaf.values_slice()[slot] > 0.5;
                let (word, bit) = mask_bit(at);
                assert_eq!(mask[word] >> bit & 1 == 1, on, "{at}");
                if on {
                    let here = CoordBox::voxel(leaf.origin() + at);
                    expected = Some(expected.map_or(here, |bbox| bbox.union(here)));
                }
            }
            assert_eq!(mask_box(&mask, leaf.origin()), expected);
        }
    }
}
