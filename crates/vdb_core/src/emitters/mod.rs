//! Point lights that stand for what an emissive grid sheds on its surroundings.
//!
//! [`ValueBlocks`] summarises the values of the grid by place, [`DensityCubes`] the smoke around
//! them, and [`EscapeDepths`] how deep in the smoke each block is; all three depend on the grids
//! alone. [`ValueBlocks::sources`] is then the light of each block for an emission,
//! [`EscapeDepths::escaping`] what smoke leaves of it, and [`fit_lamps`] the few lights: fast enough
//! to follow a fire that changes in every frame.

mod cells;
mod depths;
mod fit;
mod values;

pub use depths::{DensityCubes, EscapeDepths, Smoke};
pub use fit::{Lamp, fit_lamps};
pub use values::{Source, ValueBlocks};
