//! What is inside a box.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::ToolError;
use super::build::{Formula, build};
use super::grid::{floats, replaced, with_any_tree};
use super::nodes::{Leaf, State};
use super::samples::tile_at;
use crate::grid::with_tree;
use crate::tree::grow::{Built, built, internal};
use crate::tree::{
    CoordBox, Cube, Dim, Found, IVec3, InternalNode, Node, RootEntry, Slot, Tree, Value, Vdb543,
};
use crate::work::{Stop, Work, debug_options};
use crate::{AnyTree, Grid, GridClass, Limits, ProgressFn};

type Lower<L> = InternalNode<L, 4>;
type Upper<L> = InternalNode<Lower<L>, 5>;

/// Options of [`crop`].
#[derive(Clone)]
pub struct Crop {
    /// The lower corner of the box in world space. May be infinite.
    pub low: DVec3,
    /// The upper corner.
    pub high: DVec3,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl Crop {
    /// To a box in world space, with default limits.
    pub fn new(low: DVec3, high: DVec3) -> Self {
        Self { low, high, limits: Limits::default(), progress: None }
    }

    /// The corners of the box, which must have an inside.
    pub(super) fn corners(&self) -> Result<[DVec3; 2], ToolError> {
        let Self { low, high, .. } = *self;
        match low.cmplt(high).all() {
            true => Ok([low, high]),
            false => Err(ToolError::BadBox { low: low.to_array(), high: high.to_array() }),
        }
    }
}

debug_options!(Crop { low, high, limits });

/// Keeps what is inside a box in world space.
///
/// Of a level set, it makes the solid that is in the box, too: its surface is cut straight, wherever
/// voxels are, and distances near the new edges are bounds, as after [`csg`](fn@super::csg). Of all
/// other grids, it keeps the voxels whose centres are in the box, and the rest becomes inactive
/// background. Grids may be of any type.
///
/// # Errors
/// If the box has no inside, the transform is not linear, a level set is not of floats, the result
/// would exceed the limits, or it was cancelled.
pub fn crop(grid: &Grid, options: &Crop) -> Result<Grid, ToolError> {
    let [low, high] = options.corners()?;
    let world_from_index = grid.transform.linear().ok_or(ToolError::NotLinear)?;
    let bounds = Bounds { low, high, world_from_index };
    let voxels = grid.tree.active_voxel_count() as f64;
    let stopped = |stop| ToolError::stopped(stop, voxels);
    if grid.class == GridClass::LevelSet {
        let tree = floats(grid)?;
        let background = tree.background();
        let uppers = tree.entries().map(|(origin, _)| origin.to_array()).collect();
        let formula = Cut { tree, bounds, background };
        let made = build(background, uppers, &formula, &options.limits, options.progress.as_ref());
        return Ok(replaced(grid, made.map_err(stopped)?));
    }
    let steps = with_tree!(&grid.tree, tree => tree.entries().len()) * Upper::<Leaf>::SIZE;
    let work = Work::new(options.progress.as_ref(), steps as u64, options.limits.tree_bytes);
    let cropping = Cropping { area: bounds, work: &work, done: AtomicU64::new(0) };
    macro_rules! cropped {
        ($($kind:ident),*) => {
            match &grid.tree {
                $(AnyTree::$kind(tree) => {
                    let cropped = cropping.tree(tree, tree.entries()).map_err(stopped)?;
                    AnyTree::$kind(cropped.into())
                })*
            }
        };
    }
    let tree = cropped!(Float, Double, Int32, Int64, Bool, Mask, Vec3s, Vec3d, Vec3i);
    work.finish().map_err(stopped)?;
    Ok(with_any_tree(grid, tree))
}

/// The voxels of a tree in a box of index space, and the inactive background outside. The time is
/// proportional to what the box touches.
pub(crate) fn voxels_within(tree: &Vdb543<f32>, bounds: CoordBox) -> Vdb543<f32> {
    let work = Work::new(None, 0, u64::MAX);
    let cropping = Cropping { area: bounds, work: &work, done: AtomicU64::new(0) };
    let entries = tree.entries_between(bounds.min.x, bounds.max.x);
    // Nothing stops work without a callback and a limit.
    cropping.tree(tree, entries).unwrap_or_else(|_| Tree::new(tree.background()))
}

/// Voxels that a tree is cropped to.
trait Area: Sync {
    fn contains(&self, ijk: IVec3) -> bool;

    fn part(&self, cube: CoordBox) -> Part;
}

/// A box in world space, and where voxels are.
struct Bounds {
    low: DVec3,
    high: DVec3,
    world_from_index: DAffine3,
}

/// Which voxels of a cube are in an area.
enum Part {
    All,
    None,
    Some,
}

impl Area for Bounds {
    fn contains(&self, ijk: IVec3) -> bool {
        let p = self.world_from_index.transform_point3(ijk.as_dvec3());
        self.low.cmple(p).all() && p.cmple(self.high).all()
    }

