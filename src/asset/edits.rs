//! Voxels that change while an app runs, and the changes that the GPU has not received yet.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use vdb_core::Limits;
use vdb_core::pack::edit::{Changes, Editor};
use vdb_core::pack::{PackError, PackedGrid};
use vdb_core::tree::Vdb543;

use crate::VdbEdit;

/// Keeps a grid consistent with its voxels.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edits {
    editor: Editor,
    journal: Journal,
}

impl Edits {
    /// Sets the limits of packing the whole grid.
    pub fn set_limits(&mut self, limits: Limits) {
        self.editor.limits = limits;
    }

    /// Changes voxels of a tree and updates its packed grid.
    pub fn edit<R>(
        &mut self,
        tree: &mut Arc<Vdb543<f32>>,
        packed: &mut Arc<PackedGrid>,
        f: impl FnOnce(&mut VdbEdit) -> R,
    ) -> Result<R, PackError> {
        let done = f(&mut self.editor.edit(Arc::make_mut(tree)));
        let (tree, packed) = (&**tree, Arc::make_mut(packed));
        let changes = self.editor.commit(tree, packed);
        match &changes {
            Ok(changes) => self.journal.add(changes.clone(), packed.words.len()),
            Err(_) => self.journal.add(Changes::All, packed.words.len()),
        }
        changes.map(|_| done)
    }

    /// A unique number for the current words of the packed grid, different from that of any other
    /// words of any grid.
    pub fn revision(&self) -> u64 {
        self.journal.revision
    }

    /// The changes since a revision.
    pub fn since(&self, revision: u64) -> Changes {
        self.journal.since(revision)
    }
}

/// The number of commits that a journal keeps; a reader that runs every frame never needs as many.
const MOST_COMMITS: usize = 64;

/// The latest changes of a grid's words.
#[derive(Clone, Debug)]
struct Journal {
    revision: u64,
    /// The revision before each commit and what it changed, in order.
    commits: VecDeque<(u64, Changes)>,
    /// The total number of changed words.
    words: usize,
}

impl Default for Journal {
    fn default() -> Self {
        Self { revision: new_revision(), commits: VecDeque::new(), words: 0 }
    }
}

fn new_revision() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

fn count(changes: &Changes) -> usize {
    match changes {
        Changes::Words(ranges) => ranges.iter().map(|range| range.len()).sum(),
        Changes::All => 0,
    }
}

impl Journal {
    /// Records changes of a grid that now has this many words.
    fn add(&mut self, changes: Changes, words: usize) {
        if changes == Changes::Words(Vec::new()) {
            return;
        }
        let before = std::mem::replace(&mut self.revision, new_revision());
        if changes == Changes::All {
            self.commits.clear();
            self.words = 0;
            return;
        }
        self.words += count(&changes);
        self.commits.push_back((before, changes));
        // A reader whose revision has been dropped gets all words of the grid, which are no more
        // than the changes would be.
        while self.commits.len() > MOST_COMMITS || self.words > words {
            let Some((_, oldest)) = self.commits.pop_front() else { break };
            self.words -= count(&oldest);
        }
    }

    fn since(&self, revision: u64) -> Changes {
        if revision == self.revision {
            return Changes::Words(Vec::new());
        }
        let Some(first) = self.commits.iter().position(|(before, _)| *before == revision) else {
            return Changes::All;
        };
        let commits = self.commits.range(first..).map(|(_, changes)| changes.clone());
        commits.fold(Changes::Words(Vec::new()), Changes::and)
    }
}

#[cfg(test)]
mod tests {
    use bevy::math::{DAffine3, IVec3};
    use vdb_core::pack::PackKind;
    use vdb_core::synth::fog;

    use super::*;
    use crate::VdbGrid;

    fn words(first: u32) -> Changes {
        Changes::Words(std::iter::once(first..first + 10).collect())
    }

    #[test]
    fn edits_obey_the_limits_of_the_grid() {
        let tree = fog::cloud(20.0, 1);
        let mut grid = VdbGrid::new("cloud", tree, DAffine3::IDENTITY, PackKind::Fog).unwrap();
        let mut few = Limits::default();
        few.packed_bytes = 1 << 10;
        let edit = |grid: &mut VdbGrid| grid.edit(|voxels| voxels.set(IVec3::ZERO, 0.5));
        grid = grid.with_limits(few.clone());
        let error = edit(&mut grid).unwrap_err().to_string();
        assert!(error.contains("`Limits::packed_bytes`"), "{error}");
        grid = grid.with_limits(Limits::UNLIMITED);
        edit(&mut grid).unwrap();
        assert!(grid.packed().occupied.is_some());
        grid = grid.with_limits(few);
        let error = grid.finish_edits().unwrap_err().to_string();
        assert!(error.contains("`Limits::packed_bytes`") && grid.is_edited(), "{error}");
    }

    #[test]
    fn a_reader_gets_all_that_it_has_missed() {
        let mut journal = Journal::default();
        let start = journal.revision;
        assert_eq!(journal.since(start), Changes::Words(Vec::new()));
        journal.add(words(500), 1000);
        let middle = journal.revision;
        journal.add(words(0), 1000);
        journal.add(Changes::Words(Vec::new()), 1000);
        assert_eq!(journal.since(start), Changes::Words(vec![0..10, 500..510]));
        assert_eq!(journal.since(middle), words(0));
        assert_eq!(journal.since(journal.revision), Changes::Words(Vec::new()));
        // The revision of another grid is unknown.
        assert_eq!(journal.since(Journal::default().revision), Changes::All);

        // A clone diverges after its next change.
        let (common, mut other) = (journal.revision, journal.clone());
        journal.add(words(20), 1000);
        other.add(words(30), 1000);
        assert_eq!(other.since(journal.revision), Changes::All);
        assert_eq!(other.since(common), words(30));

        journal.add(Changes::All, 1000);
        assert_eq!(journal.since(common), Changes::All);
    }

    #[test]
    fn a_journal_that_no_one_reads_does_not_grow() {
        let mut journal = Journal::default();
        let start = journal.revision;
        for i in 0..1000 {
            journal.add(words(i * 100), 1_000_000);
        }
        assert!(journal.commits.len() <= MOST_COMMITS && journal.since(start) == Changes::All);
        let before = journal.revision;
        journal.add(Changes::Words(vec![0..800, 900..1000]), 500);
        assert!(journal.words <= 500 && journal.since(before) == Changes::All);
    }
}
