//! Bounding boxes of volumes, for Bevy's culling.

use bevy::camera::primitives::Aabb;
use bevy::prelude::*;

use crate::{VdbEmission, VdbGrid, VdbVectorGrid, VdbVolume};

/// Sets the [`Aabb`] of a volume to the bounds of its grid and its emission once they are loaded,
/// and updates it when one of them changes.
pub(crate) fn update_bounds(
    mut commands: Commands,
    mut events: MessageReader<AssetEvent<VdbGrid>>,
    mut vector_events: MessageReader<AssetEvent<VdbVectorGrid>>,
    mut gone_out: RemovedComponents<VdbEmission>,
    (grids, vectors): (Res<Assets<VdbGrid>>, Res<Assets<VdbVectorGrid>>),
    volumes: Query<(Entity, Ref<VdbVolume>, Option<Ref<VdbEmission>>, Option<&Aabb>)>,
) {
    let changed: Vec<AssetId<VdbGrid>> = events.read().filter_map(arrived).collect();
    let changed_vectors: Vec<AssetId<VdbVectorGrid>> =
        vector_events.read().filter_map(arrived).collect();
    let gone_out: Vec<Entity> = gone_out.read().collect();
    for (entity, volume, emission, aabb) in &volumes {
        let emission_changed = emission.as_ref().is_some_and(|emission| {
            emission.is_changed()
                || match &**emission {
                    VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
                        changed.contains(&grid.id())
                    }
                    VdbEmission::Color { grid, .. } => changed_vectors.contains(&grid.id()),
                }
        });
        let same = !volume.is_changed() && !changed.contains(&volume.0.id());
        if same && !emission_changed && !gone_out.contains(&entity) {
            continue;
        }
        let own = grids.get(&volume.0).and_then(VdbGrid::world_bounds);
        let shining = emission.as_deref().and_then(|emission| match emission {
            VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
                grids.get(grid).and_then(VdbGrid::world_bounds)
            }
            VdbEmission::Color { grid, .. } => {
                vectors.get(grid).and_then(VdbVectorGrid::world_bounds)
            }
        });
        let both = own.into_iter().chain(shining);
        let bounds = both.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        match (bounds, aabb) {
            (Some((low, high)), _) => {
                let aabb = Aabb::from_min_max(low.as_vec3(), high.as_vec3());
                commands.entity(entity).insert(aabb);
            }
            // The grid has not been loaded; the box of the previous one would cull it wrongly.
            (None, Some(_)) => {
                commands.entity(entity).remove::<Aabb>();
            }
            (None, None) => {}
        }
    }
}

/// The asset that an event reports as loaded or reloaded.
fn arrived<A: Asset>(event: &AssetEvent<A>) -> Option<AssetId<A>> {
    match event {
        AssetEvent::Added { id } | AssetEvent::Modified { id } => Some(*id),
        _ => None,
    }
}