    fn part(&self, cube: CoordBox) -> Part {
        let [min, max] = [cube.min, cube.max].map(|corner| corner.as_dvec3());
        let center = self.world_from_index.transform_point3((min + max) / 2.0);
        let matrix = self.world_from_index.matrix3;
        let half = (max - min) / 2.0;
        let axes = [0, 1, 2].map(|axis| matrix.col(axis).abs() * half[axis]);
        let reach = axes[0] + axes[1] + axes[2];
        // Far more than rounding; voxels in between are looked at one by one.
        let slack = (center.abs() + reach) * 1e-12;
        let [low, high] = [center - reach - slack, center + reach + slack];
        match () {
            () if low.cmpge(self.low).all() && high.cmple(self.high).all() => Part::All,
            () if high.cmplt(self.low).any() || low.cmpgt(self.high).any() => Part::None,
            () => Part::Some,
        }
    }
}

impl Area for CoordBox {
    fn contains(&self, ijk: IVec3) -> bool {
        CoordBox::contains(self, ijk)
    }

    fn part(&self, cube: CoordBox) -> Part {
        match self.intersection(cube) {
            None => Part::None,
            Some(inside) if inside == cube => Part::All,
            Some(_) => Part::Some,
        }
    }
}

impl Bounds {
    /// The distance to the box in world units, negative inside.
    fn distance(&self, p: DVec3) -> f64 {
        let outside = (self.low - p).max(p - self.high);
        outside.max(DVec3::ZERO).length() + outside.max_element().min(0.0)
    }
}

/// The intersection of a level set with a box.
struct Cut<'a> {
    tree: &'a Vdb543<f32>,
    bounds: Bounds,
    background: f32,
}

impl Cut<'_> {
    fn cut(&self, value: f32, active: bool, distance: f64) -> State {
        let distance = distance as f32;
        if distance <= value {
            return (value, active);
        }
        let is_near = distance.abs() < self.background;
        (distance.clamp(-self.background.abs(), self.background.abs()), is_near)
    }
}

impl Formula for Cut<'_> {
    type Scratch = ();

    fn tile(&self, origin: IVec3, log2_dim: u32) -> Option<State> {
        let one = tile_at(self.tree, origin, log2_dim);
        let far = self.background;
        if one == Some((far, false)) {
            return one;
        }
        let half = f64::from((1_u32 << log2_dim) - 1) / 2.0;
        let place = &self.bounds.world_from_index;
        let center = place.transform_point3(origin.as_dvec3() + half);
        // The distance changes by no more than the way.
        let axes = [0, 1, 2].map(|axis| place.matrix3.col(axis).abs() * half);
        let reach = (axes[0] + axes[1] + axes[2]).length() * (1.0 + 1e-12);
        let distance = self.bounds.distance(center);
        match () {
            () if distance - reach >= f64::from(far) => Some((far, false)),
            () if distance + reach <= -f64::from(far) => one,
            () => None,
        }
    }

    fn fill(&self, leaf: &mut Leaf, (): &mut ()) {
        let found = self.tree.find(leaf.origin());
        for slot in 0..Leaf::SIZE {
            let ijk = leaf.origin() + Leaf::slot_offset(slot);
            let (value, active) = match &found {
                Found::Tile(tile) => (tile.value, tile.active),
                Found::Leaf(own) => own.probe(ijk),
            };
            let p = self.bounds.world_from_index.transform_point3(ijk.as_dvec3());
            let (value, active) = self.cut(value, active, self.bounds.distance(p));
            leaf.values_slice_mut()[slot] = value;
            leaf.value_mask_mut().set(slot, active);
        }
    }
}

/// The voxels of a tree that are in an area.
struct Cropping<'a, A> {
    area: A,
    work: &'a Work<'a>,
    /// Slots of root children that are done.
    done: AtomicU64,
}

