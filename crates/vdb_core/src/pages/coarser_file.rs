//! Coarser levels of a tree in a file, in temporary files.

use std::path::Path;

use rayon::prelude::*;

use crate::format::streamed::{EncodedNode, Spool, StreamedTree};
use crate::tree::grow::Built;
use crate::tree::{
    Coarsening, CoordBox, HalfNodes, IVec3, Mask, Node, Vdb543, reach_of, roots_of_half,
};
use crate::work::{Stop, Work};
use crate::{Error, Limits};

use super::places::{Lower, Upper};

/// Nodes per thread that are made before they are written, which bounds memory: each takes a few
/// megabytes at most.
const NODES_PER_THREAD: usize = 16;

/// What has been made of a node above the leaves.
enum Made {
    Tile(f32, bool),
    Node(EncodedNode),
}

/// Makes the tree at half the resolution, in a temporary file at `path`.
pub(super) fn half_in_file(
    fine: &StreamedTree,
    coarsening: Coarsening,
    path: &Path,
    limits: &Limits,
) -> Result<StreamedTree, Error> {
    // As for trees in memory: a level that takes more than the one before would be useless.
    let limit = fine.whole_bytes().max(Limits::SMALL_LEVEL);
    let empty = Vdb543::new(fine.background());
    let work = Work::new(None, 0, u64::MAX);
    let background = HalfNodes::new(&empty, coarsening, &work).background();
    let mut spool = Spool::create(path, background, limits)?;
    let mut bytes = 0;
    for origin in roots_of_half(fine.entries(), coarsening).into_iter().map(IVec3::from_array) {
        let reach = reach_of(coarsening, origin, Upper::TOTAL_LOG2_DIM);
        let tiles = fine.tiles_within(reach)?;
        let of_tiles = HalfNodes::new(&tiles, coarsening, &work);
        let touched = touched(fine, coarsening, origin, reach);
        if touched.is_empty()
            && let Some((value, active)) = of_tiles.root_tile(origin)
        {
            spool.add_root_tile(origin, value, active);
            continue;
        }
        let upper = HalfUpper { fine, coarsening, touched, of_tiles, work: &work };
        let mut slots = Vec::with_capacity(Upper::SIZE);
        let all: Vec<usize> = (0..Upper::SIZE).collect();
        for some in all.chunks(NODES_PER_THREAD * rayon::current_num_threads()) {
            let made = some.par_iter().map(|slot| upper.node(origin, *slot));
            for made in made.collect::<Result<Vec<_>, _>>()? {
                slots.push(match made {
                    Made::Tile(value, active) => Some((value, active)),
                    Made::Node(node) => {
                        bytes += node.whole_bytes();
                        spool.add(node)?;
                        None
                    }
                });
            }
            if bytes > limit {
                let what = format!("{bytes} bytes of a level of detail");
                return Err(Error::limit(what, "level_bytes", limit));
            }
        }
        spool.end_upper(origin, slots)?;
    }
    spool.finish()
}

/// A child of the root of the coarser tree.
struct HalfUpper<'a> {
    fine: &'a StreamedTree,
    coarsening: Coarsening,
    /// The slots that depend on nodes above the leaves, and not on tiles only.
    touched: Mask<5>,
    of_tiles: HalfNodes<'a>,
    work: &'a Work<'a>,
}

impl HalfUpper<'_> {
    fn node(&self, origin: IVec3, slot: usize) -> Result<Made, Error> {
        let origin = origin + Upper::slot_offset(slot);
        let built = if self.touched.is_on(slot) {
            let part = self.fine.part(reach_of(self.coarsening, origin, Lower::TOTAL_LOG2_DIM))?;
            HalfNodes::new(&part, self.coarsening, self.work).node(origin)
        } else {
            self.of_tiles.node(origin)
        };
        match built {
            Ok(Built::Tile(value, active)) => Ok(Made::Tile(value, active)),
            Ok(Built::Node(node)) => Ok(Made::Node(EncodedNode::of(&node))),
            // Neither a callback nor a limit stops this work.
            Err(Stop::Cancelled | Stop::Memory { .. }) => Err(Error::cancelled()),
        }
    }
}

/// The slots of a child of the coarser tree's root that depend on nodes above the leaves.
fn touched(fine: &StreamedTree, coarsening: Coarsening, origin: IVec3, reach: CoordBox) -> Mask<5> {
    let mut touched = Mask::filled(false);
    for cube in fine.lowers_within(reach) {
        // A node of the coarser tree covers twice as many samples of the finer one per axis, so a
        // node of that one concerns at most eight and their neighbours.
        let last = Upper::DIM as i32 - 1;
        let place: IVec3 = ((cube.min >> 1) - origin) >> Lower::TOTAL_LOG2_DIM;
        let (low, high) = ((place - 1).max(IVec3::ZERO), (place + 1).min(IVec3::splat(last)));
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    let at = origin + (IVec3::new(x, y, z) << Lower::TOTAL_LOG2_DIM);
                    let needs = reach_of(coarsening, at, Lower::TOTAL_LOG2_DIM);
                    if needs.intersection(cube).is_some() {
                        touched.set(Upper::slot(at), true);
                    }
                }
            }
        }
    }
    touched
}
