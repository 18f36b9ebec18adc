//! Voxel edits.

use glam::IVec3;
use rayon::prelude::*;

use super::slots::Cubes;
use crate::pack::layout::LEAF_BITS;
use crate::tree::{CoordBox, Found, LeafNode, Node, Value, ValueAt, Vdb543};

type Leaf = LeafNode<f32, 3>;

/// A value and its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Voxel {
    /// The value, in the units of the grid.
    pub value: f32,
    /// Whether the voxel is active: in the narrow band of a level set, or part of a fog. Rendering
    /// depends on values only.
    pub active: bool,
}

impl Voxel {
    fn same(self, other: Self) -> bool {
        self.value.same(other.value) && self.active == other.active
    }
}

/// Edits the voxels of a grid. All coordinates are in index space.
///
/// Reads see earlier writes immediately.
///
/// Setting a voxel takes a look-up and, in a tile, the creation of one node of each size down to a
/// leaf: at most 150 KB and a few microseconds, however large the tile is. The cost of boxes is
/// documented with their methods; it is bounded by the size of the box only.
#[derive(Debug)]
pub struct VoxelEdit<'a> {
    pub(super) tree: &'a mut Vdb543<f32>,
    pub(super) changed: &'a mut Cubes,
}

impl VoxelEdit<'_> {
    /// The value of a voxel.
    pub fn get(&self, ijk: IVec3) -> f32 {
        self.tree.get(ijk)
    }

    /// The value of a voxel, and whether it is active.
    pub fn voxel(&self, ijk: IVec3) -> Voxel {
        let (value, active) = self.tree.probe(ijk);
        Voxel { value, active }
    }

    /// The tree as it is now.
    pub fn tree(&self) -> &Vdb543<f32> {
        self.tree
    }

    /// Sets a voxel and makes it active.
    pub fn set(&mut self, ijk: IVec3, value: f32) {
        self.set_voxel(ijk, Voxel { value, active: true });
    }

    /// Sets a voxel and makes it inactive.
    pub fn set_inactive(&mut self, ijk: IVec3, value: f32) {
        self.set_voxel(ijk, Voxel { value, active: false });
    }

    /// Sets a voxel and its state.
    pub fn set_voxel(&mut self, ijk: IVec3, voxel: Voxel) {
        if self.voxel(ijk).same(voxel) {
            return;
        }
        let (leaf, slot) = (self.tree.touch_leaf(ijk), Leaf::slot(ijk));
        leaf.values_slice_mut()[slot] = voxel.value;
        leaf.value_mask_mut().set(slot, voxel.active);
        self.changed.insert(ijk >> LEAF_BITS as i32);
    }

    /// Sets all voxels of a box to one value and state. Cubes of 8³ that lie in the box become
    /// tiles, so the time is proportional to the number of such cubes.
    pub fn fill(&mut self, bbox: CoordBox, voxel: Voxel) {
        for cube in cubes(bbox) {
            let origin = cube << LEAF_BITS as i32;
            let whole = CoordBox::cube(origin, LEAF_BITS);
            if bbox.intersection(whole) == Some(whole) {
                let there = self.tree.find(origin);
                let same = |tile: ValueAt<f32>| {
                    voxel.same(Voxel { value: tile.value, active: tile.active })
                };
                if !matches!(there, Found::Tile(tile) if same(tile)) {
                    self.tree.fill_leaf(origin, voxel.value, voxel.active);
                    self.changed.insert(cube);
                }
            } else if let Some(leaf) = updated(self.tree, bbox, cube, &|_, _| voxel) {
                self.replace(cube, leaf);
            }
        }
    }

    /// Replaces the value and state of each voxel of a box by a function of its position, value and
    /// state. The function is called from several threads, once for each voxel of the box; voxels
    /// that it does not change cost nothing further. Leaves that become uniform become tiles. The
    /// time is proportional to the number of voxels in the box.
    pub fn update(&mut self, bbox: CoordBox, f: impl Fn(IVec3, Voxel) -> Voxel + Sync) {
        let cubes: Vec<IVec3> = cubes(bbox).collect();
        let tree = &*self.tree;
        let updated: Vec<(IVec3, Box<Leaf>)> = cubes
            .into_par_iter()
            .filter_map(|cube| Some((cube, updated(tree, bbox, cube, &f)?)))
            .collect();
        for (cube, leaf) in updated {
            self.replace(cube, leaf);
        }
    }

    fn replace(&mut self, cube: IVec3, leaf: Box<Leaf>) {
        let origin = leaf.origin();
        match leaf.uniform() {
            Some((value, active)) => self.tree.fill_leaf(origin, value, active),
            None => *self.tree.touch_leaf(origin) = *leaf,
        }
        self.changed.insert(cube);
    }
}

/// The leaf-sized cubes that a box touches, identified by their lowest voxel divided by 8.
fn cubes(bbox: CoordBox) -> impl Iterator<Item = IVec3> {
    let (low, high) = (bbox.min >> LEAF_BITS as i32, bbox.max >> LEAF_BITS as i32);
    (low.x..=high.x).flat_map(move |x| {
        (low.y..=high.y).flat_map(move |y| (low.z..=high.z).map(move |z| IVec3::new(x, y, z)))
    })
}

/// The leaf that results from applying a function to a cube, if anything changes.
fn updated(
    tree: &Vdb543<f32>,
    bbox: CoordBox,
    cube: IVec3,
    f: &impl Fn(IVec3, Voxel) -> Voxel,
) -> Option<Box<Leaf>> {
    let origin = cube << LEAF_BITS as i32;
    let both = bbox.intersection(CoordBox::cube(origin, LEAF_BITS))?;
    let there = tree.find(origin);
    let mut leaf: Option<Box<Leaf>> = None;
    for x in both.min.x..=both.max.x {
        for y in both.min.y..=both.max.y {
            for z in both.min.z..=both.max.z {
                let ijk = IVec3::new(x, y, z);
                let slot = Leaf::slot(ijk);
                let old = match &there {
                    Found::Leaf(leaf) => Voxel {
                        value: leaf.values_slice()[slot],
                        active: leaf.value_mask().is_on(slot),
                    },
                    Found::Tile(tile) => Voxel { value: tile.value, active: tile.active },
                };
                let new = f(ijk, old);
                if !new.same(old) {
                    let leaf = leaf.get_or_insert_with(|| match there {
                        Found::Leaf(leaf) => Box::new(leaf.clone()),
                        Found::Tile(tile) => Leaf::filled(origin, tile.value, tile.active),
                    });
                    leaf.values_slice_mut()[slot] = new.value;
                    leaf.value_mask_mut().set(slot, new.active);
                }
            }
        }
    }
    leaf
}
