//! Procedural grids for tests and benchmarks: every voxel follows from a formula, so that a reader,
//! a tracer or another program can be checked without a file.
//!
//! Lengths are in voxels of index space: the sample `ijk` is at the point `(i, j, k)`. Each grid is
//! made by one [`build`] over a box of voxels; where the formula is uniform over a whole node, the
//! node becomes a tile, at every level of the tree.
//!
//! - [`level_set`](mod@level_set) – narrow-band signed distances, as after OpenVDB's signed flood fill.
//! - [`fog`](mod@fog) – densities.
//! - [`models`](mod@models) – objects that look the same at any size, for benchmarks.
//! - [`rays`](mod@rays) – rays through all of these on which decisions are hard.
//! - [`sparse`](mod@sparse) – isolated voxels, thin walls and patterns that are hard to traverse.

mod build;
pub mod fog;
pub mod level_set;
pub mod models;
mod random;
pub mod rays;
pub mod sparse;

pub use build::{Uniform, build};
pub use random::Random;
