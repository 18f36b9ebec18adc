//! The tracers for OpenVDB's standard tree, instantiated in this crate. A generic function is
//! otherwise compiled in the calling crate, and development builds of tests are hardly optimised
//! but have to judge millions of rays.

use super::{Blocky, Estimate, Fog, Ray, Smooth, SurfaceHit, SurfaceVerdict, VoxelHit};
use crate::tree::{InternalNode, LeafNode};

/// The children of the root of a [`Vdb543`](crate::tree::Vdb543) of floats.
pub type Upper = InternalNode<InternalNode<LeafNode<f32, 3>, 4>, 5>;

/// [`Blocky::first_voxel`].
pub fn first_voxel(tracer: &Blocky<'_, Upper>, ray: &Ray) -> Option<VoxelHit> {
    tracer.first_voxel(ray)
}

/// [`Smooth::judge_within`].
pub fn judge(
    tracer: &Smooth<'_, Upper>,
    ray: &Ray,
    answer: Option<f64>,
    noise: f64,
    reach: f64,
) -> (SurfaceVerdict, Option<SurfaceHit>) {
    tracer.judge_within(ray, answer, noise, reach)
}

/// [`Fog::optical_depth`].
pub fn optical_depth(tracer: &Fog<'_, Upper>, ray: &Ray) -> Estimate {
    tracer.optical_depth(ray)
}
