//! Point lights that represent the light an emissive grid sheds on its surroundings.
//!
//! [`ValueBlocks`] summarises the values of the grid in blocks, [`DensityCubes`] summarises the smoke
//! around them, and [`EscapeDepths`] measures how deep in the smoke each block is; all three depend
//! only on the grids. For a given emission, [`ValueBlocks::sources`] then gives the light of each
//! block, [`EscapeDepths::escaping`] the part that escapes the smoke, and [`fit_lamps`] the few point
//! lights, fast enough to follow a fire that changes in every frame.

mod cells;
mod depths;
mod fit;
mod values;

pub use depths::{DensityCubes, EscapeDepths, Smoke};
pub use fit::{Lamp, fit_lamps};
pub use values::{Source, ValueBlocks};
