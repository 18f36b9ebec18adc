//! What each view needs this frame: its volumes, its rays, its textures. Nothing is made for a view
//! that sees no volume.

use bevy::camera::MainPassResolutionOverride;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::prepass::{MotionVectorPrepass, PreviousViewData, ViewPrepassTextures};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::diagnostic::FrameCount;
use bevy::ecs::query::QueryData;
use bevy::ecs::system::SystemParam;
use bevy::light::ShadowFilteringMethod;
use bevy::math::{DAffine3, DMat4};
use bevy::pbr::DistanceFog;
use bevy::prelude::*;
use bevy::render::camera::{ExtractedCamera, TemporalJitter};
use bevy::render::render_resource::{BufferUsages, PipelineCache, RawBufferVec};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::TextureCache;
use bevy::render::view::{ExtractedView, Msaa};

use super::accumulate::{self, Accumulated};
use super::bind::ViewBindGroups;
use super::changes::SceneChanges;
use super::entries::{ViewEntries, ViewList};
use super::extract::{ExtractedEnvironment, ExtractedSuns, ExtractedVolumes, non_negative};
use super::find::ViewVolumes;
use super::gpu_data::{self, KIND_BLACKBODY, KIND_EMISSION, KIND_FOG, KIND_SMOOTH, KIND_SURFACE};
use super::gpu_tree::VdbTreePool;
use super::hierarchy;
use super::lights::{LightKey, Lights};
use super::motion::matrices;
use super::pipeline::{CompositeKey, ToneKey, TraceKey, ViewPipelines};
use super::resources::{ViewFrame, ViewResources};
use super::stand_in::{self, Specialized};
use super::tiles::TileLayout;
use super::upscale;
use super::volume::{Eye, affine};
use super::warnings::{Trouble, Warned};
use crate::measure::LeftOut;
use crate::{VdbCamera, VdbOverlays, VdbQuality, VdbRenderMode, VdbTraversal};
use vdb_core::view::ViewRays;

/// The volumes of all views of the frame.
#[derive(Resource)]
pub(super) struct VolumeBuffer(pub RawBufferVec<gpu_data::Volume>);

impl Default for VolumeBuffer {
    fn default() -> Self {
        Self(RawBufferVec::new(BufferUsages::STORAGE))
    }
}

/// What turns luminance into the camera's values. Infinities are not for WGSL: with this and what
/// materials are capped to, products stay within f32.
const MOST_EXPOSURE: f32 = 1e12;
/// World units that a ray goes, at most: `FAR` of the shaders.
const FARTHEST: f32 = 1e30;
/// Of a sun's illuminance.
const MOST_FACTOR: f32 = 1e6;

/// What a view has.
#[derive(QueryData)]
pub(super) struct ViewData {
    entity: Entity,
    camera_entity: &'static MainEntity,
    seen: &'static ViewVolumes,
    view: &'static ExtractedView,
    camera: &'static ExtractedCamera,
    settings: Option<&'static VdbCamera>,
    quality: Option<&'static VdbQuality>,
    left_out: Option<&'static LeftOut>,
    msaa: &'static Msaa,
    layers: Option<&'static RenderLayers>,
    shadow_filter: Option<&'static ShadowFilteringMethod>,
    environment: Option<&'static ExtractedEnvironment>,
    has_distance_fog: Has<DistanceFog>,
    jitter: Option<&'static TemporalJitter>,
    resolution: Option<&'static MainPassResolutionOverride>,
    tonemapping: Option<&'static Tonemapping>,
    dither: Option<&'static DebandDither>,
    has_motion: Has<MotionVectorPrepass>,
    prepass: Option<&'static ViewPrepassTextures>,
    view_before: Option<&'static PreviousViewData>,
    before: Option<&'static ViewResources>,
    pipelines_before: Option<&'static ViewPipelines>,
}

/// What views are prepared with.
#[derive(SystemParam)]
pub(super) struct ViewMaker<'w, 's> {
    volumes: Res<'w, ExtractedVolumes>,
    suns: Res<'w, ExtractedSuns>,
    frame: Res<'w, FrameCount>,
    changes: Res<'w, SceneChanges>,
    lights: Lights<'w, 's>,
    pool: Res<'w, VdbTreePool>,
    warned: ResMut<'w, Warned>,
    device: Res<'w, RenderDevice>,
    textures: ResMut<'w, TextureCache>,
    cache: Res<'w, PipelineCache>,
    specialized: Specialized<'w>,
}

