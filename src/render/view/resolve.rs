//! Resolution of views: settings, rays, volume list and pipeline key, before it is known which
//! pipelines are ready.

use bevy::camera::MainPassResolutionOverride;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::prepass::{MotionVectorPrepass, ViewPrepassTextures};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::ecs::query::QueryData;
use bevy::ecs::system::SystemParam;
use bevy::light::ShadowFilteringMethod;
use bevy::pbr::DistanceFog;
use bevy::prelude::*;
use bevy::render::camera::{ExtractedCamera, TemporalJitter};
use bevy::render::renderer::RenderDevice;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::{ExtractedView, Msaa, RenderVisibleEntities, RenderVisibleEntitiesClass};
use vdb_core::view::ViewRays;

use super::bvh;
use super::eye::Eye;
use super::fog_error::CacheAccuracy;
use super::key::ViewKey;
use super::lights::{Lights, Surroundings};
use super::list::{EntryMaker, ViewList};
use super::media::MediaSlots;
use super::queue::AskedPipelines;
use super::settings::{ResolvedSettings, accumulates, smooths_edges};
use super::state::{PreparedView, ResolvedView, ViewState};
use super::visible::VisibleVolumes;
use crate::quality::LeftOut;
use crate::quality::features::Features;
use crate::render::extract::{ExtractedSuns, ExtractedVolumes, Trouble, Warned};
use crate::render::gpu::{affine, types};
use crate::render::pool::VdbTreePool;
use crate::{VdbCamera, VdbOverlays, VdbQuality, VdbRenderMode, VdbTraversal};

/// The components of a view.
#[derive(QueryData)]
#[query_data(mutable)]
pub(super) struct ViewData {
    camera_entity: &'static MainEntity,
    seen: &'static VisibleVolumes,
    state: &'static mut ViewState,
    view: &'static ExtractedView,
    settings: Option<&'static VdbCamera>,
    quality: Option<&'static VdbQuality>,
    left_out: Option<&'static LeftOut>,
    msaa: &'static Msaa,
    layers: Option<&'static RenderLayers>,
    shadow_filter: Option<&'static ShadowFilteringMethod>,
    around: Surroundings,
    has_distance_fog: Has<DistanceFog>,
    jitter: Option<&'static TemporalJitter>,
    resolution: Option<&'static MainPassResolutionOverride>,
    camera: &'static ExtractedCamera,
    tonemapping: Option<&'static Tonemapping>,
    meshes: Option<&'static RenderVisibleEntities>,
    has_motion: Has<MotionVectorPrepass>,
    prepass: Option<&'static ViewPrepassTextures>,
}

/// The resources for resolving views.
#[derive(SystemParam)]
pub(super) struct Resolver<'w, 's> {
    volumes: Res<'w, ExtractedVolumes>,
    suns: Res<'w, ExtractedSuns>,
    lights: Lights<'w, 's>,
    pool: Res<'w, VdbTreePool>,
    warned: ResMut<'w, Warned>,
    device: Res<'w, RenderDevice>,
    light_cache: Res<'w, LightCacheLimit>,
}

/// Whether the light cache lacks room for some fog. Known only once a frame is planned, so it takes
/// effect in the next one.
#[derive(Default, Resource)]
pub(crate) struct LightCacheLimit {
    pub is_full: bool,
}

/// Resolves each view.
pub(super) fn resolve_views(mut views: Query<ViewData>, mut resolver: Resolver) {
    for mut view in &mut views {
        view.state.resolved = resolver.resolve(&view);
    }
    resolver.warned.end_frame();
}

