//! Extraction from the app's world to the render world.

mod auxiliary;
mod changes;
mod clip;
mod hash;
mod lights;
mod materials;
mod ramps;
mod volumes;
mod warnings;

use bevy::prelude::*;
use bevy::render::{ExtractSchedule, RenderApp};

pub(super) use auxiliary::AuxiliaryGrid;
pub(super) use changes::SceneChanges;
pub(super) use clip::ExtractedClipPlanes;
pub(super) use lights::{ExtractedEnvironment, ExtractedFireLights, ExtractedSuns, MeshCasters};
pub(super) use materials::{ExtractedMaterials, MaterialRow, ROW_WORDS};
pub(super) use ramps::{ExtractedRamp, ExtractedRamps};
pub(super) use volumes::{ExtractedVelocity, ExtractedVolume, ExtractedVolumes};
pub(super) use warnings::{Setting, Trouble, Warned};

pub use materials::VdbMaterialPlugin;

/// Extracts volumes, light properties that Bevy does not extract, and changes in the scene.
pub(crate) struct ExtractPlugin;

impl Plugin for ExtractPlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .init_resource::<ExtractedVolumes>()
            .init_resource::<ExtractedRamps>()
            .init_resource::<ExtractedClipPlanes>()
            .init_resource::<ExtractedMaterials>()
            .init_resource::<ExtractedSuns>()
            .init_resource::<ExtractedFireLights>()
            .init_resource::<MeshCasters>()
            .init_resource::<Warned>()
            .init_resource::<SceneChanges>()
            .configure_sets(
                ExtractSchedule,
                materials::ExtractMaterials
                    .after(materials::begin_materials)
                    .before(volumes::extract_volumes),
            )
            .add_systems(
                ExtractSchedule,
                (
                    materials::begin_materials.before(volumes::extract_volumes),
                    volumes::extract_volumes,
                    lights::extract_suns,
                    lights::extract_fire_lights,
                    lights::extract_mesh_casters,
                    lights::extract_environments,
                    changes::extract_changes,
                ),
            );
    }
}
