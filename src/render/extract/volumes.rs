//! The volumes of the app's world, each frame.

use bevy::camera::visibility::{InheritedVisibility, RenderLayers};
use bevy::light::{NotShadowCaster, NotShadowReceiver};
use bevy::math::Affine3A;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::{MainEntity, MainEntityHashMap};
use std::sync::Arc;
use vdb_core::pack::{PackKind, PackedGrid};

use super::auxiliary::AuxiliaryGrids;
use crate::render::gpu::GridKey;
use crate::{
    VdbColorGrid, VdbEmission, VdbGrid, VdbMaterial, VdbVectorGrid, VdbVolume, VdbVolumeQuality,
};

/// Every volume whose grid has arrived, visible or not.
#[derive(Debug, Default, Resource)]
pub(crate) struct ExtractedVolumes(pub MainEntityHashMap<ExtractedVolume>);

impl ExtractedVolumes {
    /// The visible volumes of some layers that are not among those given, in an order of their own.
    pub fn beside(&self, seen: &[MainEntity], layers: &RenderLayers) -> Vec<MainEntity> {
        let all = self.0.iter();
        let mut beside: Vec<_> = all
            .filter(|(entity, volume)| {
                volume.visible
                    && (volume.packed.occupied.is_some() || volume.auxiliary.is_emissive())
                    && volume.layers.intersects(layers)
                    && seen.binary_search(entity).is_err()
            })
            .map(|(entity, _)| *entity)
            .collect();
        beside.sort_unstable();
        beside
    }
}

#[derive(Clone, Debug)]
pub(crate) struct ExtractedVolume {
    pub grid: GridKey,
    /// Without words where voxels are edited: those that change come by [`ExtractedEdits`](crate::render::pool).
    pub packed: Arc<PackedGrid>,
    /// Its levels of detail, where a camera asks for them; see [`VdbGrid::levels`].
    pub levels: Arc<[Arc<PackedGrid>]>,
    /// For messages.
    pub name: Arc<str>,
    pub world_from_local: Affine3A,
    /// A frame ago; of a new volume, the same.
    pub world_from_local_before: Affine3A,
    pub local_from_index: bevy::math::DAffine3,
    pub material: VdbMaterial,
    pub quality: VdbVolumeQuality,
    /// Whether it is to be shown, in the picture or not.
    pub visible: bool,
    /// Whether it throws shadows.
    pub casts: bool,
    /// Whether shadows are thrown on it.
    pub receives: bool,
    pub layers: RenderLayers,
    /// Of a volume that is not to be shown, none.
    pub auxiliary: AuxiliaryGrids,
}

pub(crate) fn extract_volumes(
    volumes: Extract<
        Query<(
            Entity,
            &VdbVolume,
            &GlobalTransform,
            &VdbMaterial,
            &InheritedVisibility,
            Option<&RenderLayers>,
            (Option<&VdbEmission>, Option<&VdbColorGrid>),
            (Has<NotShadowCaster>, Has<NotShadowReceiver>),
            Option<&VdbVolumeQuality>,
        )>,
    >,
    grids: Extract<Res<Assets<VdbGrid>>>,
    vectors: Extract<Res<Assets<VdbVectorGrid>>>,
    mut extracted: ResMut<ExtractedVolumes>,
    mut before: Local<MainEntityHashMap<ExtractedVolume>>,
) {
    std::mem::swap(&mut extracted.0, &mut *before);
    extracted.0.clear();
    for (entity, volume, transform, material, visible, layers, auxiliary, without, quality) in
        &volumes
    {
        let Some(grid) = grids.get(&volume.0) else { continue };
        let entity = MainEntity::from(entity);
        let world_from_local = transform.affine();
        let auxiliary = if visible.get() {
            AuxiliaryGrids::new(auxiliary, (&grids, &vectors), grid.kind() != PackKind::Fog)
        } else {
            AuxiliaryGrids::default()
        };
        let volume = ExtractedVolume {
            grid: volume.0.id().into(),
            packed: grid.outline(),
            levels: grid.levels().cloned().unwrap_or_default(),
            name: grid.shown_name().clone(),
            world_from_local,
            world_from_local_before: before
                .get(&entity)
                .map_or(world_from_local, |before| before.world_from_local),
            local_from_index: grid.world_from_index(),
            material: material.clone(),
            quality: quality.copied().unwrap_or_default(),
            visible: visible.get(),
            casts: !without.0,
            receives: !without.1,
            layers: layers.cloned().unwrap_or_default(),
            auxiliary,
        };
        extracted.0.insert(entity, volume);
    }
}
