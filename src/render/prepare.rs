//! What each view needs this frame: its volumes, its rays, its textures. Nothing is made for a view
//! that sees no volume.

use bevy::camera::MainPassResolutionOverride;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::prepass::{MotionVectorPrepass, PreviousViewData, ViewPrepassTextures};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::diagnostic::FrameCount;
use bevy::image::ToExtents;
use bevy::light::ShadowFilteringMethod;
use bevy::math::{DAffine3, DMat4};
use bevy::pbr::DistanceFog;
use bevy::prelude::*;
use bevy::render::camera::{ExtractedCamera, TemporalJitter};
use bevy::render::render_resource::{
    Buffer, BufferInitDescriptor, BufferUsages, PipelineCache, RawBufferVec,
    SpecializedComputePipelines, SpecializedRenderPipelines, TextureDescriptor, TextureDimension,
    TextureFormat, TextureUsages,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::{CachedTexture, TextureCache};
use bevy::render::view::{ExtractedView, Msaa};

use super::bind::ViewBindGroups;
use super::extract::{ExtractedEnvironment, ExtractedSuns, ExtractedVolumes, non_negative};
use super::extras::{color_data, emission_data};
use super::find::ViewVolumes;
use super::gpu_data;
use super::gpu_tree::VdbTreePool;
use super::hierarchy;
use super::lights::Lights;
use super::motion::{ViewMotion, matrices};
use super::pipeline::{
    BeamsPipeline, CompositeKey, CompositePipeline, ToneKey, TraceKey, TracePipeline, ViewPipelines,
};
use super::tiles::{self, TileLayout};
use super::volume::{Eye, Shown, affine, volume_data};
use super::warnings::Warned;
use crate::{VdbCamera, VdbOverlays, VdbRenderMode, VdbTraversal};
use vdb_core::view::ViewRays;

/// The volumes of all views of the frame.
#[derive(Resource)]
pub(super) struct VolumeBuffer(pub RawBufferVec<gpu_data::Volume>);

impl Default for VolumeBuffer {
    fn default() -> Self {
        Self(RawBufferVec::new(BufferUsages::STORAGE))
    }
}

/// On views that see at least one volume: what the passes need.
#[derive(Component)]
pub(super) struct ViewResources {
    pub view: Buffer,
    pub placement: Buffer,
    pub color: CachedTexture,
    pub depth: CachedTexture,
    /// What the tiles know of the volumes, and how it is laid out.
    pub tile_data: Option<(Buffer, TileLayout)>,
    pub motion: Option<ViewMotion>,
    pub volumes: u32,
    /// The most tiles that show one of them.
    pub most_tiles: u32,
    size: UVec2,
}

impl ViewResources {
    /// Tiles of the picture.
    pub fn tiles(&self) -> UVec2 {
        tiles::tiles(self.size)
    }
}

/// How often a ray is sent on, at most.
const MOST_REFLECTIONS: u32 = 16;
/// Voxels between samples of fog.
const LEAST_FOG_STEP: f32 = 0.25;
const MOST_FOG_STEP: f32 = 16.0;
/// What turns luminance into the camera's values. Infinities are not for WGSL: with this and what
/// materials are capped to, products stay within f32.
const MOST_EXPOSURE: f32 = 1e12;
/// Of a sun's illuminance.
const MOST_FACTOR: f32 = 1e6;

type ViewData<'a> = (
    Entity,
    &'a ViewVolumes,
    &'a ExtractedView,
    &'a ExtractedCamera,
    Option<&'a VdbCamera>,
    &'a Msaa,
    Option<&'a RenderLayers>,
    (Option<&'a ShadowFilteringMethod>, Option<&'a ExtractedEnvironment>, Has<DistanceFog>),
    Option<&'a TemporalJitter>,
    Option<&'a MainPassResolutionOverride>,
    Option<&'a Tonemapping>,
    Option<&'a DebandDither>,
    (Has<MotionVectorPrepass>, Option<&'a ViewPrepassTextures>, Option<&'a PreviousViewData>),
    Option<&'a ViewResources>,
);

