//! OpenVDB trees in Rust: the `.vdb` and `.nvdb` file formats, the tree, its packing for the GPU, and an f64
//! reference tracer. Independent of Bevy and of GPUs, so it builds, tests and fuzzes in seconds.
//!
//! Data flows one way: file bytes → [`VdbFile::read`] → [`tree`] → [`pack`] → [`query`].
//! `reference` depends on [`tree`] alone, and can therefore judge everything built on `pack`.

#![deny(missing_docs)]

/// Compiles the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub mod between;
mod blackbody;
mod codec;
mod compression;
pub mod cooked;
pub mod display;
pub mod emitters;
mod error;
mod floats;
mod format;
#[cfg(fuzzing)]
pub mod fuzzing;
mod grid;
mod limits;
mod metadata;
mod nanovdb;
pub mod pack;
pub mod pages;
mod points;
pub mod query;
mod ramp;
pub mod reference;
pub mod roles;
pub mod scattering;
pub mod synth;
pub mod tools;
mod transform;
pub mod tree;
pub mod view;
mod work;

pub use blackbody::{BlackbodyTable, blackbody};
pub use compression::{Codec, Compression};
pub use error::{Error, Place};
pub use floats::ConvertedGrid;
pub use format::{FileBuffer, save_bytes};
pub use grid::{
    AnyTree, Grid, GridClass, GridSelection, ProgressFn, ReadOptions, SkippedGrid, VdbFile,
    WriteOptions,
};
pub use limits::Limits;
pub use metadata::{MetaValue, Metadata};
pub use nanovdb::{NanoVdbOptions, NanoVdbValues};
pub use points::{PointAttribute, PointGrid, PointGroup, PointValues, Points};
pub use ramp::{Ramp, RampPoint, RampStop, RampTable};
pub use transform::Transform;