/// Makes buffers, textures and pipelines for each view that sees a volume.
pub(super) fn prepare_views(
    mut commands: Commands,
    views: Query<ViewData>,
    mut maker: ViewMaker,
    mut volume_buffer: ResMut<VolumeBuffer>,
    queue: Res<RenderQueue>,
) {
    volume_buffer.0.clear();
    for view in &views {
        let mut entity = commands.entity(view.entity);
        match maker.prepare(&view, volume_buffer.0.values_mut()) {
            Some(made) => entity.insert(made),
            None => entity.remove::<(ViewResources, ViewBindGroups, ViewPipelines)>(),
        };
    }
    maker.warned.end_frame();
    volume_buffer.0.write_buffer(&maker.device, &queue);
}

/// What the settings of a view come to in a frame.
struct Wishes {
    camera: VdbCamera,
    quality: VdbQuality,
    left_out: LeftOut,
    /// Of the scene, and of them those that the mode shows.
    lights_present: LightKey,
    lights: Option<LightKey>,
    /// How many times rays are mirrored.
    reflections: u32,
    accumulates: bool,
    /// Pixels.
    picture: UVec2,
}

impl Wishes {
    fn is_lit(&self) -> bool {
        self.camera.mode.is_lit()
    }

    /// Other modes are about surfaces: fog is neither traced nor compiled for them.
    fn shows_fog(&self) -> bool {
        self.is_lit() || self.camera.mode == VdbRenderMode::Steps
    }

    /// Whether what the view does not see may throw shadows into the picture, or be reflected there.
    fn looks_beside(&self) -> bool {
        self.lights.is_some_and(|key| key.shadows.is_some()) || self.reflections > 0
    }
}

impl ViewMaker<'_, '_> {
    /// Prepares a view, and adds its volumes to the list of all; `None` if it sees none.
    fn prepare(
        &mut self,
        of: &ViewDataItem,
        all: &mut Vec<gpu_data::Volume>,
    ) -> Option<(ViewResources, ViewPipelines)> {
        let wishes = self.wishes(of);
        let (picture, quality) = (wishes.picture, &wishes.quality);
        let mut clip_from_view = of.view.clip_from_view;
        if let Some(jitter) = of.jitter {
            jitter.jitter_projection(&mut clip_from_view, picture.as_vec2());
        }
        let rays = ViewRays::new(clip_from_view.as_dmat4())?;
        if picture.min_element() == 0 {
            return None;
        }
        let world_from_view = affine(of.view.world_from_view.affine());
        let eye = Eye { rays: &rays, world_from_view, size: picture };

        let beside = if wishes.looks_beside() {
            self.volumes.beside(&of.seen.0, &of.layers.cloned().unwrap_or_default())
        } else {
            Vec::new()
        };
        let mut ids = [of.seen.0.clone(), beside];
        let many =
            wishes.looks_beside() && ids.iter().map(Vec::len).sum::<usize>() > hierarchy::FEW;
        if many {
            ids.iter_mut().for_each(|ids| hierarchy::sort(ids, &self.volumes));
        }
        let made = ViewEntries { pool: &self.pool, eye, quality, left_out: wishes.left_out.0 };
        let (first, shown) = (all.len(), (wishes.is_lit(), wishes.reflections > 0));
        let ids = ids.each_ref().map(Vec::as_slice);
        let list = ViewList::new(made, ids, &self.volumes, shown, all, &mut self.warned)?;
        let own = &mut all[first..];

        let wanted = trace_key(of, &wishes, &list, many, &self.pool);
        let (before, present) = (of.pipelines_before, &wishes.lights_present);
        let pipelines = self.specialized.choose(&self.cache, wanted, before, present);
        let key = pipelines.key;
        let size = if key.scaled { upscale::rays(picture, quality.resolution) } else { picture };
        let clip_from_world = clip_from_view.as_dmat4() * DMat4::from(world_from_view.inverse());
        let mut most_tiles = 0;
        for (i, (data, entry)) in own.iter_mut().zip(&list.entries).enumerate() {
            data.kind = stand_in::kind_for(&key, data.kind, entry.sample_format());
            if !stand_in::reads_colors(&key, &entry.volume.extras.colors) {
                data.color_grids = gpu_data::NO_COLOR;
            }
            if i < list.seen {
                let range = entry.tile_range(clip_from_world, size);
                most_tiles = most_tiles.max(range.count());
                [data.tiles_first, data.tiles_last] = range.words();
            }
        }
        if key.many {
            let eye = world_from_view.transform_point3(rays.eye);
            let owners: Vec<_> = list.entries.iter().map(|entry| entry.volume).collect();
            hierarchy::fill(&mut own[..owners.len()], &owners, eye);
        }

        let layout = TileLayout::new(size, list.seen as u32);
        let mut data = gpu_data::View {
            exposure: non_negative(of.camera.exposure).min(MOST_EXPOSURE),
            volume_first: first as u32,
            volume_count: list.seen as u32,
            volumes_beside: (list.entries.len() - list.seen) as u32,
            size: size.to_array(),
            origin: of.view.viewport.xy().to_array(),
            steps_scale: non_negative(wishes.camera.steps_scale).max(1.0),
            reflections: wishes.reflections,
            slabs: quality.fog_slabs,
            picture: picture.to_array(),
            shadow_range: quality.shadow_range.min(FARTHEST),
            reflection_range: quality.reflection_range.min(FARTHEST),
            overlays: overlay_bits(wishes.camera.overlays),
            tile_words: layout.tile_words,
            group_bits: layout.group_bits,
            keeps_starts: u32::from(layout.keeps_starts),
            turn: turn_of(of.jitter, *self.frame),
            frame: of.jitter.map_or(0, |_| self.frame.0),
            most_frames: quality.accumulate,
            ..view_data(&rays, world_from_view, &self.suns)
        };
        let accumulated = key.accumulated.then(|| {
            let shown = (&key, pipelines.is_ready);
            let fingerprint = accumulate::fingerprint(shown, &data, own, &self.changes);
            let before = of.before.and_then(|before| before.accumulated.as_ref());
            Accumulated::new(before, fingerprint, picture, &self.device)
        });
        if let Some(accumulated) = &accumulated {
            accumulated.place(&mut data, key.scaled);
        }
        let motion = key.motion.then(|| {
            let seen = list.entries[..list.seen].iter().map(|entry| entry.volume);
            matrices(of.view, clip_from_view, of.view_before, seen)
        });
        let listed = list.listed.clone();
        let frame =
            ViewFrame { key: &key, data: &data, layout, most_tiles, motion, accumulated, listed };
        let resources = ViewResources::new(frame, of.before, &self.device, &mut self.textures);
        let (specialized, cache) = (&mut self.specialized, &self.cache);
        Some((resources, with_composites(pipelines, specialized, cache, of, &wishes, &list)))
    }