impl Resolver<'_, '_> {
    /// Resolves a view; `None` if there is nothing to draw.
    fn resolve(&mut self, of: &ViewDataItem) -> Option<ResolvedView> {
        let settings = self.settings(of);
        let picture = settings.picture;
        let mut clip_from_view = of.view.clip_from_view;
        if let Some(jitter) = of.jitter {
            jitter.jitter_projection(&mut clip_from_view, picture.as_vec2());
        }
        let rays = ViewRays::new(clip_from_view.as_dmat4())?;
        if picture.min_element() == 0 {
            return None;
        }
        let world_from_view = affine(of.view.world_from_view.affine());
        let beside = if settings.looks_beside() {
            self.volumes.beside(&of.seen.0, &of.layers.cloned().unwrap_or_default())
        } else {
            Vec::new()
        };
        let mut ids = [of.seen.0.clone(), beside];
        let many = settings.looks_beside() && ids.iter().map(Vec::len).sum::<usize>() > bvh::FEW;
        if many {
            ids.iter_mut().for_each(|ids| bvh::sort(ids, &self.volumes));
        }
        let maker = EntryMaker {
            volumes: &self.volumes,
            pool: &self.pool,
            eye: Eye { rays: &rays, world_from_view, size: picture },
            quality: &settings.quality,
            cache_accuracy: CacheAccuracy {
                error: cache_error(of, &settings),
                single_scattering: !settings.camera.multiple_scattering,
            },
            left_out: settings.left_out,
        };
        let shown = (settings.is_lit(), settings.reflections > 0);
        let list =
            ViewList::new(maker, ids.each_ref().map(Vec::as_slice), shown, &mut self.warned)?;
        let is_full = self.light_cache.is_full;
        let mut key = view_key(of, &settings, &list, many, is_full, (&self.pool, &self.device));
        key.cached_suns = key.has(Features::LIGHT_CACHE).then(|| self.lights.cached_suns());
        let asked = of.state.pipelines.key_for(key, settings.lights_present);
        Some(ResolvedView {
            settings,
            rays,
            world_from_view,
            clip_from_view,
            list,
            key,
            asked: AskedPipelines::new(asked),
        })
    }

    /// Resolves the settings of a view, and warns of invalid ones.
    fn settings(&mut self, of: &ViewDataItem) -> ResolvedSettings {
        let mut camera = of.settings.cloned().unwrap_or_default();
        let (mut quality, wrong) = of.quality.copied().unwrap_or_default().sound();
        let left_out = of.left_out.copied().unwrap_or_default().0;
        left_out.leave_out(&mut camera, &mut quality);
        let picture = of.resolution.map_or(of.view.viewport.zw(), |size| size.0);
        let is_jittered = of.jitter.is_some();
        let accumulates = accumulates(&quality, camera.mode, is_jittered, picture, &self.device);
        for trouble in [wrong.map(Trouble::CameraQuality), accumulates.err()].into_iter().flatten()
        {
            if let Some(text) = self.warned.note(*of.camera_entity, "", trouble) {
                warn!("{text}");
            }
        }
        let (lights_present, shadow_filter) = self.lights.features(
            quality.shadows,
            of.shadow_filter,
            &of.around,
            of.has_distance_fog,
            &self.suns,
        );
        // The other lit modes show parts of the light, without distance fog.
        let mut lights = lights_present;
        let mode = camera.mode.traits();
        lights.set(Features::DISTANCE_FOG, of.has_distance_fog && mode.shows_distance_fog);
        lights.remove(CACHE.when(quality.fog_light_error <= 0.0));
        let is_lit = mode.is_lit;
        ResolvedSettings {
            lights: lights.when(is_lit),
            shadow_filter: shadow_filter.filter(|_| is_lit),
            lights_present,
            reflections: if mode.shows_reflections { quality.reflections } else { 0 },
            smooths_edges: smooths_edges(&quality, camera.mode, is_jittered, picture, &self.device),
            accumulates: accumulates.unwrap_or(false),
            camera,
            quality,
            left_out,
            picture,
        }
    }
}

/// The kinds of surfaces.
const SURFACES: [u32; 2] = [types::KIND_SURFACE, types::KIND_SMOOTH];

/// The kinds of emission.
const EMITTERS: [u32; 2] = [types::KIND_EMISSION, types::KIND_BLACKBODY];

