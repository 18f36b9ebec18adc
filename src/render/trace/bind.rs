//! The bind groups of each view's trace.

use bevy::ecs::query::QueryData;
use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::render::render_resource::{BindingResource, Buffer, PipelineCache, Sampler, TextureView};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::texture::CachedTexture;
use bevy::render::view::ViewDepthTexture;

use super::beams::BeamsPipeline;
use super::blackbody::BlackbodyColors;
use super::edges::EdgesView;
use super::lights::{AllLights, ViewLights};
use super::pipeline::TracePipeline;
use super::view::{BindGroups, TraceView};
use crate::quality::features::Features;
use crate::render::extract::{ExtractedMaterials, ExtractedRamps};
use crate::render::gpu::{MATERIALS_BINDING, RAMPS_BINDING};
use crate::render::light_cache::{LightCache, LightCacheView};
use crate::render::pool::VdbTreePool;
use crate::render::scattered_light::ScatteredLight;
use crate::render::view::{
    MaterialTable, Picture, RampTexture, ViewPicture, ViewState, VolumeBuffer,
};

/// What a view has that its bind groups are made of.
#[derive(QueryData)]
#[query_data(mutable)]
pub(super) struct TracedView {
    state: &'static ViewState,
    trace: &'static mut TraceView,
    picture: &'static ViewPicture,
    depth: &'static ViewDepthTexture,
    light_cache: &'static LightCacheView,
    edges: &'static EdgesView,
    lights: Option<ViewLights>,
}

/// What the bind groups of all views are made of.
#[derive(SystemParam)]
pub(super) struct Sources<'w> {
    pool: Res<'w, VdbTreePool>,
    volumes: Res<'w, VolumeBuffer>,
    lights: AllLights<'w>,
    blackbody: Res<'w, BlackbodyColors>,
    light_cache: Res<'w, LightCache>,
    scattered_light: Res<'w, ScatteredLight>,
    ramps: ResMut<'w, RampTexture>,
    extracted_ramps: Res<'w, ExtractedRamps>,
    materials: ResMut<'w, MaterialTable>,
    extracted_materials: Res<'w, ExtractedMaterials>,
    trace: Res<'w, TracePipeline>,
    beams: Res<'w, BeamsPipeline>,
    cache: Res<'w, PipelineCache>,
    device: Res<'w, RenderDevice>,
    queue: Res<'w, RenderQueue>,
}

/// Creates the bind groups of all views.
pub(super) fn bind(mut views: Query<TracedView>, mut sources: Sources) {
    for mut view in &mut views {
        view.trace.bind_groups = sources.bind(&view);
    }
}

/// The resource of a feature: `Some(None)` in views without the feature, `None` if it is missing.
fn needed<T>(is_needed: bool, get: impl FnOnce() -> Option<T>) -> Option<Option<T>> {
    if is_needed { get().map(Some) } else { Some(None) }
}

