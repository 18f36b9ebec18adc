//! The shaders without Bevy, apart from their accuracy, which `tests/accuracy` is about.

mod crown;
mod validity;
