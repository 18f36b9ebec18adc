//! The reference tracer: what a ray meets in a tree, on the CPU, slowly and right. It judges the
//! shaders, so it shares nothing with `pack` or with them; it reads [`tree`](crate::tree) alone.
//!
//! # Conventions
//!
//! - *Index space*: the sample `ijk` of a grid sits at the point `(i, j, k)`.
//! - The *voxel* `ijk`, as a box, is the cube centred there, half-open: `[ijk - 1/2, ijk + 1/2)`.
//! - The trilinear *cell* `ijk` is the cube `[ijk, ijk + 1]` between the samples `ijk + {0, 1}³`.
//! - A [`Ray`] is `p(t) = cell + frac + t · dir` in index space, in the very f32 numbers that a
//!   shader gets; they are taken for exact.
//! - Outside of the 32-bit index space there are no voxels and no cells; the cells at its upper end see
//!   the background there. Where the root of a tree has no entry there are no voxels.
//! - A negative `t_min` counts as 0. A ray whose direction's largest component is not from 2⁻³⁰ to 2³⁰ in
//!   size, or that ends before it begins, meets nothing.
//!
//! # What there is
//!
//! - [`first_voxel`]: the first occupied voxel and the face entered, exact.
//! - [`first_root`], [`trace_surface`]: the first root of the trilinear interpolant, certified.
//! - [`optical_depth`], [`transmittance`]: through the trilinear density, integrated exactly cell by
//!   cell; [`optical_depth_nearest`] through voxels of constant density.
//! - [`radiance()`]: emitted light, and light of the sun scattered once, to a tolerance.
//! - [`emitted`]: the light that one grid sends through the fog of another, to a tolerance.
//! - [`Paths`]: light scattered any number of times, by paths drawn at random.
//! - [`Blocky::judge`], [`Smooth::judge`]: what another tracer's answer is worth.
//! - [`mod@picture`]: whole pictures of several volumes, for a machine without a GPU.

mod blocky;
mod cells;
mod cubic;
mod emission;
mod field;
mod fog;
mod judge;
mod paths;
pub mod picture;
mod planes;
mod radiance;
mod ray;
mod smooth;
pub mod standard;
mod walk;
mod wide;

pub use blocky::{Blocky, Face, Occupied, VoxelHit, first_voxel};
pub use emission::{Dimming, emitted};
pub use fog::{Estimate, Fog, density, optical_depth, optical_depth_nearest, transmittance};
pub use judge::{SurfaceVerdict, VoxelVerdict};
pub use paths::{Mean, PathLight, Paths, Scattering};
pub use radiance::{Medium, Radiance, Sun, phase, radiance};
pub use ray::Ray;
pub use smooth::{Graze, Smooth, SurfaceHit, SurfaceTrace, first_root, trace_surface};
