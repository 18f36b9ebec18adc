//! Where boxes of texels are in a texture.

use std::cmp::Reverse;

use bevy::math::UVec3;

/// Boxes of texels in a texture that grows. Their coordinates along x are even.
#[derive(Clone, Debug)]
pub(super) struct Packing {
    size: UVec3,
    max_edge: u32,
    max_texels: u64,
    /// Disjoint.
    gaps: Vec<TexelBox>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TexelBox {
    pub origin: UVec3,
    pub size: UVec3,
}

impl Packing {
    /// An empty texture with bounds of its size.
    pub fn new(max_edge: u32, max_texels: u64) -> Self {
        Self { size: UVec3::ZERO, max_edge, max_texels, gaps: Vec::new() }
    }

    /// The size of the texture.
    pub fn size(&self) -> UVec3 {
        self.size
    }

    pub fn texels(&self) -> u64 {
        texels(self.size)
    }

    /// Finds room for a box in the smallest gap that has it.
    pub fn place(&mut self, size: UVec3) -> Option<UVec3> {
        let size = padded(size)?;
        let fits = |gap: &&TexelBox| gap.size.cmpge(size).all();
        let gap = *self.gaps.iter().filter(fits).min_by_key(|gap| texels(gap.size))?;
        self.gaps.retain(|other| *other != gap);
        // Cut across the axis with the largest rest first, so that one of the new gaps is as large as possible.
        let rest = gap.size - size;
        let mut axes = [0, 1, 2];
        axes.sort_unstable_by_key(|axis| Reverse(rest[*axis]));
        let mut left = gap;
        for axis in axes {
            let mut cut = left;
            cut.origin[axis] += size[axis];
            cut.size[axis] = rest[axis];
            left.size[axis] = size[axis];
            if rest[axis] > 0 {
                self.gaps.push(cut);
            }
        }
        Some(gap.origin)
    }

    /// Like [`Packing::place`], in a texture that grows if it has to; `None` if it would be too large.
    pub fn place_or_grow(&mut self, size: UVec3) -> Option<UVec3> {
        if let Some(origin) = self.place(size) {
            return Some(origin);
        }
        let size = padded(size)?;
        // Along the axis that adds the fewest texels.
        let grown = |axis: usize| {
            let mut grown = self.size.max(size);
            grown[axis] = self.size[axis] + size[axis];
            self.may_be(grown).then_some((axis, grown))
        };
        let (axis, grown) = (0..3).filter_map(grown).min_by_key(|(_, size)| texels(*size))?;
        // That axis comes last, so that the new gap there is at least as large as the box.
        let mut across = grown;
        across[axis] = self.size[axis];
        self.grow(across);
        self.grow(grown);
        self.place(size)
    }

    fn may_be(&self, size: UVec3) -> bool {
        size.max_element() <= self.max_edge && texels(size) <= self.max_texels
    }

    /// Grows the texture along its longest edge by a part of it, if it may.
    pub fn add_room(&mut self, divisor: u32) {
        let mut grown = self.size;
        let axis = grown.max_position();
        grown[axis] += (grown[axis] / divisor).next_multiple_of(2);
        if self.may_be(grown) {
            self.grow(grown);
        }
    }

    fn grow(&mut self, grown: UVec3) {
        for axis in 0..3 {
            let mut origin = UVec3::ZERO;
            let mut size = self.size;
            origin[axis] = self.size[axis];
            size[axis] = grown[axis] - self.size[axis];
            self.size[axis] = grown[axis];
            self.free(TexelBox { origin, size });
        }
    }

    /// Returns the room of a box that [`Packing::place`] has found.
    pub fn free(&mut self, own: TexelBox) {
        let Some(size) = padded(own.size) else { return };
        if texels(size) == 0 {
            return;
        }
        let mut own = TexelBox { size, ..own };
        let neighbour = |own: &TexelBox, gaps: &[TexelBox]| {
            (0..gaps.len()).find_map(|i| Some((i, own.joined(&gaps[i])?)))
        };
        while let Some((i, joined)) = neighbour(&own, &self.gaps) {
            self.gaps.swap_remove(i);
            own = joined;
        }
        self.gaps.push(own);
    }
}

impl TexelBox {
    /// The union with another box, if that is a box.
    fn joined(&self, other: &Self) -> Option<Self> {
        let axis = (0..3).find(|axis| {
            (0..3).all(|i| {
                i == *axis || (self.origin[i], self.size[i]) == (other.origin[i], other.size[i])
            })
        })?;
        let (low, high) =
            if self.origin[axis] < other.origin[axis] { (self, other) } else { (other, self) };
        if low.origin[axis] + low.size[axis] != high.origin[axis] {
            return None;
        }
        let mut joined = *low;
        joined.size[axis] += high.size[axis];
        Some(joined)
    }
}

fn texels(size: UVec3) -> u64 {
    // Edges of textures are far less than 2^21.
    size.to_array().into_iter().map(u64::from).product()
}

/// The room that a box takes; `None` if it is empty or too large for any texture.
fn padded(size: UVec3) -> Option<UVec3> {
    let padded = UVec3 { x: size.x.checked_next_multiple_of(2)?, ..size };
    (padded.max_element() < 1 << 16).then_some(padded)
}

#[cfg(test)]
mod tests {
    use vdb_core::synth::Random;

