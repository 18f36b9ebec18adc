//! Boxes of samples for which a tree has a single value.

use super::Upper;
use crate::tree::{Cube, Dim, IVec3, InternalNode, Node, RootEntry, Slot, Vdb543};

/// A box of samples of the finer tree, with both corners included.
pub(super) type Samples = [(i64, i64); 3];

/// The root entries of the finer tree around the samples of one root child of the coarser tree.
pub(super) struct Roots<'a> {
    /// The position of the first entry, in units of their size.
    first: [i64; 3],
    background: f32,
    entries: Vec<Option<&'a RootEntry<Upper>>>,
}

/// Entries per axis: two in the node, and one on either side.
const ROOTS: i64 = 4;

impl<'a> Roots<'a> {
    /// The entries around the coarser tree's node at an origin.
    pub fn around(tree: &'a Vdb543<f32>, origin: IVec3) -> Self {
        let first = origin.to_array().map(|c| 2 * (i64::from(c) >> Upper::TOTAL_LOG2_DIM) - 1);
        let mut entries = Vec::with_capacity(ROOTS.pow(3) as usize);
        each([(0, ROOTS - 1); 3], |c| {
            let at = [0, 1, 2].map(|axis| (first[axis] + c[axis]) << Upper::TOTAL_LOG2_DIM);
            entries.push(match at.map(i32::try_from) {
                [Ok(x), Ok(y), Ok(z)] => tree.entry(IVec3::new(x, y, z)),
                _ => None,
            });
            true
        });
        Self { first, background: tree.background(), entries }
    }

    /// The common value of all samples of a box, if they all lie in equal tiles.
    pub fn one_value(&self, samples: Samples) -> Option<f32> {
        let mut one = None;
        let slots = [0, 1, 2].map(|axis| {
            let of = |c: i64| (c >> Upper::TOTAL_LOG2_DIM) - self.first[axis];
            (of(samples[axis].0), of(samples[axis].1))
        });
        each(slots, |[x, y, z]| {
            match self.entries[((x * ROOTS + y) * ROOTS + z) as usize] {
                None => same(&mut one, self.background),
                Some(RootEntry::Tile { value, .. }) => same(&mut one, *value),
                Some(RootEntry::Child(upper)) => {
                    within(&**upper, samples, &mut one, |lower, one| {
                        // A leaf exists because its values differ.
                        within(lower, samples, one, |_, _| false)
                    })
                }
            }
        })
        .then_some(one)
        .flatten()
    }
}

/// Whether a value equals that of all samples so far.
fn same(one: &mut Option<f32>, value: f32) -> bool {
    one.get_or_insert(value).to_bits() == value.to_bits()
}

/// Visits all points of a box for as long as `of` returns true.
pub(super) fn each(places: Samples, mut of: impl FnMut([i64; 3]) -> bool) -> bool {
    let [x, y, z] = places.map(|(low, high)| low..=high);
    x.into_iter().all(|x| y.clone().all(|y| z.clone().all(|z| of([x, y, z]))))
}

/// Whether all samples of a box within a node have the common value.
fn within<C: Node<Value = f32>, const LOG2: u32>(
    node: &InternalNode<C, LOG2>,
    samples: Samples,
    one: &mut Option<f32>,
    mut child: impl FnMut(&C, &mut Option<f32>) -> bool,
) -> bool
where
    Dim<LOG2>: Cube,
{
    let origin = node.origin().to_array().map(i64::from);
    let edge = 1_i64 << C::TOTAL_LOG2_DIM;
    let last = (1 << LOG2) - 1;
    let slots = [0, 1, 2].map(|axis| {
        let of = |c: i64| (c - origin[axis]).div_euclid(edge).clamp(0, last);
        (of(samples[axis].0), of(samples[axis].1))
    });
    each(slots, |[x, y, z]| {
        let slot = (x << (2 * LOG2) | y << LOG2 | z) as usize;
        match node.slot_at(slot) {
            Slot::Tile(value, _) => same(one, value),
            Slot::Child(below) => child(below, one),
        }
    })
}
