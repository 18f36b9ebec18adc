//! The second pass over a tree: builds the nodes located by the first, on all cores.

use rayon::prelude::*;

use super::checksum::crc;
use super::layout::{child_mask, node};
use super::leaves::Decode;
use super::scan::{Inner, Scan};
use crate::Error;
use crate::format::build::LEAVES_PER_TASK;
use crate::format::masks::read_mask;
use crate::format::topology::{Middle, Upper};
use crate::tree::{Cube, Dim, InternalNode, Mask, Node, Tree};
use crate::work::Progress;

/// The masks and tiles of an internal node.
type Parts<T, const LOG2: u32> = (Mask<LOG2>, Mask<LOG2>, Box<[T]>);

impl<D: Decode> Scan<'_, D> {
    /// Builds the tree.
    pub fn build(&self, progress: &Progress<'_>) -> Result<Tree<Upper<D::Leaf>>, Error> {
        let lowers = self
            .lowers
            .par_iter()
            .map(|lower| self.build_lower(lower, progress))
            .collect::<Result<Vec<_>, _>>()?;
        let mut lowers = lowers.into_iter();
        // Each upper node takes its own children from the front, in the order of the first pass.
        let parts: Vec<(&Inner, Vec<_>)> = self
            .uppers
            .iter()
            .map(|upper| (upper, lowers.by_ref().take(upper.children.len()).collect()))
            .collect();
        let uppers = parts
            .into_par_iter()
            .map(|(upper, children)| self.build_internal::<_, 5>(upper, children))
            .collect::<Result<Vec<_>, _>>()?;
        let mut tree = Tree::new(self.background);
        for &(origin, value, active) in &self.tiles {
            tree.insert_tile(origin, value, active);
        }
        for upper in uppers {
            tree.insert_child(upper);
        }
        Ok(tree)
    }

    fn build_lower(
        &self,
        lower: &Inner,
        progress: &Progress<'_>,
    ) -> Result<Box<Middle<D::Leaf>>, Error> {
        let starts = &self.leaves[lower.children.clone()];
        let mask: Mask<4> = read_mask(&mut self.cursor.moved_to(lower.at + child_mask(4))?)?;
        let slots: Vec<usize> = mask.iter_on().collect();
        let leaves = slots
            .par_iter()
            .zip(starts)
            .with_min_len(LEAVES_PER_TASK)
            .map(|(&slot, &(at, _))| {
                let origin = lower.origin + Middle::<D::Leaf>::slot_offset(slot);
                self.decode.leaf(self.cursor.moved_to(at)?, origin)
            })
            .collect::<Result<Vec<_>, _>>()?;
        progress.add(starts.iter().map(|(_, bytes)| bytes).sum())?;
        self.build_internal::<_, 4>(lower, leaves)
    }

    fn build_internal<C, const LOG2: u32>(
        &self,
        inner: &Inner,
        children: Vec<Box<C>>,
    ) -> Result<Box<InternalNode<C, LOG2>>, Error>
    where
        C: Node<Value = <D::Leaf as Node>::Value>,
        Dim<LOG2>: Cube,
    {
        let (child_mask, value_mask, tiles) = self.parts::<LOG2>(inner.at)?;
        // Unreachable in practice: the first pass counted the children by the same mask.
        let unfit = || Error::invalid("the children of a node do not fit its mask").at(inner.at);
        InternalNode::from_parts(inner.origin, child_mask, value_mask, children, tiles)
            .ok_or_else(unfit)
    }

    fn parts<const LOG2: u32>(
        &self,
        at: usize,
    ) -> Result<Parts<<D::Leaf as Node>::Value, LOG2>, Error>
    where
        Dim<LOG2>: Cube,
    {
        let children: Mask<LOG2> = read_mask(&mut self.cursor.moved_to(at + child_mask(LOG2))?)?;
        let active = read_mask(&mut self.cursor.moved_to(at + node::VALUE_MASK)?)?;
        let sizes = self.decode.sizes();
        let table = at + sizes.table(LOG2);
        let tile = |slot: usize| {
            if children.is_on(slot) {
                return Ok(self.background);
            }
            self.decode.value(self.cursor.moved_to(table + slot * sizes.slot_bytes())?)
        };
        let tiles = (0..Mask::<LOG2>::SIZE).map(tile).collect::<Result<Box<[_]>, _>>()?;
        Ok((children, active, tiles))
    }

    /// The checksums of all nodes, from the upper ones to the leaves. Up to version 32.4, of a
    /// leaf's first `leaf_bytes` bytes only.
    pub fn node_checksums(&self, leaf_bytes: Option<usize>) -> Result<Vec<u32>, Error> {
        let sizes = self.decode.sizes();
        let inner = |nodes: &[Inner], log2: u32| {
            nodes.iter().map(|node| (node.at, sizes.node_bytes(log2))).collect::<Vec<_>>()
        };
        let leaves = self.leaves.iter().map(|&(at, bytes)| (at, leaf_bytes.unwrap_or(bytes)));
        let mut nodes = inner(&self.uppers, 5);
        nodes.extend(inner(&self.lowers, 4));
        nodes.extend(leaves);
        nodes
            .into_par_iter()
            .map(|(at, bytes)| Ok(crc(self.cursor.moved_to(at)?.take(bytes)?)))
            .collect()
    }
}
