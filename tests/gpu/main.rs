//! The shaders without Bevy, apart from their accuracy, which the suite of `vdb_probe` is about.

mod crown;
#[path = "../common/headless.rs"]
mod headless;
mod validity;