impl Sources<'_> {
    /// The bind groups of a view; `None` while something that it needs is missing.
    fn bind(&mut self, view: &TracedViewItem) -> Option<BindGroups> {
        let (prepared, uniform) = view.state.prepared().filter(|(view, _)| view.is_ready)?;
        let ViewPicture { traced: Some(picture), rays, .. } = view.picture else { return None };
        let features = prepared.key.features;
        let has = |feature| features.contains(feature);
        let (cache, device) = (&*self.cache, &*self.device);
        let bind_lights = |features, lights| {
            let maps = self.lights.mesh_maps();
            self.lights.bind(features, &self.trace.lights, lights, maps, device, cache)
        };
        let lights = bind_lights(features, view.lights.as_ref())?;
        let nothing = bind_lights(Features::empty(), None)?;
        let lamps = needed(has(Features::LAMP_LIGHT), || {
            bind_lights(Features::LIGHT, view.lights.as_ref())
        })?;

        let (pool, volumes) = (self.pool.buffers()?, self.volumes.0.buffer()?);
        let scene = || pool.scene_entries(uniform, volumes);
        let depth = view.depth.view();
        let shared = SharedTextures {
            blackbody: needed(has(Features::BLACKBODY), || self.blackbody.0.as_ref())?,
            cached: needed(has(Features::LIGHT_CACHE), || self.light_cache.binding())?,
            scattered: needed(has(Features::SCATTERED_LIGHT), || self.scattered_light.binding())?,
            ramps: needed(has(Features::RAMPS), || {
                self.ramps.get(&self.extracted_ramps, device, &self.queue)
            })?,
            materials: features
                .intersects(Features::OWN_MATERIALS)
                .then(|| self.materials.get(&self.extracted_materials, device, &self.queue)),
        };
        let optional = shared.optional_entries(features, view, picture);
        let layout = cache.get_bind_group_layout(&self.trace.layout(features));
        let bind_trace = |color: &TextureView| {
            let common = (depth, color, &picture.depth.default_view);
            let mut entries = scene().extend_sequential(common);
            for (binding, resource) in &optional {
                entries = entries.extend_with_indices(((*binding, resource.clone()),));
            }
            device.create_bind_group("vdb_trace", &layout, &entries)
        };
        let refined = rays.as_ref().filter(|_| has(Features::DENOISED));
        let refined = refined.filter(|_| view.edges.list.is_some());

        let beams = view.trace.tiles.as_ref().map(|tiles| {
            let layout = self.beams.layout(features, has(Features::PAGES));
            let layout = cache.get_bind_group_layout(layout);
            let own = ((6, depth), (9, tiles.as_entire_binding()));
            device.create_bind_group("vdb_beams", &layout, &scene().extend_with_indices(own))
        });
        Some(BindGroups {
            trace: bind_trace(&picture.color.default_view),
            refine: refined.map(|rays| bind_trace(&rays.color.default_view)),
            lights,
            beams,
            nothing,
            lamps,
        })
    }
}

/// Textures of all views that the shaders of some features read.
struct SharedTextures<'a> {
    blackbody: Option<&'a TextureView>,
    cached: Option<(&'a TextureView, &'a Sampler)>,
    scattered: Option<(&'a TextureView, &'a Sampler)>,
    ramps: Option<&'a TextureView>,
    materials: Option<&'a TextureView>,
}

impl<'a> SharedTextures<'a> {
    /// The resources that only views with certain features bind, by their bindings.
    fn optional_entries(
        self,
        features: Features,
        view: &'a TracedViewItem,
        picture: &'a Picture,
    ) -> Vec<(u32, BindingResource<'a>)> {
        let Self { blackbody, cached, scattered, ramps, materials } = self;
        let trace = &*view.trace;
        let texture = |view: &'a TextureView| BindingResource::TextureView(view);
        let sampler = |sampler: &'a Sampler| BindingResource::Sampler(sampler);
        let buffer = |buffer: &'a Buffer| buffer.as_entire_binding();
        let own = |own: &'a CachedTexture| texture(&own.default_view);
        let lamps = view.light_cache.lamp_lattices();
        let lamps = lamps.filter(|_| cached.is_some() && features.contains(Features::CACHED_LAMPS));
        let lamp_light = trace.lamp_light.as_ref().filter(|_| cached.is_some());
        let entries = [
            (9, trace.tiles.as_ref().map(buffer)),
            (10, picture.moving.as_ref().map(own)),
            (11, blackbody.map(texture)),
            (12, cached.map(|(depths, _)| texture(depths))),
            (13, cached.map(|(_, own)| sampler(own))),
            (14, lamps.map(texture)),
            (15, lamp_light.map(|own| texture(own.texture()))),
            (17, view.edges.list.as_ref().map(buffer)),
            (19, trace.reflections.as_ref().map(own)),
            (20, scattered.map(|(light, _)| texture(light))),
            (21, scattered.map(|(_, own)| sampler(own))),
            (24, trace.first_reflections.as_ref().map(own)),
            (RAMPS_BINDING, ramps.map(texture)),
            (MATERIALS_BINDING, materials.map(texture)),
        ];
        entries.into_iter().filter_map(|(binding, entry)| Some((binding, entry?))).collect()
    }
}
