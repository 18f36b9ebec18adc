//! Extraction of the volumes of the app's world, every frame.

use bevy::camera::visibility::{InheritedVisibility, RenderLayers};
use bevy::core_pipeline::prepass::MotionVectorPrepass;
use bevy::light::{NotShadowCaster, NotShadowReceiver};
use bevy::math::Affine3A;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::{MainEntity, MainEntityHashMap};
use std::sync::Arc;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::tree::VectorLattice;

use super::auxiliary::AuxiliaryGrids;
use super::clip::{ExtractedClipPlanes, VolumeClip};
use super::materials::{ExtractedMaterials, MaterialRow};
use super::ramps::{ExtractedRamps, VolumeRamp};
use crate::render::gpu::GridKey;
use crate::scene::{NextFrame, Page, Share};
use crate::{
    VdbClipPlane, VdbClippedBy, VdbColorGrid, VdbEmission, VdbGrid, VdbMaterial, VdbRamp,
    VdbVectorGrid, VdbVelocity, VdbVolume, VdbVolumeQuality,
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
    /// Whether the volume is a page of a larger one.
    pub is_page: bool,
    /// Whether the volume casts shadows.
    pub casts: bool,
    /// Whether the volume receives shadows.
    pub receives: bool,
    pub layers: RenderLayers,
    /// How what is shown moves within the volume, if a camera has motion vectors.
    pub velocity: Option<ExtractedVelocity>,
    /// The auxiliary grids; none if the volume is hidden.
    pub auxiliary: AuxiliaryGrids,
    /// The ramp of a fog; none if the volume is hidden.
    pub ramp: Option<VolumeRamp>,
    /// The custom material of a surface, or of a fog without a ramp; none if the volume is hidden.
    pub own_material: Option<MaterialRow>,
    /// What cuts the volume.
    pub clip: VolumeClip,
    /// The share that a frame that fades has of what it emits.
    pub share: f32,
}

/// How what a volume shows moves within it.
#[derive(Clone, Debug)]
pub(crate) struct ExtractedVelocity {
    pub lattice: Arc<VectorLattice>,
    pub local_from_index: bevy::math::DAffine3,
    /// The displacement from the previous frame, in units of local space, per unit of the lattice's
    /// means; finite. 0 if the volume shows what it showed before.
    pub displacement: f64,
}

impl ExtractedVelocity {
    fn new(velocity: &VdbVelocity, vectors: &Assets<VdbVectorGrid>) -> Option<Self> {
        let grid = vectors.get(&velocity.grid)?;
        let lattice = grid.lattice()?.clone();
        let displacement = f64::from(velocity.scale) * f64::from(velocity.time_step);
        let displacement = displacement * f64::from(lattice.largest);
        let displacement = if displacement.is_finite() { displacement } else { 0.0 };
        Some(Self { lattice, local_from_index: grid.world_from_index(), displacement })
    }
}

/// What is read from each volume's own entity.
type SetOnEntity<'a> = (
    Entity,
    &'a VdbVolume,
    &'a GlobalTransform,
    &'a VdbMaterial,
    &'a InheritedVisibility,
    Option<&'a RenderLayers>,
    (Option<&'a VdbEmission>, Option<&'a VdbColorGrid>),
    (Has<NotShadowCaster>, Has<NotShadowReceiver>),
    (Option<&'a VdbVelocity>, Option<&'a Share>),
    (Has<NextFrame>, Has<Page>, Option<&'a ChildOf>),
);

/// What is set on a volume, or on the player or the paged volume that shows it.
type SetOnVolume<'a> =
    (Option<&'a VdbVolumeQuality>, Option<&'a VdbRamp>, Option<&'a VdbClippedBy>);

pub(crate) fn extract_volumes(
    volumes: Extract<Query<SetOnEntity>>,
    settings: Extract<Query<SetOnVolume>>,
    planes: Extract<Query<&GlobalTransform, With<VdbClipPlane>>>,
    with_motion: Extract<Query<(), With<MotionVectorPrepass>>>,
    grids: Extract<Res<Assets<VdbGrid>>>,
    vectors: Extract<Res<Assets<VdbVectorGrid>>>,
    (mut extracted, mut ramps, mut materials, mut clips): (
        ResMut<ExtractedVolumes>,
        ResMut<ExtractedRamps>,
        ResMut<ExtractedMaterials>,
        ResMut<ExtractedClipPlanes>,
    ),
    mut before: Local<MainEntityHashMap<ExtractedVolume>>,
) {
    std::mem::swap(&mut extracted.0, &mut *before);
    extracted.0.clear();
    ramps.begin_frame();
    clips.begin_frame();
    for (entity, volume, transform, material, visible, layers, auxiliary, without, motion, part) in
        &volumes
    {
        let (velocity, share) = motion;
        let share = share.map_or(1.0, |share| share.0);
        // The settings of a player are those of the frame it fades to, too, and those of a paged volume
        // are those of its pages.
        let (is_next, is_page, parent) = part;
        let set_by = parent.filter(|_| is_next || is_page).map_or(entity, |parent| parent.0);
        let (quality, ramp, clipped_by) = settings.get(set_by).unwrap_or_default();
        let quality = quality.copied().unwrap_or_default();
        let Some(grid) = grids.get(&volume.0) else { continue };
        let entity = MainEntity::from(entity);
        let world_from_local = transform.affine();
        let mut material = material.clone();
        material.density_scale *= share;
        let auxiliary = if visible.get() {
            AuxiliaryGrids::new(auxiliary, (&grids, &vectors)).with_share(share)
        } else {
            AuxiliaryGrids::default()
        };
        let is_fog = grid.kind() == PackKind::Fog;
        let ramp = ramp.filter(|_| visible.get() && is_fog).and_then(|ramp| ramps.add(ramp));
        let own_material = (visible.get() && ramp.is_none())
            .then(|| materials.add(set_by.into(), is_fog, &grid.world_from_index()))
            .flatten();
        let clipped_by = clipped_by.filter(|_| visible.get() && !is_page);
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
            quality,
            visible: visible.get(),
            is_page,
            casts: !without.0,
            receives: !without.1,
            layers: layers.cloned().unwrap_or_default(),
            velocity: velocity
                .filter(|_| visible.get() && !with_motion.is_empty())
                .and_then(|velocity| ExtractedVelocity::new(velocity, &vectors)),
            auxiliary,
            ramp,
            own_material,
            clip: clipped_by.map(|by| clips.add(by, &planes)).unwrap_or_default(),
            share,
        };
        extracted.0.insert(entity, volume);
    }
    materials.end_frame();
}
