//! The VDB tree: a sparse, shallow tree of cubic nodes whose sizes are compile-time constants.
//!
//! A [`Tree`] is the root: a sorted map from node origin to child or tile. Below it are
//! [`InternalNode`]s, whose slots hold either a child or a *tile* (one value for the whole extent
//! of the slot), and at the bottom [`LeafNode`]s, with one value per voxel. Every value, tile or
//! voxel, is *active* or inactive. Where nothing is stored, the tree has its inactive *background*
//! value.
//!
//! The structure follows K. Museth, "VDB: High-Resolution Sparse Volumes with Dynamic Topology",
//! ACM Transactions on Graphics 32(3), 2013. All coordinates are voxels in index space, signed
//! 32-bit integers in all eight octants.

mod accessor;
mod aliases;
mod band;
mod bits;
mod coarser;
mod coords;
pub(crate) mod grow;
mod internal;
mod join;
mod leaf;
mod map;
mod mask;
mod node;
mod root;
mod stats;
mod value;
mod vector_lattice;

pub use accessor::Accessor;
pub use aliases::{BoolTree, MaskTree, Vdb543};
pub use band::trim_narrow_band;
pub use bits::{Active, BitLeaf, BitValues};
pub use coarser::{Coarsening, LevelOptions, half_resolution, voxel_in_distances};
pub(crate) use coarser::{HalfNodes, MEASURED_LEAVES, reach_of, roots_of_half, voxel_of_leaves};
pub use coords::CoordBox;
pub use glam::IVec3;
pub use internal::{InternalNode, Slot};
pub use join::join_values;
pub use leaf::LeafNode;
pub use map::{map_bits, map_values};
pub use mask::{Cube, Dim, Mask};
pub use node::{Found, Node, ValueAt};
pub use root::{RootEntry, Tree};
pub use stats::{LevelStats, TreeStats};
pub use value::Value;
pub use vector_lattice::VectorLattice;
