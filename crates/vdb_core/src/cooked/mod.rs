//! Cooked files: grids packed for the GPU beforehand, to be decoded in milliseconds.
//!
//! A `.vdbc` file holds the words of [`PackedGrid`]s, compressed such that decoding them takes one
//! pass and no tree: for sequences of smoke, fire or water, of which a frame must be there every
//! few milliseconds. `vdb cook` makes the files; `docs/reference/cooked.md` describes the format
//! and what it promises.
//!
//! ```
//! use glam::DVec3;
//! use vdb_core::cooked::{CookOptions, CookedFile};
//! use vdb_core::{AnyTree, Grid, Limits, VdbFile, synth};
//!
//! let tree = synth::fog::sphere(DVec3::ZERO, 20.0, 5.0);
//! let file = VdbFile::new(vec![Grid::new("density", AnyTree::Float(tree.into()))]);
//!
//! let cooked = CookedFile::cook(&file, &CookOptions::default())?;
//! let bytes = cooked.write()?;
//!
//! let again = CookedFile::read(&bytes, &Limits::default())?;
//! assert_eq!(again.grids[0].packed.words, cooked.grids[0].packed.words);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Values
//!
//! Decoding restores the words that were written, bit for bit. In all formats but
//! [`ValueFormat::Byte`] these are the words of [`PackedGrid::with_format`]. Bytes of fog are
//! chosen such that neighbouring leaves agree:
//!
//! - The step of a leaf is a power of two, and its bytes count multiples of it from a base that is
//!   a multiple, too. It is the smallest whose 256 multiples cover the samples of the leaf's
//!   brick, its own and those adjacent to it. The error of a sample that the leaf owns is at most
//!   1/255 of the range of these samples, or half of the last place of f32.
//! - A sample that a neighbour owns is the value that the neighbour keeps, rounded to the leaf's
//!   own steps. Where both have the same step, it is the same value in both bricks.
//!
//! # Safety
//!
//! A file is refused if it is damaged, foreign, of another version, or larger than [`Limits`]
//! allow; nothing is allocated that its bytes cannot be the compressed form of. Shaders follow the
//! words unchecked, so decoding tests every word that leads to another: no file, whatever its
//! bytes, makes a shader read beyond the words of its grid.

mod beside;
mod bricks;
mod error;
mod head;
mod quantize;
mod read;
mod rows;
mod steps;
mod words;
mod write;

use std::fmt;
use std::path::Path;
use std::sync::Arc;

pub use error::{CookError, CookedError};

use crate::format::{open, save};
use crate::pack::{PackKind, PackOptions, PackedGrid, PackedTogether, ValueFormat};
use crate::{AnyTree, Grid, GridClass, Limits, Metadata, ProgressFn, Transform, VdbFile};

/// The first bytes of a file; the last four show whether a transfer has changed line ends.
const MAGIC: [u8; 8] = *b"VDBC\r\n\x1a\n";
/// The version of the format.
const VERSION: u32 = 1;
/// The first byte that the checksum covers.
const CHECKED_FROM: usize = 16;

/// The extension of cooked files.
pub const EXTENSION: &str = "vdbc";

/// The CRC-32 of bytes, as in zip files.
fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// Grids that are packed for the GPU, and their placement in the world.
#[derive(Clone, Debug)]
pub struct CookedFile {
    /// The metadata of the file that was cooked.
    pub metadata: Metadata,
    /// The grids, in the order of the file that was cooked.
    pub grids: Vec<CookedGrid>,
}

/// A packed grid and its placement in the world.
#[derive(Clone, Debug)]
pub struct CookedGrid {
    /// The unique name, such as `density` or `density[1]`.
    pub name: String,
    /// The meaning of the values.
    pub class: GridClass,
    /// The transform from index space to world space.
    pub transform: Transform,
    /// The metadata of the grid.
    pub metadata: Metadata,
    /// The words for the GPU.
    pub packed: PackedGrid,
}

/// Options for cooking a file.
#[derive(Clone)]
pub struct CookOptions {
    /// The format of samples. [`ValueFormat::Byte`] by default; the others lose no more than
    /// packing does.
    pub format: ValueFormat,
    /// How grids interact with rays; `None` for the kind that [suits](PackKind::suited) each.
    pub kind: Option<PackKind>,
    /// Whether grids that suit a surface of voxels become smooth surfaces instead.
    pub smooth: bool,
    /// Memory limits, as for [packing](PackOptions::limits). They apply to all grids together.
    pub limits: Limits,
    /// A callback for the progress of packing each of the grids, as in [`PackOptions::progress`].
    pub progress: Option<Arc<ProgressFn>>,
}

impl Default for CookOptions {
    fn default() -> Self {
        let (format, limits) = (ValueFormat::Byte, Limits::default());
        Self { format, kind: None, smooth: false, limits, progress: None }
    }
}

impl fmt::Debug for CookOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CookOptions")
            .field("format", &self.format)
            .field("kind", &self.kind)
            .field("smooth", &self.smooth)
            .field("limits", &self.limits)
            .field("progress", &self.progress.as_ref().map(|_| "…"))
            .finish()
    }
}

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

    /// Decodes a file. The memory it takes beside the result is a third of it at most.
    ///
    /// # Errors
    /// If the bytes are no cooked file of this version, are damaged, or exceed
    /// [`Limits::file_bytes`], [`Limits::grids`], the limits of metadata, or
    /// [`Limits::packed_bytes`].
    pub fn read(bytes: &[u8], limits: &Limits) -> Result<Self, CookedError> {
        read::read(bytes, limits)
    }

    /// Reads and decodes a file from disk.
    ///
    /// # Errors
    /// Those of [`CookedFile::read`] and of the operating system, without the path.
    pub fn open(path: impl AsRef<Path>, limits: &Limits) -> Result<Self, CookedError> {
        Self::read(&open::read_whole(path.as_ref(), limits)?, limits)
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

impl CookedGrid {
    /// Makes a cooked grid of a packed one.
    pub fn of(grid: &Grid, packed: PackedGrid) -> Self {
        Self {
            name: grid.unique_name.clone(),
            class: grid.class,
            transform: grid.transform.clone(),
            metadata: grid.metadata.clone(),
            packed,
        }
    }
}

/// Packs a grid in the form in which it is cooked.
fn packed(
    tree: &crate::tree::Vdb543<f32>,
    class: GridClass,
    options: &CookOptions,
    together: &PackedTogether,
) -> Result<PackedGrid, crate::pack::PackError> {
    let kind = options.kind.unwrap_or_else(|| match PackKind::suited(class, tree) {
        PackKind::Surface { iso } if options.smooth => PackKind::Smooth { iso },
        kind => kind,
    });
    let of_format = |format| PackOptions {
        format,
        limits: options.limits.clone(),
        progress: options.progress.clone(),
        together: Some(together.clone()),
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
