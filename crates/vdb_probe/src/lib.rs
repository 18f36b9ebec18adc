//! Runs the shaders of `assets/shaders` ray by ray without Bevy, on any adapter. As in Bevy, they
//! are composed by `naga_oil` and compiled without runtime checks. For tests and benchmarks, with
//! utilities that these share.

mod gpu;
pub mod judge;
pub mod options;
mod probe;
mod shaders;
mod svg;

pub use gpu::{Gpu, Kernel, NoGpu, Step};
pub use probe::{GpuGrid, Probe, ProbeHit, ProbeKind, ProbeRay};
pub use shaders::{Alterations, Defs, compose};
pub use svg::{INK, PALE, Svg};