/// Makes buffers, textures and pipelines for each view that sees a volume.
pub(super) fn prepare_views(
    mut commands: Commands,
    views: Query<ViewData>,
    volumes: Res<ExtractedVolumes>,
    (suns, frame): (Res<ExtractedSuns>, Res<FrameCount>),
    lights: Lights,
    pool: Res<VdbTreePool>,
    mut volume_buffer: ResMut<VolumeBuffer>,
    mut warned: ResMut<Warned>,
    (device, queue): (Res<RenderDevice>, Res<RenderQueue>),
    mut textures: ResMut<TextureCache>,
    pipeline_cache: Res<PipelineCache>,
    (beams_pipeline, trace_pipeline, composite_pipeline): (
        Res<BeamsPipeline>,
        Res<TracePipeline>,
        Res<CompositePipeline>,
    ),
    mut beams_pipelines: ResMut<SpecializedComputePipelines<BeamsPipeline>>,
    mut trace_pipelines: ResMut<SpecializedComputePipelines<TracePipeline>>,
    mut composite_pipelines: ResMut<SpecializedRenderPipelines<CompositePipeline>>,
) {
    volume_buffer.0.clear();
    for (
        entity,
        seen,
        view,
        camera,
        settings,
        msaa,
        layers,
        (shadow_filter, environment, has_distance_fog),
        jitter,
        resolution,
        tonemapping,
        dither,
        (has_motion, prepass, view_before),
        before,
    ) in &views
    {
        let settings = settings.cloned().unwrap_or_default();
        let size = resolution.map_or(view.viewport.zw(), |size| size.0);
        let mut clip_from_view = view.clip_from_view;
        if let Some(jitter) = jitter {
            jitter.jitter_projection(&mut clip_from_view, size.as_vec2());
        }
        let rays = ViewRays::new(clip_from_view.as_dmat4());
        let world_from_view = affine(view.world_from_view.affine());
        // Parts of the picture and what is shown instead of it, are shown as they are.
        let distance_fog = has_distance_fog && settings.mode == VdbRenderMode::Lit;
        let lights = settings
            .mode
            .is_lit()
            .then(|| lights.key(settings.shadows, shadow_filter, environment, distance_fog, &suns));
        // With less, steps would only cost.
        let fog_step = match non_negative(settings.fog_step) {
            0.0 => 0.0,
            step => step.clamp(LEAST_FOG_STEP, MOST_FOG_STEP),
        };
        // Of what is only diffuse, no ray sees a reflection.
        let mirrors = matches!(settings.mode, VdbRenderMode::Lit | VdbRenderMode::Glossy);
        let reflections = if mirrors { settings.reflections.min(MOST_REFLECTIONS) } else { 0 };
        let detail = f64::from(non_negative(settings.detail));
        let eye = rays.as_ref().map(|rays| Eye { rays, world_from_view, size });
        let show = |entity: &MainEntity| Shown::new(volumes.0.get(entity)?, &pool, eye?, detail);
        let is_lit = settings.mode.is_lit();
        let view_of = rays.as_ref().map(|rays| (rays, world_from_view));
        let first = volume_buffer.0.len();
        // Whose the entries are.
        let mut owners = Vec::new();
        let mut shown = Vec::with_capacity(seen.0.len());
        let mut most_tiles = 0;
        let clip_from_world = clip_from_view.as_dmat4() * DMat4::from(world_from_view.inverse());
        // What the view does not see may throw shadows into the picture, or be reflected there.
        let goes_on = lights.is_some_and(|key| key.shadows.is_some()) || reflections > 0;
        let beside = if goes_on {
            volumes.beside(&seen.0, &layers.cloned().unwrap_or_default())
        } else {
            Vec::new()
        };
        let mut lists = [seen.0.clone(), beside];
        let many = goes_on && lists.iter().map(Vec::len).sum::<usize>() > hierarchy::FEW;
        if many {
            lists.iter_mut().for_each(|list| hierarchy::sort(list, &volumes));
        }
        let [seen, beside] = &lists;
        for entity in seen {
            if let (Some(at_level), Some(eye)) = (show(entity), eye)
                && let Some(mut data) = volume_data(*entity, &at_level, eye, Some(&mut warned))
                && let Some(volume) = volumes.0.get(entity)
            {
                let range = at_level.tile_range(clip_from_world, size);
                most_tiles = most_tiles.max(range.count());
                [data.tiles_first, data.tiles_last] = range.words();
                volume_buffer.0.push(data);
                shown.push(volume);
            }
            if let (true, Some(view), Some(volume)) = (is_lit, view_of, volumes.0.get(entity)) {
                let tiles = (clip_from_world, size);
                let warned = Some(&mut *warned);
                for (data, range) in emission_data(*entity, volume, &pool, view, tiles, warned) {
                    most_tiles = most_tiles.max(range.count());
                    volume_buffer.0.push(data);
                    shown.push(volume);
                }
            }
        }
        owners.extend(&shown);
        let count = volume_buffer.0.len() - first;
        let has = |kind| volume_buffer.0.values()[first..].iter().any(|volume| volume.kind == kind);
        let shows = [gpu_data::KIND_SURFACE, gpu_data::KIND_SMOOTH, gpu_data::KIND_FOG].map(has);
        let shows_fire = has(gpu_data::KIND_EMISSION) || has(gpu_data::KIND_BLACKBODY);
        let (Some(view_rays), true) = (&rays, count > 0 && size.min_element() > 0) else {
            commands.entity(entity).remove::<(ViewResources, ViewBindGroups, ViewPipelines)>();
            continue;
        };
        for entity in beside {
            let Some(volume) = volumes.0.get(entity) else { continue };
            let own = show(entity).zip(eye);
            let own = own.and_then(|(shown, eye)| volume_data(*entity, &shown, eye, None));
            owners.extend(own.is_some().then_some(volume));
            volume_buffer.0.extend(own);
            // Fire throws no shadows, but mirrors show it.
            if reflections > 0 && is_lit {
                let tiles = (clip_from_world, size);
                let view = (view_rays, world_from_view);
                for (data, _) in emission_data(*entity, volume, &pool, view, tiles, None) {
                    volume_buffer.0.push(data);
                    owners.push(volume);
                }
            }
        }
        if many {
            let eye = world_from_view.transform_point3(view_rays.eye);
            hierarchy::fill(&mut volume_buffer.0.values_mut()[first..], &owners, eye);
        }
        let beside = owners.len() - count;
        let has = |kind| volume_buffer.0.values()[first..].iter().any(|volume| volume.kind == kind);
        let traces = [gpu_data::KIND_SURFACE, gpu_data::KIND_SMOOTH, gpu_data::KIND_FOG].map(has);
        let blackbody = has(gpu_data::KIND_BLACKBODY);
        let emission = blackbody || has(gpu_data::KIND_EMISSION);
        // Colours come behind all that rays can meet.
        let mut colors = false;
        for (i, volume) in owners.iter().enumerate().filter(|_| is_lit) {
            let kind = volume_buffer.0.values()[first + i].kind;
            if matches!(kind, gpu_data::KIND_SURFACE | gpu_data::KIND_SMOOTH)
                && let Some(data) = color_data(volume, &pool, (view_rays, world_from_view))
            {
                colors = true;
                volume_buffer.0.values_mut()[first + i].color_grids = volume_buffer.0.len() as u32;
                volume_buffer.0.extend(data);
            }
        }
        let origin = view.viewport.xy();
        let layout = TileLayout::new(size, count as u32);
        let data = gpu_data::View {
            exposure: non_negative(camera.exposure).min(MOST_EXPOSURE),
            volume_first: first as u32,
            volume_count: count as u32,
            volumes_beside: beside as u32,
            size: size.to_array(),
            origin: origin.to_array(),
            steps_scale: non_negative(settings.steps_scale).max(1.0),
            reflections,
            fog_step,
            overlays: overlay_bits(settings.overlays),
            tile_words: layout.tile_words,
            group_bits: layout.group_bits,
            keeps_starts: u32::from(layout.keeps_starts),
            turn: turn_of(jitter, *frame),
            ..view_data(view_rays, world_from_view, &suns)
        };
        let buffer = |label, contents: &[u8]| {
            device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some(label),
                contents,
                usage: BufferUsages::UNIFORM,
            })
        };
        let placement = gpu_data::Placement { origin: origin.to_array(), size: size.to_array() };
        let mut texture = |label, format| {
            textures.get(
                &device,
                TextureDescriptor {
                    label: Some(label),
                    size: size.to_extents(),
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: TextureDimension::D2,
                    format,
                    usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
                    view_formats: &[],
                },
            )
        };
        // Other modes are about surfaces: fog is neither traced nor compiled for them.
        let with_fog = settings.mode.is_lit() || settings.mode == VdbRenderMode::Steps;
        let beams = settings.traversal == VdbTraversal::HddaSdf;
        let tile_data = beams.then(|| {
            let kept = before.and_then(|before| before.tile_data.as_ref());
            (layout.buffer(kept.map(|(buffer, _)| buffer), &device), layout)
        });
        let has_motion = has_motion && prepass.is_some_and(|all| all.motion_vectors.is_some());
        let motion = has_motion.then(|| {
            let matrices = matrices(view, clip_from_view, view_before, shown.into_iter());
            let matrices = device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some("vdb_motion"),
                contents: bytemuck::cast_slice(&matrices),
                usage: BufferUsages::STORAGE,
            });
            ViewMotion { moving: texture("vdb_moving", TextureFormat::Rg32Uint), matrices }
        });
        let resources = ViewResources {
            motion,
            tile_data,
            volumes: count as u32,
            most_tiles,
            view: buffer("vdb_view", bytemuck::bytes_of(&data)),
            placement: buffer("vdb_placement", bytemuck::bytes_of(&placement)),
            color: texture("vdb_color", TextureFormat::Rgba16Float),
            depth: texture("vdb_depth", TextureFormat::R32Float),
            size,
        };
        let trace_key = TraceKey {
            multisampled: msaa.samples() > 1,
            surfaces: traces[0],
            smooth: traces[1],
            fogs: (traces[2] || emission) && with_fog,
            many,
            beams,
            page_bits: pool.page_bits(),
            format: pool.format(),
            traversal: settings.traversal,
            mode: settings.mode,
            lights,
            motion: has_motion,
            reflections: reflections > 0,
            fog_steps: fog_step > 0.0 && traces[2] && with_fog,
            overlays: settings.overlays != VdbOverlays::default(),
            emission,
            blackbody,
            colors,
            multiple_scattering: settings.multiple_scattering
                && traces[2]
                && settings.mode.is_lit(),
        };
        let tone = (!camera.hdr).then(|| ToneKey {
            tonemapping: tonemapping.copied().unwrap_or(Tonemapping::None),
            dither: dither.is_some_and(|dither| *dither == DebandDither::Enabled),
        });
        let composite_key = |fog_alone| CompositeKey {
            format: view.target_format,
            samples: msaa.samples(),
            tone: tone.filter(|tone| tone.tonemapping != Tonemapping::None),
            fog_alone,
            motion: has_motion,
            emission,
        };
        let mut composite = |fog_alone: bool| {
            composite_pipelines.specialize(
                &pipeline_cache,
                &composite_pipeline,
                composite_key(fog_alone),
            )
        };
        // Steps are shown where no surface is, too.
        let alone = ((shows[2] || shows_fire) && with_fog) || settings.mode == VdbRenderMode::Steps;
        let pipelines = ViewPipelines {
            beams: beams.then(|| {
                beams_pipelines.specialize(&pipeline_cache, &beams_pipeline, pool.page_bits())
            }),
            trace: trace_pipelines.specialize(&pipeline_cache, &trace_pipeline, trace_key),
            surface: (shows[0] || shows[1]).then(|| composite(false)),
            fog: alone.then(|| composite(true)),
            multisampled: trace_key.multisampled,
            lights,
            tonemaps: composite_key(false).tone.is_some(),
            motion: has_motion,
            blackbody,
        };
        commands.entity(entity).insert((resources, pipelines));
    }
    warned.end_frame();
    volume_buffer.0.write_buffer(&device, &queue);
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
    // Multiples of the golden section are spread evenly.
    jitter.map_or(0.0, |_| (f64::from(frame.0) * 0.618_033_988_749_895).fract() as f32)
}

fn overlay_bits(overlays: VdbOverlays) -> u32 {
    u32::from(overlays.leaves) | u32::from(overlays.lower) << 1 | u32::from(overlays.upper) << 2
}
