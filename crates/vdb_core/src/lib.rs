//! OpenVDB trees in Rust: the `.vdb` file format, the tree, its packing for the GPU and an f64
//! reference tracer. No Bevy and no GPU in here, so that it builds, tests and fuzzes in seconds.
//!
//! Data flows one way: file bytes → [`format`] (with [`codec`]) → [`tree`] → `pack`; `reference`
//! hangs off [`tree`] alone, so that it can judge everything built on `pack`.

pub mod pack;
pub mod reference;
pub mod synth;
pub mod tree;
