//! Players of sequences: they load frames ahead and show them in time.

mod ahead;
mod cache;
mod clock;
mod component;
mod fade;
mod frames;
mod load;
mod order;
mod play;
mod playback;
mod show;
mod status;

use bevy::asset::AssetEventSystems;
use bevy::camera::visibility::VisibilitySystems;
use bevy::prelude::*;

pub use component::{VdbFrameBlend, VdbLateFrames, VdbPlayer};
pub use frames::{VdbFrameCache, VdbFrameCacheUsage};
pub use status::{VdbFrameFailed, VdbPlayerFinished, VdbPlayerStatus};

pub(crate) use ahead::FramesInMemory;
pub(crate) use fade::{NextFrame, Share};
pub(crate) use playback::Playback;

use crate::VdbRepeat;

/// The systems of [`VdbPlayer`]s, in `PostUpdate`: they follow the seeks and settings of `Update`,
/// and set the grids of volumes before Bevy computes bounds.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct VdbPlayerSystems;

/// Plays sequences.
pub(super) struct PlayerPlugin;

impl Plugin for PlayerPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<VdbPlayer>()
            .register_type::<VdbPlayerStatus>()
            .register_type::<VdbLateFrames>()
            .register_type::<VdbFrameBlend>()
            .register_type::<VdbRepeat>()
            .register_type::<VdbFrameCache>()
            .register_type::<VdbFrameCacheUsage>()
            .init_resource::<VdbFrameCache>()
            .init_resource::<VdbFrameCacheUsage>()
            .init_resource::<frames::Frames>()
            .configure_sets(
                PostUpdate,
                VdbPlayerSystems
                    .after(AssetEventSystems)
                    .before(VisibilitySystems::CalculateBounds),
            )
            .add_systems(
                PostUpdate,
                (load::follow_loads, play::play, fade::fade, load::load_frames)
                    .chain()
                    .in_set(VdbPlayerSystems),
            );
    }
}
