//! What is drawn into shadow maps, as shaders read it.

use std::ops::Range;

use bevy::camera::visibility::RenderLayers;
use bevy::math::DMat4;
use bevy::pbr::LightEntity;
use bevy::prelude::*;
use bevy::render::view::ExtractedView;
use vdb_core::view::ViewRays;

use super::casters::{Caster, is_parallel, set_back};
use super::opacity::Wanted;
use super::suns::Suns;
use crate::VdbQuality;
use crate::render::extract::{ExtractedClipPlanes, ExtractedSuns};
use crate::render::gpu::{affine, types};
use crate::render::view::{Eye, cut_by, view_data, volume_data, world_corners};

/// The shader data of the casters of each map.
#[derive(Default)]
pub(super) struct Cast {
    pub volumes: Vec<types::Volume>,
    pub maps: Vec<(Option<Entity>, Entity, types::View)>,
    /// The opacity maps of fogs.
    pub opacity: Vec<Wanted>,
    /// The views by whose rays they are filled. Their first volumes are fogs.
    pub fills: Vec<types::View>,
    /// The cameras that show meshes without the grain of fog's shadows.
    pub smoothed: Vec<Entity>,
    clip_planes: ExtractedClipPlanes,
}

impl Cast {
    pub fn new(clip_planes: &ExtractedClipPlanes) -> Self {
        Self { clip_planes: clip_planes.clone(), ..default() }
    }

    /// Whether a volume of a kind is drawn.
    pub fn has(&self, kind: u32) -> bool {
        self.volumes.iter().any(|volume| volume.kind == kind)
    }

    /// Whether a surface is drawn.
    pub fn has_surfaces(&self) -> bool {
        self.has(types::KIND_SURFACE) || self.has(types::KIND_SMOOTH)
    }

    /// Whether a camera shows meshes in the shadow of fog, without grain.
    pub fn has_grain(&self) -> bool {
        !self.smoothed.is_empty() && self.has(types::KIND_FOG)
    }

    /// Adds a shadow map: those casters that it may show. Lights other than suns have a range.
    pub fn add<'a>(
        &mut self,
        (camera, random_offset): (Option<Entity>, f32),
        (map, view): (Entity, &ExtractedView),
        (light, light_range): (&LightEntity, f64),
        casters: &'a [Caster<'a>],
        layers: impl Fn(&RenderLayers) -> bool,
        suns: &mut Suns<'a>,
    ) {
        let casters = || casters.iter().filter(|caster| layers(&caster.volume.layers));
        let size = view.viewport.zw();
        let (world_from_view, clip_from_view) = set_back(
            (affine(view.world_from_view.affine()), view.clip_from_view.as_dmat4()),
            casters().flat_map(|caster| world_corners(caster.volume)),
        );
        let Some(mut rays) = ViewRays::new(clip_from_view) else { return };
        if is_parallel(clip_from_view) {
            rays.t_near = 0.0;
        }
        let clip_from_world = clip_from_view * DMat4::from(world_from_view.inverse());
        let eye = Eye { rays: &rays, world_from_view, size };
        let (first, first_wanted) = (self.volumes.len(), self.opacity.len());
        let quality = VdbQuality::default();
        for caster in casters() {
            let range = caster.shown.tile_range(clip_from_world, size);
            if range.count() == 0 {
                continue;
            }
            let data = volume_data(caster.entity, &caster.shown, eye, &quality, None);
            let Some(data) = data else { continue };
            let index = self.volumes.len();
            if data.kind == types::KIND_FOG {
                if let LightEntity::Directional { light_entity, .. } = light {
                    suns.add(*light_entity, (caster, index), (eye, range));
                } else {
                    let wanted = Wanted::new(index, caster, (eye, light_range), range);
                    self.opacity.extend(wanted);
                }
            }
            let [tiles_first, tiles_last] = range.words();
            self.volumes.push(types::Volume { tiles_first, tiles_last, ..data });
        }
        if self.volumes.len() > first {
            let view = types::View { random_offset, ..self.view(first, eye) };
            self.maps.push((camera, map, view));
            if self.opacity.len() > first_wanted {
                self.fills.push(view);
            }
        }
    }

    /// Adds the views of suns.
    pub fn add_suns(&mut self, suns: &Suns) {
        for sun in suns.views() {
            let first = self.volumes.len();
            for (data, wanted) in sun.fogs {
                self.volumes.push(data);
                self.opacity.push(Wanted { volume: first + wanted.volume, ..wanted });
            }
            let (rays, world_from_view) = (&sun.rays, sun.world_from_view);
            self.fills.push(self.view(first, Eye { rays, world_from_view, size: sun.size }));
        }
    }

    /// The opacity maps: the views by whose rays they are filled, the volumes, and what identifies the fogs.
    pub fn opacity_maps(&self) -> impl Iterator<Item = (&types::View, usize, u64)> {
        self.opacity.iter().filter_map(|wanted| {
            let mut views = self.fills.iter();
            let view = views.find(|view| volumes_of(view).contains(&wanted.volume))?;
            Some((view, wanted.volume, wanted.content))
        })
    }

    /// The uniform of a view that shows the volumes from one on.
    fn view(&self, first: usize, eye: Eye) -> types::View {
        let origin = eye.world_from_view.transform_point3(eye.rays.eye);
        types::View {
            volume_first: first as u32,
            volume_count: (self.volumes.len() - first) as u32,
            size: eye.size.to_array(),
            clip_planes: self.clip_planes.data(cut_by(&self.volumes[first..]), origin),
            ..view_data(eye.rays, eye.world_from_view, &ExtractedSuns::default())
        }
    }
}

/// The indices of the volumes in a view.
pub(super) fn volumes_of(view: &types::View) -> Range<usize> {
    let first = view.volume_first as usize;
    first..first + view.volume_count as usize
}
