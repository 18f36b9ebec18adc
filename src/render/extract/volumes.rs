//! Extraction of the volumes of the app's world, every frame.

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
use crate::scene::Share;
use crate::{
    VdbColorGrid, VdbEmission, VdbGrid, VdbMaterial, VdbVectorGrid, VdbVolume, VdbVolumeQuality,
};

/// All volumes whose grids have been loaded, visible or not.
#[derive(Debug, Default, Resource)]
pub(crate) struct ExtractedVolumes(pub MainEntityHashMap<ExtractedVolume>);

impl ExtractedVolumes {
    /// The visible volumes of some layers that are not in `seen`, sorted by entity.
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
    /// The packed grid; without words if its voxels are edited, whose changes come through
    /// [`ExtractedEdits`](crate::render::pool).
    pub packed: Arc<PackedGrid>,
    /// The levels of detail, if a camera asks for them; see [`VdbGrid::levels`].
    pub levels: Arc<[Arc<PackedGrid>]>,
    /// The grid's name, for messages.
    pub name: Arc<str>,
    pub world_from_local: Affine3A,
    /// The transform of the previous frame; for a new volume, that of this frame.
    pub world_from_local_before: Affine3A,
    pub local_from_index: bevy::math::DAffine3,
    pub material: VdbMaterial,
    pub quality: VdbVolumeQuality,
    /// Whether the volume is not hidden, in view or not.
    pub visible: bool,
    /// Whether the volume casts shadows.
    pub casts: bool,
    /// Whether the volume receives shadows.
    pub receives: bool,
    pub layers: RenderLayers,
    /// The auxiliary grids; none if the volume is hidden.
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
            (Option<&VdbVolumeQuality>, Option<&Share>),
        )>,
    >,
    grids: Extract<Res<Assets<VdbGrid>>>,
    vectors: Extract<Res<Assets<VdbVectorGrid>>>,
    mut extracted: ResMut<ExtractedVolumes>,
    mut before: Local<MainEntityHashMap<ExtractedVolume>>,
) {
    std::mem::swap(&mut extracted.0, &mut *before);
    extracted.0.clear();
    for (entity, volume, transform, material, visible, layers, auxiliary, without, settings) in
        &volumes
    {
        let (quality, share) = settings;
        let share = share.map_or(1.0, |share| share.0);
        let Some(grid) = grids.get(&volume.0) else { continue };
        let entity = MainEntity::from(entity);
        let world_from_local = transform.affine();
        let mut material = material.clone();
        material.density_scale *= share;
        let auxiliary = if visible.get() {
            let is_surface = grid.kind() != PackKind::Fog;
            AuxiliaryGrids::new(auxiliary, (&grids, &vectors), is_surface).with_share(share)
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
            material,
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