/// The features that only the light cache needs.
const CACHE: Features = Features::LIGHT_CACHE
    .union(Features::CACHED_LAMPS)
    .union(Features::OTHER_LIGHTS)
    .union(Features::UNCACHED_LIGHTS)
    .union(Features::MESH_CASTERS);

/// The features of light probes, which only surfaces reflect.
const PROBES: Features = Features::REFLECTION_PROBES.union(Features::IRRADIANCE_VOLUMES);

/// The error that is accepted of light from the cache; 0 if no pipelines read it.
fn cache_error(of: &ViewDataItem, settings: &ResolvedSettings) -> f32 {
    // The pipelines of the previous frame, or those that are ready next, may stand in for others.
    let reads = |before: &PreparedView| before.key.has(Features::LIGHT_CACHE);
    if settings.lights.contains(Features::LIGHT_CACHE) {
        settings.quality.fog_light_error
    } else if of.state.prepared.as_ref().is_some_and(reads)
        || of.state.pipelines.is_compiling(Features::LIGHT_CACHE)
    {
        VdbQuality::HIGH.fog_light_error
    } else {
        0.0
    }
}

/// Whether the camera's target holds opaque meshes, and their radiance.
fn shows_meshes(of: &ViewDataItem) -> bool {
    let is_linear = of.camera.hdr || of.tonemapping.is_none_or(|curve| *curve == Tonemapping::None);
    let meshes = of.meshes.and_then(|all| all.get::<Mesh3d>());
    let has_some = |all: &RenderVisibleEntitiesClass| {
        !(all.entities_cpu_culling.is_empty() && all.entities_gpu_culling.is_empty())
    };
    is_linear && meshes.is_some_and(has_some)
}

/// The features of the light that the volumes of a view need, among them whether fog is also lit without the cache.
fn needed_lights(
    settings: &ResolvedSettings,
    list: &ViewList,
    media: MediaSlots,
    is_cache_full: bool,
) -> Features {
    let [caches, has_uncached] = list.cached_fogs(settings.reflections == 0);
    let has_surfaces = list.kinds.has(SURFACES);
    let reflects_fire = list.kinds.has(EMITTERS) && has_surfaces && settings.reflections > 0;
    let lights = settings
        .lights
        .difference(CACHE.when(!caches))
        .difference(PROBES.when(!has_surfaces))
        .difference(Features::FIRE_LIGHTS.when(!reflects_fire));
    if !lights.contains(Features::LIGHT_CACHE) {
        return lights;
    }
    lights
        | (Features::UNCACHED_LIGHTS | Features::OTHER_LIGHTS).when(is_cache_full)
        | Features::UNCACHED_FOGS.when(is_cache_full || has_uncached || media.is_too_much())
}

/// The feature that says how rays find what they meet.
fn traversal(traversal: VdbTraversal, pool: &VdbTreePool) -> Features {
    match traversal {
        VdbTraversal::HddaSkip => Features::BEAMS.when(pool.spare_bindings() >= 1),
        VdbTraversal::Hdda => Features::HDDA,
        VdbTraversal::Dda => Features::DDA,
        VdbTraversal::March => Features::MARCH,
    }
}

