//! The places of pages in a tree.

use std::collections::BTreeSet;

use glam::IVec3;

use crate::Error;
use crate::pack::PackKind;
use crate::tree::{CoordBox, InternalNode, LeafNode, Node, Slot};

pub(super) type Lower = InternalNode<LeafNode<f32, 3>, 4>;
pub(super) type Upper = InternalNode<Lower, 5>;

/// The most pages of one level.
const MOST_PAGES: usize = 1 << 22;

/// The places of the pages that may have something to show, found node by node.
#[derive(Clone)]
pub(super) struct Places {
    edge: u32,
    iso: f32,
    is_smooth: bool,
    at: BTreeSet<[i32; 3]>,
}

impl Places {
    /// No places yet, of pages with `edge` cells per edge.
    pub fn new(edge: u32, kind: PackKind, iso: f32) -> Self {
        let is_smooth = matches!(kind, PackKind::Smooth { .. });
        Self { edge, iso, is_smooth, at: BTreeSet::new() }
    }

    /// The places, in order.
    pub fn into_vec(self) -> Vec<IVec3> {
        self.at.into_iter().map(IVec3::from_array).collect()
    }

    /// Adds the places that have been found in other nodes.
    pub fn merge(mut self, mut other: Self) -> Result<Self, Error> {
        self.at.append(&mut other.at);
        self.check()?;
        Ok(self)
    }

    /// Adds the pages of a tile of the root.
    pub fn add_root_tile(&mut self, origin: IVec3, value: f32) -> Result<(), Error> {
        if self.is_solid(value) {
            self.add_tile(CoordBox::cube(origin, Upper::TOTAL_LOG2_DIM))?;
        }
        Ok(())
    }

    /// Adds the pages of a child of the root.
    pub fn add_upper(&mut self, upper: &Upper) -> Result<(), Error> {
        for slot in 0..Upper::SIZE {
            match upper.slot_at(slot) {
                Slot::Child(lower) => self.add_lower(lower)?,
                Slot::Tile(value, _) if self.is_solid(value) => {
                    let origin = upper.origin() + Upper::slot_offset(slot);
                    self.add_tile(CoordBox::cube(origin, Lower::TOTAL_LOG2_DIM))?;
                }
                Slot::Tile(..) => {}
            }
        }
        Ok(())
    }

    fn is_solid(&self, value: f32) -> bool {
        value < self.iso
    }

    fn check(&self) -> Result<(), Error> {
        if self.at.len() > MOST_PAGES {
            let what = format!("more than {MOST_PAGES} pages of one level");
            return Err(Error::not_supported(what));
        }
        Ok(())
    }

    /// Adds the pages with cells that solid samples of a node are corners of.
    pub fn add_lower(&mut self, lower: &Lower) -> Result<(), Error> {
        for slot in 0..Lower::SIZE {
            let is_solid = match lower.slot_at(slot) {
                Slot::Child(leaf) => leaf.values_slice().iter().any(|value| self.is_solid(*value)),
                Slot::Tile(value, _) => self.is_solid(value),
            };
            if is_solid {
                self.add(CoordBox::cube(lower.origin() + Lower::slot_offset(slot), 3))?;
            }
        }
        Ok(())
    }

    /// Adds the pages with cells that have these samples.
    fn add(&mut self, samples: CoordBox) -> Result<(), Error> {
        let edge = self.edge as i32;
        // Trilinear cells begin one sample before.
        let before = i32::from(self.is_smooth);
        let min = samples.min.to_array().map(|c| c.saturating_sub(before).div_euclid(edge));
        let max = samples.max.to_array().map(|c| c.div_euclid(edge));
        for x in min[0]..=max[0] {
            for y in min[1]..=max[1] {
                self.at.extend((min[2]..=max[2]).map(|z| [x, y, z]));
                self.check()?;
            }
        }
        Ok(())
    }

    /// Adds the pages of a solid tile: all of them for voxels, and those along its faces for a
    /// smooth surface.
    fn add_tile(&mut self, tile: CoordBox) -> Result<(), Error> {
        if !self.is_smooth {
            return self.add(tile);
        }
        for axis in 0..3 {
            let (mut low, mut high) = (tile, tile);
            low.max[axis] = tile.min[axis];
            high.min[axis] = tile.max[axis];
            self.add(low)?;
            self.add(high)?;
        }
        Ok(())
    }
}
