//! Surfaces larger than memory: their pages are loaded and displayed as cameras need them.
//!
//! Each page is an entity of its own, a child of the paged volume, with a [`VdbVolume`](crate::VdbVolume)
//! for a cooked grid. Pages that are loaded but not displayed are hidden. They stay on the GPU, so
//! they can be displayed at once.

mod component;
mod memory;
mod select;
mod update;
mod views;

use bevy::camera::visibility::VisibilitySystems;
use bevy::prelude::*;
use bevy::transform::TransformSystems;

pub use component::{VdbPagedVolume, VdbPagesStatus};

/// Loads and displays the pages that cameras need.
pub(crate) struct PagesPlugin;

impl Plugin for PagesPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<VdbPagedVolume>().register_type::<VdbPagesStatus>().add_systems(
            PostUpdate,
            (update::drop_pages, update::update_pages, update::copy_settings)
                .chain()
                .after(TransformSystems::Propagate)
                .after(VisibilitySystems::UpdateFrusta)
                .before(VisibilitySystems::VisibilityPropagate)
                .before(VisibilitySystems::CalculateBounds),
        );
    }
}