    /// Says what is wrong with them.
    fn wishes(&mut self, of: &ViewDataItem) -> Wishes {
        let mut camera = of.settings.cloned().unwrap_or_default();
        let (mut quality, wrong) = of.quality.copied().unwrap_or_default().sound();
        let left_out = of.left_out.copied().unwrap_or_default();
        if let Some(feature) = left_out.0 {
            feature.leave_out(&mut camera, &mut quality);
        }
        let picture = of.resolution.map_or(of.view.viewport.zw(), |size| size.0);
        let (is_jittered, device) = (of.jitter.is_some(), &self.device);
        let accumulates = accumulate::wanted(&quality, camera.mode, is_jittered, picture, device);
        for trouble in [wrong.map(Trouble::CameraQuality), accumulates.err()].into_iter().flatten()
        {
            if let Some(text) = self.warned.note(*of.camera_entity, "", trouble) {
                warn!("{text}");
            }
        }
        let lights_present = self.lights.key(
            quality.shadows,
            of.shadow_filter,
            of.environment,
            of.has_distance_fog,
            &self.suns,
        );
        // Parts of the picture and what is shown instead of it, are shown as they are.
        let distance_fog = of.has_distance_fog && camera.mode == VdbRenderMode::Lit;
        let lights = LightKey { distance_fog, ..lights_present };
        // Of what is only diffuse, no ray sees a reflection.
        let mirrors = matches!(camera.mode, VdbRenderMode::Lit | VdbRenderMode::Glossy);
        Wishes {
            lights: camera.mode.is_lit().then_some(lights),
            lights_present,
            reflections: if mirrors { quality.reflections } else { 0 },
            accumulates: accumulates.unwrap_or(false),
            camera,
            quality,
            left_out,
            picture,
        }
    }
}

