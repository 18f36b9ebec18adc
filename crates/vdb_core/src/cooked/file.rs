//! Cooking, writing and reading files.

use std::path::Path;
use std::sync::Arc;

use super::error::{CookError, CookedError};
use super::grid::{CookedFile, CookedGrid};
use super::options::CookOptions;
use super::signature::MAGIC;
use super::{quantize, read, write};
use crate::format::{open, save};
use crate::pack::{
    PackError, PackKind, PackOptions, PackedGrid, PackedTogether, SpareWords, ValueFormat,
};
use crate::tree::Vdb543;
use crate::{AnyTree, GridClass, ReadOptions, VdbFile};

impl CookedFile {
    /// Cooks all grids of floats of a file; other grids are left out.
    ///
    /// # Errors
    /// If there is no such grid, a grid cannot be packed, or the callback cancels.
    pub fn cook(file: &VdbFile, options: &CookOptions) -> Result<Self, CookError> {
        let together = PackedTogether::default();
        let cooked = file.grids.iter().filter_map(|grid| match &grid.tree {
            AnyTree::Float(tree) => {
                let packed = packed(tree, grid.class, options, &together);
                let failed = |source| CookError::Pack { grid: grid.unique_name.clone(), source };
                Some(packed.map_err(failed).map(|packed| CookedGrid::of(grid, packed)))
            }
            _ => None,
        });
        let grids: Vec<CookedGrid> = cooked.collect::<Result<_, _>>()?;
        if grids.is_empty() {
            return Err(CookError::Nothing);
        }
        Ok(Self { metadata: file.metadata.clone(), grids })
    }

    /// Serialises the grids. They must not have been [edited](crate::pack::edit).
    ///
    /// # Errors
    /// If a name or a value is too long for the format, or a grid has been edited.
    pub fn write(&self) -> Result<Vec<u8>, CookError> {
        write::write(self).map_err(CookError::Write)
    }

    /// Decodes the selected grids of a file. Besides the result, this takes at most a quarter of the
    /// result's size and, on each thread, the samples of one cube of 128³ cells. Progress is
    /// reported after each such cube of fog, and after each grid.
    ///
    /// # Errors
    /// If the bytes are no cooked file of this version, are damaged, or exceed
    /// [`Limits::file_bytes`], [`Limits::grids`], the limits of metadata, or
    /// [`Limits::packed_bytes`]; if a selected grid is not there, or the callback cancels.
    ///
    /// [`Limits::file_bytes`]: crate::Limits::file_bytes
    /// [`Limits::grids`]: crate::Limits::grids
    /// [`Limits::packed_bytes`]: crate::Limits::packed_bytes
    pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Self, CookedError> {
        read::read(bytes, options, None)
    }

    /// As [`CookedFile::read`], but uses the memory that `spare` has of dropped grids, if it fits. When
    /// the new grids are dropped, `spare` gets their memory in turn, as it does if reading fails or is
    /// cancelled.
    ///
    /// # Errors
    /// Those of [`CookedFile::read`].
    pub fn read_reusing(
        bytes: &[u8],
        options: &ReadOptions,
        spare: &Arc<SpareWords>,
    ) -> Result<Self, CookedError> {
        read::read(bytes, options, Some(spare))
    }

    /// Reads and decodes a file from disk.
    ///
    /// # Errors
    /// Those of [`CookedFile::read`] and of the operating system, without the path.
    pub fn open(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Self, CookedError> {
        Self::read(&open::read_whole(path.as_ref(), &options.limits)?, options)
    }

    /// Writes a file to disk as [`CookedFile::write`] does, and as safely as [`VdbFile::save`].
    /// Returns the number of its bytes.
    ///
    /// # Errors
    /// Those of [`CookedFile::write`] and of the operating system, without the path.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<u64, CookError> {
        let bytes = self.write()?;
        save::save_bytes(path.as_ref(), &bytes).map_err(CookError::Write)?;
        Ok(bytes.len() as u64)
    }

    /// Whether bytes begin like a cooked file, of any version.
    pub fn is_cooked(bytes: &[u8]) -> bool {
        bytes.starts_with(&MAGIC)
    }

    /// The first grid with this name.
    pub fn grid(&self, name: &str) -> Option<&CookedGrid> {
        self.grids.iter().find(|grid| grid.name == name)
    }
}

/// Packs a grid in the form in which it is cooked.
fn packed(
    tree: &Vdb543<f32>,
    class: GridClass,
    options: &CookOptions,
    together: &PackedTogether,
) -> Result<PackedGrid, PackError> {
    let kind = options.kind.unwrap_or_else(|| match PackKind::suited(class, tree) {
        PackKind::Surface { iso } if options.smooth => PackKind::Smooth { iso },
        kind => kind,
    });
    let of_format = |format| PackOptions {
        format,
        limits: options.limits.clone(),
        progress: options.progress.clone(),
        together: Some(together.clone()),
        cells: None,
    };
    // A background with a density is not fog, but bricks beside it blend into it: their samples are
    // those of no leaf and no tile.
    let has_background = tree.background() > 0.0;
    if kind == PackKind::Fog && options.format == ValueFormat::Byte && !has_background {
        let exact = PackedGrid::with_options(tree, kind, &of_format(ValueFormat::Exact))?;
        if let Some(quantized) = quantize::quantized(&exact) {
            return Ok(quantized);
        }
    }
    PackedGrid::with_options(tree, kind, &of_format(options.format))
}
