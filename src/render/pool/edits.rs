//! Extraction of edits: the words of edited grids that the pool does not have yet.

use std::ops::Range;

use bevy::prelude::*;
use bevy::render::Extract;
use vdb_core::pack::edit::Changes;

use super::edited::{EditedGrid, EditedWords, ExtractedEdits};
use super::residency::VdbTreePool;
use crate::render::gpu::GridKey;
use crate::{VdbEmission, VdbGrid, VdbVolume};

/// The largest number of copies per grid and frame. Beyond that, ranges that are close to each
/// other are merged: a further copy costs more than the unchanged words between two ranges.
const MAX_COPIES: usize = 4096;

/// Finds the words of displayed grids that the pool lacks, by comparing revisions, so that no edit
/// is lost if a frame is not drawn or the device is lost.
pub(crate) fn extract_edits(
    volumes: Extract<Query<(&VdbVolume, Option<&VdbEmission>)>>,
    grids: Extract<Res<Assets<VdbGrid>>>,
    pool: Res<VdbTreePool>,
    mut edits: ResMut<ExtractedEdits>,
) {
    edits.clear();
    for (volume, emission) in &volumes {
        let shining = emission.and_then(|emission| match emission {
            VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => Some(grid),
            VdbEmission::Color { .. } => None,
        });
        for handle in [Some(&volume.0), shining].into_iter().flatten() {
            let key = GridKey::from(handle.id());
            if let Some(grid) = grids.get(handle)
                && let Some(own) = grid.edits()
                && edits.get(&key).is_none()
            {
                let changes = pool.revision(key).map_or(Changes::All, |held| own.since(held));
                let words = match changes {
                    Changes::All if pool.refusal(&key).is_some() => EditedWords::Left,
                    Changes::All => EditedWords::All(grid.packed().clone()),
                    Changes::Words(ranges) => {
                        let few = few(ranges).into_iter();
                        let words = |range: &Range<u32>| {
                            grid.packed().words[range.start as usize..range.end as usize].to_vec()
                        };
                        EditedWords::Changed(
                            few.map(|range| (range.clone(), words(&range))).collect(),
                        )
                    }
                };
                let (revision, count) = (own.revision(), grid.packed().words.len());
                edits.insert(key, EditedGrid { revision, count, words });
            }
        }
    }
}

/// Merges ranges that are close to each other until there are at most [`MAX_COPIES`].
fn few(mut ranges: Vec<Range<u32>>) -> Vec<Range<u32>> {
    let mut gap = 64;
    while ranges.len() > MAX_COPIES {
        gap *= 2;
        ranges.dedup_by(|next, range| {
            let near = next.start - range.end <= gap;
            if near {
                range.end = next.end;
            }
            near
        });
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_few_copies_and_all_words_are_in_them() {
        let ranges: Vec<Range<u32>> =
            (0..20_000).map(|i| i * 1000 + i % 7..i * 1000 + i % 7 + 3).collect();
        let few = super::few(ranges.clone());
        assert!(few.len() <= MAX_COPIES && few.windows(2).all(|two| two[0].end < two[1].start));
        let holds = |range: &Range<u32>| {
            let at = few.partition_point(|one| one.end < range.end);
            few[at].start <= range.start
        };
        assert!(ranges.iter().all(holds));
        let few_enough = vec![0..3, 100..105];
        assert_eq!(super::few(few_enough.clone()), few_enough);
    }
}
