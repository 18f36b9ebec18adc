//! What the renderer takes from the app's world each frame.

use bevy::camera::visibility::{InheritedVisibility, RenderLayers};
use bevy::light::{NotShadowCaster, NotShadowReceiver};
use bevy::math::Affine3A;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::{MainEntity, MainEntityHashMap, RenderEntity};
use std::sync::Arc;
use vdb_core::pack::{PackKind, PackedGrid};

use super::extras::Extras;
use super::gpu_tree::{GridKey, VdbTreePool};
use crate::{
    VdbColorGrid, VdbEmission, VdbGrid, VdbMaterial, VdbSun, VdbVectorGrid, VdbVolume,
    VdbVolumeQuality,
};

/// Every volume whose grid has arrived, visible or not.
#[derive(Debug, Default, Resource)]
pub(super) struct ExtractedVolumes(pub MainEntityHashMap<ExtractedVolume>);

impl ExtractedVolumes {
    /// The visible volumes of some layers that are not among those given, in an order of their own.
    pub fn beside(&self, seen: &[MainEntity], layers: &RenderLayers) -> Vec<MainEntity> {
        let all = self.0.iter();
        let mut beside: Vec<_> = all
            .filter(|(entity, volume)| {
                volume.visible
                    && (volume.packed.occupied.is_some() || volume.extras.shines())
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
pub(super) struct ExtractedVolume {
    pub grid: GridKey,
    /// Without words where voxels are edited: those that change come by [`super::edits`].
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
    pub extras: Extras,
}

impl ExtractedVolume {
    /// Whether there is something to see of it on the GPU.
    pub fn is_there(&self, pool: &VdbTreePool) -> bool {
        (self.packed.occupied.is_some() && pool.index(self.grid).is_some())
            || self
                .extras
                .emission
                .iter()
                .any(|part| part.packed.occupied.is_some() && pool.index(part.key).is_some())
    }
}

pub(super) fn extract_volumes(
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
    for (entity, volume, transform, material, visible, layers, extras, without, quality) in &volumes
    {
        let Some(grid) = grids.get(&volume.0) else { continue };
        let entity = MainEntity::from(entity);
        let world_from_local = transform.affine();
        let extras = if visible.get() {
            Extras::new(extras, (&grids, &vectors), grid.kind() != PackKind::Fog)
        } else {
            Extras::default()
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
            extras,
        };
        extracted.0.insert(entity, volume);
    }
}

/// The directional lights that shine on volumes otherwise than on meshes.
#[derive(Clone, Debug, Default, Resource)]
pub(super) struct ExtractedSuns(pub Vec<ExtractedSun>);

#[derive(Clone, Copy, Debug)]
pub(super) struct ExtractedSun {
    /// To the light in world space, to the bit as Bevy has it.
    pub direction: Vec3,
    /// Of its illuminance.
    pub factor: f32,
    /// Radians; without rays to the light, 0.
    pub angular_diameter: f32,
    pub samples: u32,
}

/// Radians; a wider sun's shadows are all edge.
const WIDEST_SUN: f32 = 1.0;
const MOST_SAMPLES: u32 = 256;

pub(super) fn extract_suns(
    lights: Extract<
        Query<(&GlobalTransform, &VdbSun, &InheritedVisibility), With<DirectionalLight>>,
    >,
    mut extracted: ResMut<ExtractedSuns>,
) {
    let sound = |sun: &VdbSun| {
        (0.0..=WIDEST_SUN).contains(&sun.angular_diameter)
            && (1..=MOST_SAMPLES).contains(&sun.samples)
    };
    if lights.iter().any(|(_, sun, _)| !sound(sun)) {
        warn_once!(
            "a VdbSun shines with the nearest values that make sense: give it an angular_diameter from 0 \
             to 1 and samples from 1 to 256"
        );
    }
    let suns = lights.iter().filter(|(_, sun, visible)| {
        visible.get() && (sun.intensity != 1.0 || sun.angular_diameter > 0.0)
    });
    extracted.0.clear();
    extracted.0.extend(suns.map(|(transform, sun, _)| ExtractedSun {
        direction: transform.back().into(),
        factor: non_negative(sun.intensity),
        angular_diameter: non_negative(sun.angular_diameter).min(WIDEST_SUN),
        samples: sun.samples.clamp(1, MOST_SAMPLES),
    }));
}

/// The environment maps of a camera: a component of render entities.
#[derive(Clone, Copy, Component, Debug, PartialEq)]
pub(super) struct ExtractedEnvironment {
    pub diffuse: AssetId<Image>,
    pub specular: AssetId<Image>,
}

pub(super) fn extract_environments(
    mut commands: Commands,
    cameras: Extract<Query<(RenderEntity, Option<&EnvironmentMapLight>), With<Camera3d>>>,
) {
    for (entity, maps) in &cameras {
        let mut entity = commands.entity(entity);
        match maps {
            Some(maps) => entity.insert(ExtractedEnvironment {
                diffuse: maps.diffuse_map.id(),
                specular: maps.specular_map.id(),
            }),
            None => entity.remove::<ExtractedEnvironment>(),
        };
    }
}

/// The number, or 0 where it is below or not a number: what a shader gets must be sound.
pub(super) fn non_negative(x: f32) -> f32 {
    if x > 0.0 { x.min(f32::MAX) } else { 0.0 }
}
