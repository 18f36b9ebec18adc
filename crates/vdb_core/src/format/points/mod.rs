//! Grids of points.
//!
//! The tree of a grid of points is stored like any other. Its leaves have more than one buffer, and
//! the file has them in passes: each pass goes over all leaves. The passes are
//!
//! 1. the compressed bytes of each leaf's voxels,
//! 2. the attributes of each leaf (`descriptor`), and the length of each of its arrays (`arrays`),
//! 3. for each attribute, the lengths of its pages,
//! 4. the voxels of each leaf: the number of points up to and including each voxel,
//! 5. for each attribute, its pages.
//!
//! A page has the arrays of consecutive leaves, up to a megabyte, compressed as a whole. Files
//! without Blosc compression have no pages, but the array of each leaf in the last passes.
//!
//! As for other trees, one pass over the bytes locates everything and checks it against the limits;
//! then `build` decompresses pages on all cores.
//!
//! Writing sorts points into voxels (`place`), and encodes and compresses them (`encode`, `write`).

mod arrays;
mod build;
mod codecs;
mod descriptor;
mod encode;
mod place;
mod scan;
mod write;

pub(crate) use place::Layout;
pub(crate) use scan::scan;
pub(crate) use write::write;