/// The trace that a view asks for.
fn trace_key(
    of: &ViewDataItem,
    wishes: &Wishes,
    list: &ViewList,
    many: bool,
    pool: &VdbTreePool,
) -> TraceKey {
    let Wishes { camera, quality, .. } = wishes;
    let fogs = list.kinds.has([KIND_FOG]) && wishes.shows_fog();
    let emission = list.kinds.has([KIND_EMISSION, KIND_BLACKBODY]);
    let motion_vectors = of.prepass.is_some_and(|all| all.motion_vectors.is_some());
    TraceKey {
        multisampled: of.msaa.samples() > 1,
        surfaces: list.kinds.has([KIND_SURFACE]),
        smooth: list.kinds.has([KIND_SMOOTH]),
        fogs: fogs || emission,
        many,
        beams: quality.traversal == VdbTraversal::HddaSdf,
        page_bits: pool.page_bits(),
        format: pool.format(),
        traversal: quality.traversal,
        mode: camera.mode,
        lights: wishes.lights,
        motion: of.has_motion && motion_vectors,
        reflections: wishes.reflections > 0,
        fog_steps: fogs && list.fog_steps,
        overlays: camera.overlays != VdbOverlays::default(),
        emission,
        blackbody: list.kinds.has([KIND_BLACKBODY]),
        colors: list.colors,
        multiple_scattering: camera.multiple_scattering && fogs && wishes.is_lit(),
        scaled: quality.resolution < 1.0,
        accumulated: wishes.accumulates,
    }
}

/// Adds the pipelines that draw what is traced.
fn with_composites(
    pipelines: ViewPipelines,
    specialized: &mut Specialized,
    cache: &PipelineCache,
    of: &ViewDataItem,
    wishes: &Wishes,
    list: &ViewList,
) -> ViewPipelines {
    let tone = (!of.camera.hdr).then(|| ToneKey {
        tonemapping: of.tonemapping.copied().unwrap_or(Tonemapping::None),
        dither: of.dither.is_some_and(|dither| *dither == DebandDither::Enabled),
    });
    let tone = tone.filter(|tone| tone.tonemapping != Tonemapping::None);
    let key = &pipelines.key;
    let mut composite = |fog_alone| {
        let key = CompositeKey {
            format: of.view.target_format,
            samples: of.msaa.samples(),
            tone,
            fog_alone,
            motion: key.motion,
            emission: key.emission,
        };
        specialized.composite(cache, key)
    };
    let shows_fog = list.kinds_seen.has([KIND_FOG, KIND_EMISSION, KIND_BLACKBODY]);
    // Steps are shown where no surface is, too.
    // So is a surface in less than half of the frames that are put together.
    let alone = (shows_fog && wishes.shows_fog())
        || wishes.camera.mode == VdbRenderMode::Steps
        || key.accumulated;
    ViewPipelines {
        surface: list.kinds_seen.has([KIND_SURFACE, KIND_SMOOTH]).then(|| composite(false)),
        fog: alone.then(|| composite(true)),
        tonemaps: tone.is_some(),
        ..pipelines
    }
}

pub(super) fn view_data(
    rays: &ViewRays,
    world_from_view: DAffine3,
    suns: &ExtractedSuns,
) -> gpu_data::View {
    let mut own = [[0.0; 4]; gpu_data::MOST_SUNS];
    let mut disks = [[0.0; 4]; gpu_data::MOST_SUNS];
    for ((own, disk), sun) in own.iter_mut().zip(&mut disks).zip(&suns.0) {
        *own = sun.direction.extend(sun.factor.min(MOST_FACTOR)).to_array();
        *disk = [(0.5 * sun.angular_diameter).tan(), sun.samples as f32, 0.0, 0.0];
    }
    let world = |v| world_from_view.transform_vector3(v).as_vec3().to_array();
    gpu_data::View {
        t_from_depth: rays.t_from_depth.map(|x| x as f32),
        depth_from_t: rays.depth_from_t.map(|x| x as f32),
        dir: world(rays.dir),
        dir_x: world(rays.dir_x),
        dir_y: world(rays.dir_y),
        eye: world_from_view.transform_point3(rays.eye).as_vec3().to_array(),
        eye_x: world(rays.eye_x),
        eye_y: world(rays.eye_y),
        t_near: rays.t_near as f32,
        t_far: rays.t_far as f32,
        suns: own,
        disks,
        sun_count: suns.0.len().min(gpu_data::MOST_SUNS) as u32,
        ..default()
    }
}

/// What a frame adds to chance, from 0 to 1: nothing, unless frames of the view are put together.
pub(super) fn turn_of(jitter: Option<&TemporalJitter>, frame: FrameCount) -> f32 {
    jitter.map_or(0.0, |_| accumulate::golden(frame.0))
}

fn overlay_bits(overlays: VdbOverlays) -> u32 {
    u32::from(overlays.leaves) | u32::from(overlays.lower) << 1 | u32::from(overlays.upper) << 2
}
