//! The `.nvdb` file format, versions 32.x: `NanoVDB`'s trees, which are flat buffers for GPUs.
//!
//! A file is a list of segments, each with a header, the metadata of its grids, and the grids
//! themselves, compressed or not. Since version 32.6, it may also consist of grids alone (a *raw*
//! file). A grid is a buffer in which the nodes of each level are stored one after another, and each
//! node refers to its children by byte offsets. `NanoVDB`'s headers are the only specification.
//!
//! Data flows one way: [`container`] finds and decompresses the buffers, [`head`] reads the data in
//! front of a tree, [`scan`] follows and checks the offsets, and [`build`] makes the nodes on all
//! cores. [`write`] goes the other way, for floats. Nothing in a buffer is trusted: see [`scan`].

mod blind;
mod build;
mod checksum;
mod container;
mod grid;
mod head;
mod layout;
mod leaves;
mod options;
mod read;
mod scan;
mod write;

pub(crate) use container::is_nanovdb;
pub use options::{NanoVdbOptions, NanoVdbValues};
pub(crate) use read::read;
pub(crate) use write::write;
