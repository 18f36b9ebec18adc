//! What the renderer takes from the app's world each frame.

use bevy::camera::visibility::InheritedVisibility;
use bevy::math::Affine3A;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::{MainEntity, MainEntityHashMap, RenderEntity};
use std::sync::Arc;
use vdb_core::pack::PackedGrid;

use crate::{VdbGrid, VdbMaterial, VdbSun, VdbVolume};

/// Every volume whose grid has arrived, visible or not.
#[derive(Debug, Default, Resource)]
pub(super) struct ExtractedVolumes(pub MainEntityHashMap<ExtractedVolume>);

#[derive(Clone, Debug)]
pub(super) struct ExtractedVolume {
    pub grid: AssetId<VdbGrid>,
    pub packed: Arc<PackedGrid>,
    /// For messages.
    pub name: Arc<str>,
    pub world_from_local: Affine3A,
    pub local_from_index: bevy::math::DAffine3,
    pub material: VdbMaterial,
}

pub(super) fn extract_volumes(
    volumes: Extract<Query<(Entity, &VdbVolume, &GlobalTransform, &VdbMaterial)>>,
    grids: Extract<Res<Assets<VdbGrid>>>,
    mut extracted: ResMut<ExtractedVolumes>,
) {
    extracted.0.clear();
    for (entity, volume, transform, material) in &volumes {
        let Some(grid) = grids.get(&volume.0) else { continue };
        let volume = ExtractedVolume {
            grid: volume.0.id(),
            packed: grid.packed().clone(),
            name: grid.shared_name(),
            world_from_local: transform.affine(),
            local_from_index: grid.world_from_index(),
            material: material.clone(),
        };
        extracted.0.insert(MainEntity::from(entity), volume);
    }
}

/// The light that volumes are lit by.
#[derive(Clone, Copy, Debug, Default, Resource)]
pub(super) struct ExtractedSun {
    /// World space, unit, towards the sun; zero without a sun.
    pub direction: Vec3,
    /// Linear colour times illuminance, in lux.
    pub illuminance: Vec3,
}

pub(super) fn extract_sun(
    lights: Extract<
        Query<(&DirectionalLight, &GlobalTransform, Option<&VdbSun>, &InheritedVisibility)>,
    >,
    mut extracted: ResMut<ExtractedSun>,
) {
    // A light marked as the sun comes before all others, then the brightest.
    let sun = lights.iter().filter(|(.., visible)| visible.get()).max_by(|a, b| {
        let rank = |(light, _, sun, _): &(&DirectionalLight, _, Option<&VdbSun>, _)| {
            (sun.is_some(), light.illuminance)
        };
        let (a, b) = (rank(a), rank(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    *extracted = sun.map_or_else(ExtractedSun::default, |(light, transform, sun, _)| {
        let intensity = non_negative(sun.map_or(1.0, |sun| sun.intensity));
        ExtractedSun {
            direction: transform.back().as_vec3(),
            illuminance: light.color.to_linear().to_vec3()
                * non_negative(light.illuminance)
                * intensity,
        }
    });
}

/// Ambient luminance that a camera's picture has, linear, in cd/m²: a component of render entities.
#[derive(Clone, Copy, Component, Debug, Default)]
pub(super) struct ExtractedAmbient(pub Vec3);

pub(super) fn extract_ambient(
    mut commands: Commands,
    global: Extract<Option<Res<GlobalAmbientLight>>>,
    cameras: Extract<Query<(RenderEntity, Option<&AmbientLight>), With<Camera3d>>>,
) {
    let luminance =
        |color: Color, brightness: f32| color.to_linear().to_vec3() * non_negative(brightness);
    let global =
        global.as_ref().map_or(Vec3::ZERO, |light| luminance(light.color, light.brightness));
    for (entity, own) in &cameras {
        let ambient = own.map_or(global, |light| luminance(light.color, light.brightness));
        commands.entity(entity).insert(ExtractedAmbient(ambient));
    }
}

/// The number, or 0 where it is below or not a number: what a shader gets must be sound.
pub(super) fn non_negative(x: f32) -> f32 {
    if x > 0.0 { x.min(f32::MAX) } else { 0.0 }
}
