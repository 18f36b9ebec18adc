//! The lights of fires that surfaces reflect by rays.

use bevy::pbr::GlobalClusterableObjectMeta;
use bevy::prelude::*;

use super::state::ViewState;
use crate::quality::features::Features;
use crate::render::extract::ExtractedFireLights;
use crate::render::gpu::types::MAX_FIRE_LIGHTS;

/// Tells the shaders which of Bevy's lights stand for a fire: reflected rays see the fire itself.
pub(super) fn list_fire_lights(
    fires: Res<ExtractedFireLights>,
    meta: Option<Res<GlobalClusterableObjectMeta>>,
    mut views: Query<&mut ViewState>,
) {
    let Some(meta) = meta.filter(|_| !fires.0.is_empty()) else { return };
    let indices = fires.0.iter().filter_map(|light| meta.entity_to_index.get(light));
    let indices: Vec<u32> = indices.take(MAX_FIRE_LIGHTS).map(|&index| index as u32).collect();
    for mut state in &mut views {
        let Some(prepared) = &mut state.prepared else { continue };
        if prepared.key.has(Features::FIRE_LIGHTS) {
            prepared.data.fire_light_count = indices.len() as u32;
            for (i, index) in indices.iter().enumerate() {
                prepared.data.fire_lights[i / 4][i % 4] = *index;
            }
        }
    }
}