    use super::*;

    fn are_apart(a: TexelBox, b: TexelBox) -> bool {
        let [a_end, b_end] = [a, b].map(|own| own.origin + own.size);
        a_end.cmple(b.origin).any() || b_end.cmple(a.origin).any()
    }

    #[test]
    fn boxes_are_apart_and_in_the_texture() {
        let mut random = Random::new(1);
        let mut packing = Packing::new(300, 4_000_000);
        let mut used: Vec<TexelBox> = Vec::new();
        let (mut placed, mut refused) = (0, 0);
        for _ in 0..3_000 {
            if random.below(5) < 3 {
                let size = UVec3::from([0; 3].map(|_| 1 + random.below(90) as u32));
                let Some(origin) = packing.place_or_grow(size) else {
                    refused += 1;
                    continue;
                };
                let new = TexelBox { origin, size };
                assert!(used.iter().all(|old| are_apart(*old, new)), "{new:?} {used:?}");
                assert!((origin + size).cmple(packing.size()).all(), "{new:?} {packing:?}");
                assert_eq!(origin.x % 2, 0);
                used.push(new);
                placed += 1;
            } else if !used.is_empty() {
                packing.free(used.swap_remove(random.below(used.len() as u64) as usize));
            }
            assert!(packing.size().max_element() <= 300 && packing.texels() <= 4_000_000);
        }
        assert!(placed > 500 && refused > 50, "{placed} {refused}");
        // Neither gaps nor boxes overlap, and together they are the texture.
        let padded = used.iter().map(|own| TexelBox { size: padded(own.size).unwrap(), ..*own });
        let all: Vec<_> = padded.chain(packing.gaps.iter().copied()).collect();
        for (i, own) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|other| are_apart(*own, *other)));
        }
        assert_eq!(all.iter().map(|own| texels(own.size)).sum::<u64>(), packing.texels());
    }

    #[test]
    fn equal_boxes_waste_little() {
        let size = UVec3::new(66, 65, 65);
        let mut packing = Packing::new(2048, u64::MAX);
        let mut origins: Vec<_> = (0..30).map(|_| packing.place_or_grow(size).unwrap()).collect();
        assert_eq!(packing.texels(), 30 * texels(size));
        origins.extend((30..100).map(|_| packing.place_or_grow(size).unwrap()));
        assert!(packing.texels() * 4 <= 5 * 100 * texels(size), "{:?}", packing.size());
        origins.iter().for_each(|origin| packing.free(TexelBox { origin: *origin, size }));
        for _ in origins {
            assert!(packing.place(size).is_some(), "{packing:?}");
        }
    }

    #[test]
    fn a_small_box_beside_a_large_one_adds_little() {
        let mut packing = Packing::new(2048, u64::MAX);
        packing.place_or_grow(UVec3::splat(130)).unwrap();
        packing.place_or_grow(UVec3::splat(10)).unwrap();
        assert_eq!(packing.size(), UVec3::new(140, 130, 130));
    }

    #[test]
    fn boxes_that_do_not_fit_are_refused() {
        let mut packing = Packing::new(100, 500_000);
        assert_eq!(packing.place_or_grow(UVec3::new(101, 1, 1)), None);
        assert_eq!(packing.place_or_grow(UVec3::splat(100)), None);
        assert_eq!(packing.place_or_grow(UVec3::splat(u32::MAX)), None);
        assert_eq!(packing.size(), UVec3::ZERO);
        assert!(packing.place_or_grow(UVec3::new(100, 100, 50)).is_some());
        assert_eq!(packing.place_or_grow(UVec3::ONE), None);
        packing.add_room(4);
        assert_eq!(packing.size(), UVec3::new(100, 100, 50));
    }
}
