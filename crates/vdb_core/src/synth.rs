//! Procedural grids for tests and benchmarks: shapes whose every voxel follows from a formula, so
//! that a reader, a tracer or another program can be checked without a file.
//!
//! Lengths are voxels in index space: the sample `ijk` sits at the point `(i, j, k)`. A grid is made
//! of one [`build`] over a box of voxels; what the formula says is uniform over a whole node becomes
//! a tile of that node's level, at every level of the tree.
//!
//! - [`mod@level_set`], narrow-band signed distances, as OpenVDB leaves them after its signed flood fill.
//! - [`mod@fog`], densities.
//! - [`mod@models`], objects that look the same at any size, for benchmarks.
//! - [`mod@rays`]: rays through all of these that are hard to decide.
//! - [`mod@sparse`], few voxels, thin walls and patterns that are hard on a traversal.

mod build;
pub mod fog;
pub mod level_set;
pub mod models;
mod random;
pub mod rays;
pub mod sparse;

pub use build::{Uniform, build};
pub use random::Random;
