//! Tools that make and change volumes.
//!
//! - [`mesh_to_level_set`] – converts triangles to a narrow-band level set.
//! - [`level_set_to_mesh`] – converts an isosurface to triangles.
//! - [`points_to_fog()`] and [`points_to_level_set()`] – convert points to volumes.
//! - [`csg()`] – union, intersection and difference of level sets.
//! - [`redistance()`] – restores distances after a level set has been changed.
//! - [`offset()`] – grows or shrinks a level set.
//! - [`smooth()`] – removes details from a level set or a fog.
//! - [`fog_from_level_set()`] – makes the inside of a level set a fog.
//! - [`compose()`] – sum, maximum and product of fogs.
//! - [`resample()`] – the same volume with other voxels.
//! - [`crop()`] and [`crop_points()`] – the part inside a box.
//!
//! All of them run in parallel on rayon's threads, need neither Bevy nor a GPU, and check the
//! memory that they need against [`Limits`](crate::Limits) before allocating it.

mod build;
mod combine;
mod compose;
mod crop;
mod crop_points;
mod csg;
mod error;
mod fog;
mod from_mesh;
mod grid;
mod nodes;
mod offset;
mod places;
mod points;
mod redistance;
mod resample;
mod samples;
mod smooth;
mod to_mesh;

pub use compose::{Composition, compose};
pub(crate) use crop::voxels_within;
pub use crop::{Crop, crop};
pub use crop_points::crop_points;
pub use csg::{CsgOperation, csg};
pub use error::ToolError;
pub use fog::{FogFromLevelSet, fog_from_level_set};
pub use from_mesh::{InsideRule, MeshToLevelSet, mesh_to_level_set};
pub use offset::{Offset, offset};
pub use points::{PointNumber, PointsToFog, PointsToLevelSet, points_to_fog, points_to_level_set};
pub use redistance::{Redistance, redistance};
pub use resample::{Interpolation, Resample, resample};
pub use smooth::{Filter, Smooth, smooth};
pub use to_mesh::{LevelSetToMesh, TriangleMesh, level_set_to_mesh};
