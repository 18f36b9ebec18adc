//! The volumes that cast shadows on meshes, and their data for each shadow map.

use std::any::TypeId;
use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::{DAffine3, DMat4, DVec3};
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::RenderVisibleEntities;
use vdb_core::pack::PackKind;

use crate::render::extract::{ExtractedVolume, ExtractedVolumes};
use crate::render::pool::VdbTreePool;
use crate::render::view::Shown;
use crate::{VdbCamera, VdbQuality};

/// A volume that casts shadows.
pub(super) struct Caster<'a> {
    pub entity: MainEntity,
    pub volume: &'a ExtractedVolume,
    pub shown: Shown<'a>,
    /// Identifies its voxels, ramp and custom material.
    pub content: u64,
}

pub(super) fn is_parallel(clip_from_view: DMat4) -> bool {
    clip_from_view.z_axis.w == 0.0
}

/// The transform and projection of a light's rays. For a sun, the origin is moved back in front of
/// all casters, which may be nearer to the sun than anything that a camera sees.
pub(super) fn set_back(
    (world_from_view, clip_from_view): (DAffine3, DMat4),
    corners: impl Iterator<Item = DVec3>,
) -> (DAffine3, DMat4) {
    if !is_parallel(clip_from_view) {
        return (world_from_view, clip_from_view);
    }
    let view_from_world = world_from_view.inverse();
    let nearest = corners.map(|at| view_from_world.transform_point3(at).z).fold(0.0, f64::max);
    let back = DVec3::new(0.0, 0.0, nearest);
    (
        world_from_view * DAffine3::from_translation(back),
        clip_from_view * DMat4::from_translation(back),
    )
}

/// All volumes that cast shadows, fogs first, because their numbers select their thresholds in a
/// texel.
pub(super) fn casters<'a>(volumes: &'a ExtractedVolumes, pool: &VdbTreePool) -> Vec<Caster<'a>> {
    let all = volumes.0.iter().filter(|(_, volume)| may_cast(volume));
    let mut casters: Vec<_> = all
        .filter_map(|(&entity, volume)| {
            let shown = Shown::finest(volume, pool)?;
            Some(Caster { entity, volume, shown, content: content(&shown, pool) })
        })
        .collect();
    casters.sort_unstable_by_key(|caster| {
        (!matches!(caster.volume.packed.kind, PackKind::Fog), caster.entity)
    });
    casters
}

fn content(shown: &Shown, pool: &VdbTreePool) -> u64 {
    let ramp = shown.ramp().map(|ramp| ramp.content);
    let material = shown.own_material().map(|own| own.content);
    let mut hasher = DefaultHasher::new();
    (pool.content(shown.key()), ramp, material).hash(&mut hasher);
    hasher.finish()
}

fn may_cast(volume: &ExtractedVolume) -> bool {
    volume.visible && volume.casts && volume.packed.occupied.is_some()
}

/// The kinds of custom materials of fogs, a bit each.
pub(super) fn fog_materials(casters: &[Caster]) -> u32 {
    let fogs = casters.iter().filter(|caster| matches!(caster.volume.packed.kind, PackKind::Fog));
    fogs.filter_map(|caster| caster.volume.own_material).fold(0, |all, own| all | 1 << own.kind)
}

/// Whether volumes cast shadows on the meshes that a camera sees.
pub(super) fn casts_for(
    settings: Option<&VdbCamera>,
    quality: Option<&VdbQuality>,
    visible: &RenderVisibleEntities,
) -> bool {
    settings.is_none_or(|camera| camera.enabled && camera.mesh_shadows)
        && quality.is_none_or(|quality| quality.shadows)
        && sees_meshes(visible)
}

/// Whether a camera's settings ask for the removal of grain.
pub(super) fn denoises(quality: Option<&VdbQuality>) -> bool {
    quality.is_none_or(|quality| quality.denoise)
}

/// Whether fog casts shadows that a camera shows without grain, on the meshes that it sees.
pub(in crate::render) fn removes_grain(
    settings: Option<&VdbCamera>,
    quality: Option<&VdbQuality>,
    visible: &RenderVisibleEntities,
    volumes: &ExtractedVolumes,
) -> bool {
    let is_fog = |volume: &ExtractedVolume| matches!(volume.packed.kind, PackKind::Fog);
    denoises(quality)
        && casts_for(settings, quality, visible)
        && volumes.0.values().any(|volume| is_fog(volume) && may_cast(volume))
}

/// Whether a camera sees a mesh that could receive shadows.
fn sees_meshes(visible: &RenderVisibleEntities) -> bool {
    visible.classes.get(&TypeId::of::<Mesh3d>()).is_some_and(|class| {
        !class.entities_cpu_culling.is_empty() || !class.entities_gpu_culling.is_empty()
    })
}
