//! Volumes as entities: their components, bounds and states, players of sequences, and ray casts on the CPU.

mod bounds;
mod clip;
mod components;
mod emission;
mod emission_light;
mod lost_grids;
mod material_extension;
#[cfg(feature = "picking")]
mod picking;
mod player;
mod ramp;
mod roles;
mod spatial_query;
pub(crate) mod track;
mod volume_state;

use bevy::asset::{AssetEventSystems, AssetTrackingSystems};
use bevy::camera::visibility::VisibilitySystems;
use bevy::prelude::*;

pub(crate) use clip::ClipPlane;
pub use clip::{VdbClipPlane, VdbClippedBy};
pub(crate) use components::Page;
pub use components::{
    VdbCamera, VdbMaterial, VdbOverlays, VdbRenderMode, VdbSun, VdbTraversal, VdbVolume,
};
pub use emission::{VdbColorGrid, VdbEmission, VdbVelocity};
pub(crate) use emission_light::FireLight;
pub use emission_light::VdbEmissionLight;
pub use material_extension::VdbMaterialExtension;
#[cfg(feature = "picking")]
pub use picking::{VdbPickingPlugin, VdbPickingSettings};
pub(crate) use player::{NextFrame, Share};
pub use player::{
    VdbFrameBlend, VdbFrameCache, VdbFrameCacheUsage, VdbFrameFailed, VdbLateFrames, VdbPlayer,
    VdbPlayerFinished, VdbPlayerStatus, VdbPlayerSystems,
};
pub use ramp::{VdbRamp, VdbRampStop};
pub use roles::VdbRoles;
pub use spatial_query::{VdbRayCastSettings, VdbRayHit, VdbRayVisibility, VdbSpatialQuery};
pub use volume_state::{VdbVolumeDrawn, VdbVolumeState};

/// Keeps the bounds and states of volumes up to date.
pub(crate) struct ScenePlugin;

impl Plugin for ScenePlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins((player::PlayerPlugin, emission_light::EmissionLightPlugin));
        app.register_type::<VdbVolume>()
            .register_type::<VdbVolumeState>()
            .register_type::<VdbMaterial>()
            .register_type::<VdbColorGrid>()
            .register_type::<VdbEmission>()
            .register_type::<VdbRamp>()
            .register_type::<VdbClipPlane>()
            .register_type::<VdbClippedBy>()
            .register_type::<VdbVelocity>()
            .register_type::<VdbCamera>()
            .register_type::<VdbSun>()
            .add_systems(PreUpdate, track::update_states.after(AssetTrackingSystems))
            .add_systems(Update, lost_grids::tell_of_lost_grids)
            .add_systems(
                PostUpdate,
                bounds::update_bounds
                    .in_set(VisibilitySystems::CalculateBounds)
                    .after(AssetEventSystems),
            );
        // Every camera has its settings as a component. Bevy refuses this once a camera has been
        // spawned; cameras without the component are treated as if they had the default.
        app.try_register_required_components::<Camera3d, VdbCamera>().ok();
    }
}
