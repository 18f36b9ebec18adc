//! Writing float grids, with the layout, the boxes and the statistics that `NanoVDB`'s own converter
//! gives them.

mod buffer;
mod file;
mod leaf;
mod nodes;
mod statistics;

pub(crate) use file::write;
