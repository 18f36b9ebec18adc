//! Voxels that change, and the words with them.
//!
//! A grid that is being edited is packed with room to spare: behind what each section of its words has
//! there is as much again by half, and the leaves of a lower node are a run of places with some to spare.
//! After an edit only those leaves are packed anew whose lattice cells have samples that changed, the
//! skips of the lower nodes around them where leaves came or went, and the top-level tree where lower nodes did. Where
//! there is no room left, all is packed anew, with new room: the more there is, the rarer.
//!
//! What rays meet is what they meet in the same tree packed as a whole; samples are kept in 32 bits, so
//! that any value can come.

mod commit;
mod content;
mod runs;
mod sections;
mod slots;
mod voxels;

use std::ops::Range;

pub use voxels::{Voxel, VoxelEdit};

use super::{PackError, PackOptions, PackedGrid, ValueFormat, build};
use crate::tree::{RootEntry, Vdb543};
use content::View;
use sections::Sections;
use slots::Cubes;

/// What keeps a packed grid in step with a tree whose voxels change.
///
/// ```
/// use vdb_core::pack::edit::{Changes, Editor};
/// use vdb_core::pack::{PackKind, PackedGrid};
/// use vdb_core::tree::{IVec3, Vdb543};
///
/// let kind = PackKind::Surface { iso: 0.0 };
/// let mut tree = Vdb543::new(1.0);
/// let mut packed = PackedGrid::new(&tree, kind)?;
/// let mut editor = Editor::default();
/// // The first time, all is packed anew, with room to spare.
/// editor.edit(&mut tree).set(IVec3::ZERO, -1.0);
/// assert_eq!(editor.commit(&tree, &mut packed)?, Changes::All);
/// editor.edit(&mut tree).set(IVec3::new(1, 0, 0), -1.0);
/// let Changes::Words(ranges) = editor.commit(&tree, &mut packed)? else { unreachable!() };
/// assert!(ranges.iter().map(|range| range.len()).sum::<usize>() < 100);
/// # Ok::<(), vdb_core::pack::PackError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Editor {
    changed: Cubes,
    /// Where there are any: see [`Editor::commit`].
    sections: Option<Sections>,
    /// Whether the words are those of the tree as it was at the last commit.
    packed: bool,
}

/// The words of a packed grid that have changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Changes {
    /// These, in order; none of them empty. The grid has as many words as before.
    Words(Vec<Range<u32>>),
    /// All, and there may be more or fewer of them.
    All,
}

impl Changes {
    /// These and later ones.
    pub fn and(self, later: Self) -> Self {
        match (self, later) {
            (Self::Words(mut words), Self::Words(later)) => {
                words.extend(later);
                Self::Words(commit::merged(words))
            }
            _ => Self::All,
        }
    }
}

impl Editor {
    /// Changes voxels of the tree, which must be the same one each time.
    pub fn edit<'a>(&'a mut self, tree: &'a mut Vdb543<f32>) -> VoxelEdit<'a> {
        VoxelEdit { tree, changed: &mut self.changed }
    }

    /// Brings a packed grid up to date with the tree, whose voxels have changed through
    /// [`Editor::edit`] alone: the first time by packing all of it anew, then by what has changed. It
    /// is the same packed grid each time, or a clone of it.
    ///
    /// Time is in proportion to the cubes of 8³ voxels that have changed; where some have become empty, or
    /// not empty, to the lower nodes of 128³ around them; and, by little, to all lower nodes, for the box around
    /// them and the tree over them. Packing anew takes the time of [`PackedGrid::new`], in proportion to
    /// all nodes: once the room is used up, which comes the more rarely the more there is, and always
    /// where tiles of 4096³ voxels, or all that the tree does not hold, can stop or dim a ray.
    ///
    /// # Errors
    /// As [`PackedGrid::new`]. The packed grid is then empty, until a commit succeeds.
    pub fn commit(
        &mut self,
        tree: &Vdb543<f32>,
        packed: &mut PackedGrid,
    ) -> Result<Changes, PackError> {
        if self.packed && self.changed.is_empty() {
            return Ok(Changes::Words(Vec::new()));
        }
        let view = View::new(tree, packed.kind);
        let mut cubes = std::mem::take(&mut self.changed);
        if let Some(mut sections) = self.sections.take() {
            if packed.sample_format().is_some() {
                cubes = cubes.with_low_sides();
            }
            if let Ok(ranges) = commit::commit(&mut sections, packed, &view, cubes) {
                self.sections = Some(sections);
                return Ok(Changes::Words(ranges));
            }
        }
        let counts = |entry: &RootEntry<_>| match entry {
            RootEntry::Tile { value, .. } => view.rule.counts(*value),
            RootEntry::Child(_) => false,
        };
        let large =
            view.rule.counts(tree.background()) || tree.entries().any(|(_, entry)| counts(entry));
        self.packed = false;
        let options = PackOptions { format: ValueFormat::Full, ..PackOptions::default() };
        let whole = build::pack(tree, packed.kind, &options).and_then(|whole| {
            let spread = if large { None } else { Sections::spread(&whole)? };
            Ok(spread.map_or((whole, None), |(packed, sections)| (packed, Some(sections))))
        });
        match whole {
            Ok((whole, sections)) => (*packed, self.sections) = (whole, sections),
            Err(error) => {
                *packed = PackedGrid::new(&Vdb543::new(tree.background()), packed.kind)?;
                return Err(error);
            }
        }
        self.packed = true;
        Ok(Changes::All)
    }
}
