//! The reference tracer: exact ray casts through a tree on the CPU, regardless of speed. It judges
//! the shaders, so it shares no code with them or with `pack`, and depends on [`tree`](crate::tree)
//! alone.
//!
//! # Conventions
//!
//! - *Index space*: sample `ijk` of a grid is at the point `(i, j, k)`.
//! - *Voxel* `ijk`, as a box, is the half-open cube centred there: `[ijk - 1/2, ijk + 1/2)`.
//! - The trilinear *cell* `ijk` is the cube `[ijk, ijk + 1]` between the samples `ijk + {0, 1}³`.
//! - A [`Ray`] is `p(t) = cell + frac + t · dir` in index space, with exactly the f32 numbers that
//!   a shader gets.
//! - Outside the 32-bit index space there are no voxels and no cells; the cells at its upper end
//!   see the background there. Where the root of a tree has no entry there are no voxels.
//! - A negative `t_min` counts as 0. A ray hits nothing if the largest component of its direction
//!   is not between 2⁻³⁰ and 2³⁰ in magnitude, or if it ends before it begins.
//!
//! # Contents
//!
//! - [`first_voxel`]: the first occupied voxel and the face entered, exact.
//! - [`first_root`], [`trace_surface`]: the first root of the trilinear interpolant, certified.
//! - [`optical_depth`], [`transmittance`]: through trilinear density, integrated exactly cell by
//!   cell; [`optical_depth_nearest`] through voxels of constant density.
//! - [`radiance()`]: emission and single scattering of sunlight, to a tolerance.
//! - [`emitted`]: the light that one grid emits through the fog of another, to a tolerance.
//! - [`Fog::transferred`]: fog whose extinction, albedo and emission depend on a value, in small steps.
//! - [`Paths`]: multiple scattering, by path tracing.
//! - [`Blocky::judge`], [`Smooth::judge`]: verdicts on the answers of another tracer.
//! - [`mod@picture`]: images of several volumes, for machines without a GPU.

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
mod transfer;
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
pub use transfer::{Optics, Transferred};
