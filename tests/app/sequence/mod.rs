//! Players of sequences, without a renderer: which frame is shown when, what is in memory, and what happens to
//! frames that cannot be loaded.

mod blend;
mod faults;
mod load;
mod memory;
mod play;
mod roles;
mod stage;
