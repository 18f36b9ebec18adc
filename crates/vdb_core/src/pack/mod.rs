//! Packing of trees into words for the GPU.
//!
//! A [`PackedGrid`] separates *where a ray can end* from *the values there*. The traversal
//! structure is a tree of words and bits over the *lattice* of a grid, whose cells are
//!
//! - for a **surface** the voxels themselves: cell `ijk` is the cube of edge 1 centred on the
//!   sample `ijk`, and it is *occupied* where the sample is below the iso-value;
//! - for **fog** the cells of the trilinear interpolant: cell `ijk` has the samples `ijk` and
//!   `ijk + 1` at its corners, and it is occupied where one of its eight samples is above zero;
//! - for a **smooth surface** the same cells, occupied where samples lie on both sides of the
//!   iso-value.
//!
//! Samples are stored separately, only for occupied cells, and are read only where a ray meets one;
//! a surface of voxels has none. All indices are 32-bit and relative to the first of the grid's own
//! words, so that a grid can be placed anywhere in a pool. [`layout`] is the contract that the
//! shader modules mirror. [`traverse`] is the shader's traversal on the CPU, function by function,
//! for tests and for reading side by side.

mod assemble;
mod bits;
mod blocks;
mod bricks;
mod build;
mod cells;
pub(crate) mod checked;
mod content;
mod detail;
pub mod edit;
mod error;
pub mod exact;
mod grid;
mod kind;
pub mod layout;
mod lower_node;
mod mirrored_ray;
mod options;
mod palette;
mod parts;
mod ray;
pub mod rebase;
mod region;
pub(crate) mod sections;
mod skips;
mod spare;
mod thickness;
mod top_tree;
pub mod traverse;
mod values;
mod wide;

pub(crate) use bits::transposed;
pub(crate) use values::{Stored, density, distance};

pub use detail::FogDetail;
pub use error::PackError;
pub use grid::{GridHeader, PackedGrid};
pub use kind::PackKind;
pub use options::{PackOptions, PackedTogether};
pub use spare::SpareWords;
pub use values::ValueFormat;