/// The key of the pipelines that a view requires.
fn view_key(
    of: &ViewDataItem,
    settings: &ResolvedSettings,
    list: &ViewList,
    many: bool,
    is_cache_full: bool,
    (pool, device): (&VdbTreePool, &RenderDevice),
) -> ViewKey {
    let ResolvedSettings { camera, quality, .. } = settings;
    let fog = list.kinds.has([types::KIND_FOG]) && settings.shows_fog();
    let emission = list.kinds.has(EMITTERS);
    let motion_vectors =
        of.has_motion && of.prepass.is_some_and(|all| all.motion_vectors.is_some());
    let multiple_scattering = camera.multiple_scattering && fog && settings.is_lit();
    // Entries out of view are visible only in reflections.
    let media = list.media(settings.reflections == 0);
    let lights = needed_lights(settings, list, media, is_cache_full);
    let scatters = multiple_scattering && lights.contains(Features::SHADOWS);
    let has_surfaces = list.kinds.has(SURFACES);
    let caches = lights.contains(Features::LIGHT_CACHE);
    // Without the cache, rays integrate fog exactly or by samples.
    let integrates = !caches || lights.contains(Features::UNCACHED_FOGS);
    let shows_surfaces = camera.mode != VdbRenderMode::Maximum;
    let shows_edges = settings.smooths_edges && shows_surfaces && list.kinds_seen.has(SURFACES);
    let interpolates = !has_surfaces && !lights.contains(Features::MESH_CASTERS);
    let [on_surfaces, in_fog] = list.materials;
    let on_surfaces = if settings.is_lit() { on_surfaces } else { 0 };
    let in_fog = if fog || settings.is_lit() { in_fog } else { 0 };
    let denoised = settings.reflections > 0 && quality.denoise && list.rough;
    // With a history, the trace writes four storage textures, the minimum that WebGPU guarantees; motion vectors take
    // a fifth.
    let most_textures = device.limits().max_storage_textures_per_shader_stage;
    let can_remember = !settings.accumulates && (!motion_vectors || most_textures >= 5);
    let features = lights
        | Features::LAMP_LIGHT.when(interpolates && lights.contains(Features::CACHED_LAMPS))
        | traversal(quality.traversal, pool)
        | Features::MULTISAMPLED.when(of.msaa.samples() > 1)
        | Features::VOXELS.when(shows_surfaces && list.kinds.has([types::KIND_SURFACE]))
        | Features::SMOOTH.when(shows_surfaces && list.kinds.has([types::KIND_SMOOTH]))
        | Features::SMOOTH_NORMALS.when(list.smooth_normals && settings.uses_normals())
        | Features::FOG.when(fog || emission)
        | Features::FOG_STEPS.when(fog && list.fog_steps && integrates)
        | Features::EMISSION.when(emission)
        | Features::BLACKBODY.when(list.kinds.has([types::KIND_BLACKBODY]))
        | Features::COLORS.when(list.colors)
        | Features::FOG_COLORS.when(list.fog_colors)
        | Features::RAMPS.when(list.ramps && (fog || settings.is_lit()))
        | Features::MATERIALS.when(on_surfaces != 0)
        | Features::FOG_MATERIALS.when(in_fog != 0)
        | Features::MULTIPLE_SCATTERING.when(multiple_scattering)
        | Features::SCATTERED_LIGHT.when(scatters)
        | Features::TINTED_FOG.when(scatters && list.tinted_fogs)
        | Features::MANY.when(many)
        | Features::PAGES.when(pool.page_bits().is_some())
        | Features::WIDE_GRIDS.when(pool.has_wide_grids())
        | Features::LEVELS.when(list.levels)
        | Features::CLIPPED.when(list.clipped)
        | Features::MOTION_VECTORS.when(motion_vectors)
        | Features::VELOCITIES.when(motion_vectors && list.velocities)
        | Features::REFLECTIONS.when(settings.reflections > 0)
        | Features::MESH_REFLECTIONS.when(
            settings.reflections > 0
                && quality.mesh_reflections
                && list.kinds_seen.has(SURFACES)
                && shows_meshes(of),
        )
        | Features::DENOISED.when(denoised)
        | Features::REFLECTION_HISTORY.when(denoised && can_remember)
        | Features::OVERLAYS.when(camera.overlays != VdbOverlays::default())
        | Features::SCALED.when(quality.resolution < 1.0)
        | Features::EDGES.when(shows_edges && pool.spare_bindings() >= 2)
        | Features::ACCUMULATED.when(settings.accumulates);
    ViewKey {
        features,
        mode: camera.mode,
        cached_suns: None,
        media: caches.then(|| MediaSlots::for_media(media, emission)),
        materials: on_surfaces | in_fog,
        shadow_filter: settings.shadow_filter,
        page_bits: pool.page_bits(),
        sample_format: pool.format(),
    }
}
