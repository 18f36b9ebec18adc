//! Tools that make and change volumes.
//!
//! - [`mesh_to_level_set`] – converts triangles to a narrow-band level set.
//! - [`level_set_to_mesh`] – converts an isosurface to triangles.
//! - [`csg()`] – union, intersection and difference of level sets.
//! - [`redistance()`] – restores distances after a level set has been changed.
//!
//! All of them run in parallel on rayon's threads, need neither Bevy nor a GPU, and check the
//! memory that they need against [`Limits`](crate::Limits) before allocating it.

mod csg;
mod error;
mod from_mesh;
mod redistance;
mod to_mesh;

pub use csg::{CsgOperation, csg};
pub use error::ToolError;
pub use from_mesh::{InsideRule, MeshToLevelSet, mesh_to_level_set};
pub use redistance::{Redistance, redistance};
pub use to_mesh::{LevelSetToMesh, TriangleMesh, level_set_to_mesh};