impl<A: Area> Cropping<'_, A> {
    /// Those of some entries of the root.
    fn tree<'t, L: Node<Leaf = L> + 't>(
        &self,
        tree: &Tree<Upper<L>>,
        entries: impl Iterator<Item = (IVec3, &'t RootEntry<Upper<L>>)>,
    ) -> Result<Tree<Upper<L>>, Stop> {
        let outside = tree.background();
        let mut cropped = Tree::new(outside);
        for (i, (origin, entry)) in entries.enumerate() {
            self.done.store((i * Upper::<L>::SIZE) as u64, Ordering::Relaxed);
            let slot = match entry {
                RootEntry::Child(child) => Slot::Child(&**child),
                RootEntry::Tile { value, active } => Slot::Tile(*value, *active),
            };
            match self.slot(slot, origin, outside, &|upper| self.upper(upper, outside))? {
                Built::Tile(value, active) => cropped.insert_tile(origin, value, active),
                Built::Node(node) => cropped.insert_child(node),
            }
        }
        cropped.prune();
        Ok(cropped)
    }

    fn upper<L: Node<Leaf = L>>(
        &self,
        upper: &Upper<L>,
        outside: L::Value,
    ) -> Result<Built<Upper<L>>, Stop> {
        self.internal(upper, outside, &|lower| {
            self.work.report(self.done.fetch_add(1, Ordering::Relaxed))?;
            self.internal(lower, outside, &|leaf: &L| Ok(built(self.leaf(leaf, outside))))
        })
    }

    fn internal<C: Node, const LOG2: u32>(
        &self,
        node: &InternalNode<C, LOG2>,
        outside: C::Value,
        child: &(impl Fn(&C) -> Result<Built<C>, Stop> + Sync),
    ) -> Result<Built<InternalNode<C, LOG2>>, Stop>
    where
        Dim<LOG2>: Cube,
    {
        self.work.take((InternalNode::<C, LOG2>::SIZE * size_of::<C::Value>()) as u64)?;
        let slots = (0..InternalNode::<C, LOG2>::SIZE)
            .into_par_iter()
            .with_min_len(256)
            .map(|slot| {
                let origin = node.origin() + InternalNode::<C, LOG2>::slot_offset(slot);
                self.slot(node.slot_at(slot), origin, outside, child)
            })
            .collect::<Result<_, Stop>>()?;
        Ok(built(internal(node.origin(), slots)))
    }

    fn slot<N: Node>(
        &self,
        slot: Slot<N>,
        origin: IVec3,
        outside: N::Value,
        node: &impl Fn(&N) -> Result<Built<N>, Stop>,
    ) -> Result<Built<N>, Stop> {
        let part = self.area.part(CoordBox::cube(origin, N::TOTAL_LOG2_DIM));
        match (part, slot) {
            (Part::None, _) => Ok(Built::Tile(outside, false)),
            (Part::All, Slot::Child(child)) => {
                self.work.take(size_of::<N>() as u64)?;
                Ok(Built::Node(Box::new(child.clone())))
            }
            (Part::All, Slot::Tile(value, active)) => Ok(Built::Tile(value, active)),
            (Part::Some, Slot::Child(child)) => {
                self.work.take(size_of::<N>() as u64)?;
                node(child)
            }
            // Already what it would become.
            (Part::Some, Slot::Tile(value, false)) if value.same(outside) => {
                Ok(Built::Tile(value, false))
            }
            (Part::Some, Slot::Tile(value, active)) => {
                self.work.take(size_of::<N>() as u64)?;
                node(&N::filled(origin, value, active))
            }
        }
    }

    fn leaf<L: Node<Leaf = L>>(&self, leaf: &L, outside: L::Value) -> Box<L> {
        let mut cropped = Box::new(leaf.clone());
        for slot in 0..L::SIZE {
            let ijk = leaf.origin() + L::slot_offset(slot);
            if !self.area.contains(ijk) {
                cropped.set(ijk, outside, false);
            }
        }
        cropped
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::synth::{Random, level_set};

    #[test]
    fn voxels_in_the_box_stay_and_others_are_the_background() {
        let center = DVec3::new(3.0, -120.5, 8.25);
        let mut tree = level_set::sphere(center, 40.0);
        tree.insert_tile(IVec3::splat(8192), -3.0, false);
        let boxes = [
            CoordBox { min: IVec3::new(-20, -129, 0), max: IVec3::new(30, -100, 127) },
            CoordBox { min: IVec3::splat(8000), max: IVec3::splat(8200) },
            CoordBox { min: IVec3::MIN, max: IVec3::MAX },
            CoordBox { min: IVec3::splat(500), max: IVec3::splat(600) },
        ];
        let mut random = Random::new(7);
        for bounds in boxes {
            let part = voxels_within(&tree, bounds);
            for origin in [center.as_ivec3(), IVec3::splat(8192)] {
                for _ in 0..20_000 {
                    let mut near = || random.below(140) as i32 - 70;
                    let ijk = origin + IVec3::new(near(), near(), near());
                    let expected = match bounds.contains(ijk) {
                        true => tree.probe(ijk),
                        false => (tree.background(), false),
                    };
                    assert_eq!(part.probe(ijk), expected, "{ijk} of {bounds:?}");
                }
            }
        }
    }
}
