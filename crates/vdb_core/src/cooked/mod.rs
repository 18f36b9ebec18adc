//! Cooked files: grids packed for the GPU beforehand, to be decoded in milliseconds.
//!
//! A `.vdbc` file holds the words of [packed grids](crate::pack::PackedGrid), compressed so that
//! decoding needs no tree. Such files are meant for sequences of smoke, fire or water, which need a
//! new frame every few milliseconds. `vdb cook` makes them; `docs/reference/cooked.md` describes the
//! format and what it promises.
//!
//! ```
//! use glam::DVec3;
//! use vdb_core::cooked::{CookOptions, CookedFile};
//! use vdb_core::{AnyTree, Grid, ReadOptions, VdbFile, synth};
//!
//! let tree = synth::fog::sphere(DVec3::ZERO, 20.0, 5.0);
//! let file = VdbFile::new(vec![Grid::new("density", AnyTree::Float(tree.into()))]);
//!
//! let cooked = CookedFile::cook(&file, &CookOptions::default())?;
//! let bytes = cooked.write()?;
//!
//! let again = CookedFile::read(&bytes, &ReadOptions::default())?;
//! assert_eq!(again.grids[0].packed.words, cooked.grids[0].packed.words);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Values
//!
//! Decoding restores the words that were written, bit for bit. In all formats but
//! [`Byte`](crate::pack::ValueFormat::Byte) these are the words of
//! [`PackedGrid::with_format`](crate::pack::PackedGrid::with_format). Bytes of fog are chosen such
//! that neighbouring leaves agree:
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
//! A file is refused if it is damaged, foreign, of another version, or larger than
//! [`Limits`](crate::Limits) allow; memory is allocated only for as many words as its bytes can hold
//! in compressed form. Shaders follow the words unchecked, so decoding tests every word that leads
//! to another: no file, whatever its bytes, makes a shader read beyond the words of its grid.

mod beside;
mod bricks;
mod counts;
mod error;
mod file;
mod grid;
mod head;
mod options;
mod quantize;
mod read;
mod rows;
pub(crate) mod signature;
mod steps;
mod words;
mod write;

pub use error::{CookError, CookedError};
pub use grid::{CookedFile, CookedGrid};
pub use options::CookOptions;
pub use signature::{EXTENSION, VERSION, checksum};
