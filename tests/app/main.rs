//! Apps without a window and without a GPU: what the plugin does besides drawing.

mod assets;
mod colors;
mod cooked;
#[cfg(feature = "picking")]
#[path = "../common/headless.rs"]
mod headless;
#[path = "../common/log.rs"]
mod log;
mod meshes;
#[cfg(feature = "picking")]
mod picking;
mod points;
mod sequence;
mod spatial_query;
