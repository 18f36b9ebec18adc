//! The volumes that cast shadows on meshes, and their data for each shadow map.

use std::any::TypeId;

use bevy::camera::visibility::RenderLayers;
use bevy::math::{DAffine3, DMat4, DVec3};
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::{ExtractedView, RenderVisibleEntities};
use vdb_core::pack::PackKind;
use vdb_core::view::ViewRays;

use crate::render::extract::{
    ExtractedClipPlanes, ExtractedSuns, ExtractedVolume, ExtractedVolumes,
};
use crate::render::gpu::{affine, types};
use crate::render::pool::VdbTreePool;
use crate::render::view::{Eye, Shown, cut_by, view_data, volume_data, world_corners};
use crate::{VdbCamera, VdbQuality};

/// A volume that casts shadows.
pub(super) struct Caster<'a> {
    entity: MainEntity,
    volume: &'a ExtractedVolume,
    shown: Shown<'a>,
}

/// The shader data of the casters of each map.
#[derive(Default)]
pub(super) struct Cast {
    pub volumes: Vec<types::Volume>,
    pub maps: Vec<(Option<Entity>, Entity, types::View)>,
    /// The cameras that show meshes without the grain of fog's shadows.
    pub smoothed: Vec<Entity>,
    clip_planes: ExtractedClipPlanes,
}

impl Cast {
    /// Whether a volume of a kind is drawn.
    pub fn has(&self, kind: u32) -> bool {
        self.volumes.iter().any(|volume| volume.kind == kind)
    }

    /// Whether a camera shows meshes in the shadow of fog, without grain.
    pub fn has_grain(&self) -> bool {
        !self.smoothed.is_empty() && self.has(types::KIND_FOG)
    }

    pub fn new(clip_planes: &ExtractedClipPlanes) -> Self {
        Self { clip_planes: clip_planes.clone(), ..default() }
    }

    pub fn add(
        &mut self,
        (camera, random_offset): (Option<Entity>, f32),
        (map, view): (Entity, &ExtractedView),
        casters: &[Caster],
        layers: impl Fn(&RenderLayers) -> bool,
    ) {
        let casters = || casters.iter().filter(|caster| layers(&caster.volume.layers));
        let size = view.viewport.zw();
        let (world_from_view, clip_from_view) =
            set_back(view, casters().flat_map(|caster| world_corners(caster.volume)));
        let Some(mut rays) = ViewRays::new(clip_from_view) else { return };
        if is_parallel(clip_from_view) {
            rays.t_near = 0.0;
        }
        let clip_from_world = clip_from_view * DMat4::from(world_from_view.inverse());
        let first = self.volumes.len();
        let quality = VdbQuality::default();
        for caster in casters() {
            let eye = Eye { rays: &rays, world_from_view, size };
            let range = caster.shown.tile_range(clip_from_world, size);
            if range.count() > 0
                && let Some(data) = volume_data(caster.entity, &caster.shown, eye, &quality, None)
            {
                let [tiles_first, tiles_last] = range.words();
                self.volumes.push(types::Volume { tiles_first, tiles_last, ..data });
            }
        }
        let count = self.volumes.len() - first;
        if count > 0 {
            let eye = world_from_view.transform_point3(rays.eye);
            let view = types::View {
                volume_first: first as u32,
                volume_count: count as u32,
                size: size.to_array(),
                random_offset,
                clip_planes: self.clip_planes.data(cut_by(&self.volumes[first..]), eye),
                ..view_data(&rays, world_from_view, &ExtractedSuns::default())
            };
            self.maps.push((camera, map, view));
        }
    }
}

fn is_parallel(clip_from_view: DMat4) -> bool {
    clip_from_view.z_axis.w == 0.0
}

/// The transform and projection of a light's rays. For a sun, the origin is moved back in front of
/// all casters, which may be nearer to the sun than anything that a camera sees.
fn set_back(view: &ExtractedView, corners: impl Iterator<Item = DVec3>) -> (DAffine3, DMat4) {
    let world_from_view = affine(view.world_from_view.affine());
    let clip_from_view = view.clip_from_view.as_dmat4();
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
            Some(Caster { entity, volume, shown: Shown::finest(volume, pool)? })
        })
        .collect();
    casters.sort_unstable_by_key(|caster| {
        (!matches!(caster.volume.packed.kind, PackKind::Fog), caster.entity)
    });
    casters
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
