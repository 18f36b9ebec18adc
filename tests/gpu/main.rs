//! The shaders without Bevy, apart from their accuracy, which the suite of `vdb_probe` is about.

mod compose;
#[path = "../common/headless.rs"]
mod headless;
mod size;
mod top_tree;
mod validity;
mod variants;
