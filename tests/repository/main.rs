//! The repository itself: what its sources and its documentation must keep to. Nothing of Bevy is run.

mod guide;
mod ignored;
mod imports;
mod links;
mod portable;
