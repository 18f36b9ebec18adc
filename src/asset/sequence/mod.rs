//! Sequences of files as assets: smoke, fire or water, with one file per frame.

mod error;
mod frames;
mod list;
mod loader;
mod pattern;
mod text;

pub use error::VdbSequenceError;
pub use frames::{VdbFrame, VdbRepeat, VdbSequence};
pub use list::VdbAssetServerExt;
pub use loader::VdbSequenceLoader;

pub(crate) use frames::{DEFAULT_RATE, is_rate};
pub(crate) use loader::ListingServer;
