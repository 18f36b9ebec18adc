//! Bounding boxes, so that Bevy's culling applies to volumes.

use bevy::camera::primitives::Aabb;
use bevy::prelude::*;

use crate::{VdbGrid, VdbVolume};

/// Gives a volume the box of its grid once the grid is there, and again when either changes.
pub(crate) fn update_bounds(
    mut commands: Commands,
    mut events: MessageReader<AssetEvent<VdbGrid>>,
    grids: Res<Assets<VdbGrid>>,
    volumes: Query<(Entity, Ref<VdbVolume>, Option<&Aabb>)>,
) {
    let changed: Vec<AssetId<VdbGrid>> = events
        .read()
        .filter_map(|event| match event {
            AssetEvent::Added { id } | AssetEvent::Modified { id } => Some(*id),
            _ => None,
        })
        .collect();
    for (entity, volume, aabb) in &volumes {
        if !volume.is_changed() && !changed.contains(&volume.0.id()) {
            continue;
        }
        let bounds = grids.get(&volume.0).and_then(VdbGrid::world_bounds);
        match (bounds, aabb) {
            (Some((low, high)), _) => {
                let aabb = Aabb::from_min_max(low.as_vec3(), high.as_vec3());
                commands.entity(entity).insert(aabb);
            }
            // Not there yet: the box of another grid would cull this one wrongly.
            (None, Some(_)) => {
                commands.entity(entity).remove::<Aabb>();
            }
            (None, None) => {}
        }
    }
}
