//! Trees of files that are not read as a whole: the offsets of their nodes are in memory, and nodes are
//! read when they are needed.

mod file;
mod input;
mod spool;
mod tree;

pub use file::{StreamedFile, StreamedGrid};
pub(crate) use spool::{EncodedNode, Spool};
pub(crate) use tree::StreamedTree;
