//! The shaders of `assets/shaders`, run ray by ray without Bevy: composed by `naga_oil` and compiled
//! unchecked, as Bevy does, on whatever adapter there is. For tests and benchmarks, with what else those
//! have in common.

mod gpu;
pub mod options;
mod probe;
mod shaders;
mod svg;

pub use gpu::{Gpu, Kernel, NoGpu, Step};
pub use probe::{GpuGrid, Probe, ProbeHit, ProbeKind, ProbeRay};
pub use shaders::{Defs, compose};
pub use svg::{INK, PALE, Svg};
