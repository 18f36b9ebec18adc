//! Editing: changes voxels of a tree, and updates its packed words.
//!
//! An edited grid is packed with spare room: each section of its words can grow by half, and the
//! leaves of each lower node are a run of slots with some unused. After an edit, only the following
//! are repacked: leaves whose lattice cells have changed samples; the skips of lower nodes around
//! added or removed leaves; and the top-level tree, if lower nodes were added or removed. When room
//! runs out, the whole grid is packed again with new room, which becomes rarer as the grid grows.
//!
//! Rays give the same results as in the same tree packed as a whole. Samples are stored in 32 bits,
//! so that any value can be written.

mod commit;
mod content;
mod frame;
mod items;
mod nodes;
mod runs;
mod samples;
mod sections;
mod slots;
mod voxels;
mod words;

use std::ops::Range;

pub use voxels::{Voxel, VoxelEdit};

use super::{PackError, PackOptions, PackedGrid, ValueFormat, build};
use crate::Limits;
use crate::tree::{RootEntry, Vdb543};
use content::View;
use sections::Sections;
use slots::Cubes;

/// Keeps a packed grid in step with a tree whose voxels change.
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
/// // The first commit packs the whole grid, with spare room.
/// editor.edit(&mut tree).set(IVec3::ZERO, -1.0);
/// assert_eq!(editor.commit(&tree, &mut packed)?, Changes::All);
/// editor.edit(&mut tree).set(IVec3::new(1, 0, 0), -1.0);
/// let Changes::Words(ranges) = editor.commit(&tree, &mut packed)? else { unreachable!() };
/// assert!(ranges.iter().map(|range| range.len()).sum::<usize>() < 100);
/// # Ok::<(), vdb_core::pack::PackError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Editor {
    /// Limits of packing the whole grid.
    pub limits: Limits,
    changed: Cubes,
    /// The spare room, once there is any: see [`Editor::commit`].
    sections: Option<Sections>,
    /// Whether the words match the tree as of the last commit.
    packed: bool,
}

/// The changed words of a packed grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Changes {
    /// These ranges, in order; none of them is empty. The number of words is unchanged.
    Words(Vec<Range<u32>>),
    /// All words; their number may have changed.
    All,
}

impl Changes {
    /// These changes, followed by `later` ones.
    pub fn and(self, later: Self) -> Self {
        match (self, later) {
            (Self::Words(mut words), Self::Words(later)) => {
                words.extend(later);
                Self::Words(words::merged(words))
            }
            _ => Self::All,
        }
    }
}

impl Editor {
    /// Begins to edit the tree, which must be the same each time.
    pub fn edit<'a>(&'a mut self, tree: &'a mut Vdb543<f32>) -> VoxelEdit<'a> {
        VoxelEdit { tree, changed: &mut self.changed }
    }

    /// Updates a packed grid after its tree has changed through [`Editor::edit`] only. The first
    /// commit packs the whole grid; later ones pack what has changed. `packed` must be the same
    /// packed grid each time, or a clone of it.
    ///
    /// The time is proportional to the number of changed cubes of 8³ voxels; where cubes became
    /// empty or ceased to be, also to the number of lower nodes of 128³ around them; and, to a
    /// small degree, to the number of all lower nodes, for their bounding box and the tree over
    /// them. Packing the whole grid takes the time of [`PackedGrid::new`], proportional to all
    /// nodes. That happens when the spare room is used up, which becomes rarer as the grid grows;
    /// and at every commit if root tiles of 4096³ voxels or the background can stop or dim a ray.
    ///
    /// # Errors
    /// Those of [`PackedGrid::with_options`]. The packed grid is then empty until a commit succeeds.
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
        let limits = self.limits.clone();
        let options = PackOptions { format: ValueFormat::Full, limits, ..PackOptions::default() };
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
