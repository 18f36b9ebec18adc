//! What each view needs this frame: its volumes, its rays, its textures. Nothing is made for a view
//! that sees no volume.

use bevy::camera::MainPassResolutionOverride;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::prepass::{MotionVectorPrepass, PreviousViewData, ViewPrepassTextures};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::image::ToExtents;
use bevy::light::ShadowFilteringMethod;
use bevy::math::{DAffine3, DMat4};
use bevy::pbr::DistanceFog;
use bevy::prelude::*;
use bevy::render::camera::{ExtractedCamera, TemporalJitter};
use bevy::render::render_resource::{
    Buffer, BufferInitDescriptor, BufferUsages, PipelineCache, RawBufferVec, TextureDescriptor,
    TextureDimension, TextureFormat, TextureUsages,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::{CachedTexture, TextureCache};
use bevy::render::view::{ExtractedView, Msaa};

use super::bind::ViewBindGroups;
use super::extract::{ExtractedEnvironment, ExtractedSuns, ExtractedVolumes, non_negative};
use super::find::ViewVolumes;
use super::gpu_data;
use super::gpu_tree::VdbTreePool;
use super::lights::{LightKey, Lights};
use super::motion::{ViewMotion, matrices};
use super::pipeline::{CompositeKey, ToneKey, TraceKey, ViewPipelines};
use super::stand_in::{self, Specialized};
use super::tiles::{self, TileLayout};
use super::upscale::{self, Upscaled};
use super::volume::{Eye, Shown, affine, volume_data};
use super::warnings::{Trouble, Warned};
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
    /// Those that shadows and reflections look at, and the view does not.
    pub volumes_beside: u32,
    /// The most tiles that show one of them.
    pub most_tiles: u32,
    /// What is shown in place of what is traced, where there are fewer rays than pixels.
    pub upscaled: Option<Upscaled>,
    /// Rays, and pixels of the viewport.
    pub size: UVec2,
    pub picture: UVec2,
}

impl ViewResources {
    /// What the composite shows: colour, depth, and what moves.
    pub fn shown(&self) -> (&CachedTexture, &CachedTexture, Option<&CachedTexture>) {
        match &self.upscaled {
            Some(upscaled) => (&upscaled.color, &upscaled.depth, upscaled.moving.as_ref()),
            None => (&self.color, &self.depth, self.motion.as_ref().map(|motion| &motion.moving)),
        }
    }

    /// Tiles of rays.
    pub fn tiles(&self) -> UVec2 {
        tiles::tiles(self.size)
    }
}

/// What turns luminance into the camera's values. Infinities are not for WGSL: with this and what
/// materials are capped to, products stay within f32.
const MOST_EXPOSURE: f32 = 1e12;
/// World units that a ray goes, at most: `FAR` of the shaders.
const FARTHEST: f32 = 1e30;
/// Of the texture that says what moves.
const MOVING: TextureFormat = TextureFormat::Rg32Uint;
/// Of a sun's illuminance.
const MOST_FACTOR: f32 = 1e6;

type ViewData<'a> = (
    Entity,
    &'a ViewVolumes,
    &'a ExtractedView,
    &'a ExtractedCamera,
    (Option<&'a VdbCamera>, Option<&'a VdbQuality>, &'a MainEntity),
    &'a Msaa,
    Option<&'a RenderLayers>,
    (Option<&'a ShadowFilteringMethod>, Option<&'a ExtractedEnvironment>, Has<DistanceFog>),
    Option<&'a TemporalJitter>,
    Option<&'a MainPassResolutionOverride>,
    Option<&'a Tonemapping>,
    Option<&'a DebandDither>,
    (Has<MotionVectorPrepass>, Option<&'a ViewPrepassTextures>, Option<&'a PreviousViewData>),
    (Option<&'a ViewResources>, Option<&'a ViewPipelines>),
);

/// Makes buffers, textures and pipelines for each view that sees a volume.
pub(super) fn prepare_views(
    mut commands: Commands,
    views: Query<ViewData>,
    volumes: Res<ExtractedVolumes>,
    suns: Res<ExtractedSuns>,
    lights: Lights,
    pool: Res<VdbTreePool>,
    mut volume_buffer: ResMut<VolumeBuffer>,
    mut warned: ResMut<Warned>,
    (device, queue): (Res<RenderDevice>, Res<RenderQueue>),
    mut textures: ResMut<TextureCache>,
    pipeline_cache: Res<PipelineCache>,
    mut specialized: Specialized,
) {
    volume_buffer.0.clear();
    for (
        entity,
        seen,
        view,
        camera,
        (settings, quality, camera_entity),
        msaa,
        layers,
        (shadow_filter, environment, has_distance_fog),
        jitter,
        resolution,
        tonemapping,
        dither,
        (has_motion, prepass, view_before),
        (before, pipelines_before),
    ) in &views
    {
        let settings = settings.cloned().unwrap_or_default();
        let (quality, wrong) = quality.copied().unwrap_or_default().sound();
        if let Some(name) = wrong
            && let Some(text) = warned.note(*camera_entity, "", Trouble::CameraQuality(name))
        {
            warn!("{text}");
        }
        let picture = resolution.map_or(view.viewport.zw(), |size| size.0);
        let mut clip_from_view = view.clip_from_view;
        if let Some(jitter) = jitter {
            jitter.jitter_projection(&mut clip_from_view, picture.as_vec2());
        }
        let rays = ViewRays::new(clip_from_view.as_dmat4());
        let world_from_view = affine(view.world_from_view.affine());
        // Parts of the picture and what is shown instead of it, are shown as they are.
        let distance_fog = has_distance_fog && settings.mode == VdbRenderMode::Lit;
        let present = lights.key(quality.shadows, shadow_filter, environment, has_distance_fog);
        let lights = settings.mode.is_lit().then_some(LightKey { distance_fog, ..present });
        // Of what is only diffuse, no ray sees a reflection.
        let mirrors = matches!(settings.mode, VdbRenderMode::Lit | VdbRenderMode::Glossy);
        let reflections = if mirrors { quality.reflections } else { 0 };
        let eye = rays.as_ref().map(|rays| Eye { rays, world_from_view, size: picture });
        let detail = f64::from(quality.detail);
        let show = |entity: &MainEntity| Shown::new(volumes.0.get(entity)?, &pool, eye?, detail);
        let mut levels = Vec::with_capacity(seen.0.len());
        let first = volume_buffer.0.len();
        let mut shown = Vec::with_capacity(seen.0.len());
        for entity in &seen.0 {
            if let (Some(at_level), Some(eye)) = (show(entity), eye)
                && let Some(data) =
                    volume_data(*entity, &at_level, eye, &quality, Some(&mut warned))
                && let Some(volume) = volumes.0.get(entity)
            {
                levels.push(at_level);
                volume_buffer.0.push(data);
                shown.push(volume);
            }
        }
        let count = volume_buffer.0.len() - first;
        let has = |kind| volume_buffer.0.values()[first..].iter().any(|volume| volume.kind == kind);
        let shows = [gpu_data::KIND_SURFACE, gpu_data::KIND_SMOOTH, gpu_data::KIND_FOG].map(has);
        let (Some(view_rays), true) = (&rays, count > 0 && picture.min_element() > 0) else {
            commands.entity(entity).remove::<(ViewResources, ViewBindGroups, ViewPipelines)>();
            continue;
        };
        // What the view does not see may throw shadows into the picture, or be reflected there.
        if lights.is_some_and(|key| key.shadows.is_some()) || reflections > 0 {
            let layers = layers.cloned().unwrap_or_default();
            for entity in volumes.beside(&seen.0, &layers) {
                if let (Some(at_level), Some(eye)) = (show(&entity), eye)
                    && let Some(data) = volume_data(entity, &at_level, eye, &quality, None)
                    && let Some(volume) = volumes.0.get(&entity)
                {
                    volume_buffer.0.push(data);
                    shown.push(volume);
                }
            }
        }
        let beside = volume_buffer.0.len() - first - count;
        let has = |kind| volume_buffer.0.values()[first..].iter().any(|volume| volume.kind == kind);
        let traces = [gpu_data::KIND_SURFACE, gpu_data::KIND_SMOOTH, gpu_data::KIND_FOG].map(has);
        // Other modes are about surfaces: fog is neither traced nor compiled for them.
        let with_fog = settings.mode.is_lit() || settings.mode == VdbRenderMode::Steps;
        let fogs = traces[2] && with_fog;
        let wanted = TraceKey {
            multisampled: msaa.samples() > 1,
            surfaces: traces[0],
            smooth: traces[1],
            fogs,
            beams: quality.traversal == VdbTraversal::HddaSdf,
            page_bits: pool.page_bits(),
            format: pool.format(),
            traversal: quality.traversal,
            mode: settings.mode,
            lights,
            motion: has_motion && prepass.is_some_and(|all| all.motion_vectors.is_some()),
            reflections: reflections > 0,
            fog_steps: fogs && volume_buffer.0.values()[first..].iter().any(steps_through),
            overlays: settings.overlays != VdbOverlays::default(),
            scaled: quality.resolution < 1.0,
        };
        let pipelines = specialized.choose(&pipeline_cache, wanted, pipelines_before, &present);
        let key = pipelines.key;
        let size = if key.scaled { upscale::rays(picture, quality.resolution) } else { picture };
        let clip_from_world = clip_from_view.as_dmat4() * DMat4::from(world_from_view.inverse());
        let mut most_tiles = 0;
        for (i, volume) in shown.iter().enumerate() {
            let data = &mut volume_buffer.0.values_mut()[first + i];
            data.kind = stand_in::kind_for(&key, data.kind, volume.packed.sample_format());
            if let Some(at_level) = levels.get(i) {
                let range = at_level.tile_range(clip_from_world, size);
                most_tiles = most_tiles.max(range.count());
                [data.tiles_first, data.tiles_last] = range.words();
            }
        }
        shown.truncate(count);
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
            slabs: quality.fog_slabs,
            picture: picture.to_array(),
            shadow_range: quality.shadow_range.min(FARTHEST),
            reflection_range: quality.reflection_range.min(FARTHEST),
            overlays: overlay_bits(settings.overlays),
            tile_words: layout.tile_words,
            group_bits: layout.group_bits,
            keeps_starts: u32::from(layout.keeps_starts),
            ..view_data(view_rays, world_from_view, &suns)
        };
        let buffer = |label, contents: &[u8]| {
            device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some(label),
                contents,
                usage: BufferUsages::UNIFORM,
            })
        };
        let placement = gpu_data::Placement { origin: origin.to_array(), size: picture.to_array() };
        let mut texture = |label, format, size: UVec2| {
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
        let tile_data = key.beams.then(|| {
            let kept = before.and_then(|before| before.tile_data.as_ref());
            (layout.buffer(kept.map(|(buffer, _)| buffer), &device), layout)
        });
        let motion = key.motion.then(|| {
            let matrices = matrices(view, clip_from_view, view_before, shown.into_iter());
            let matrices = device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some("vdb_motion"),
                contents: bytemuck::cast_slice(&matrices),
                usage: BufferUsages::STORAGE,
            });
            ViewMotion { moving: texture("vdb_moving", MOVING, size), matrices }
        });
        let upscaled = key.scaled.then(|| Upscaled {
            color: texture("vdb_color_upscaled", TextureFormat::Rgba16Float, picture),
            depth: texture("vdb_depth_upscaled", TextureFormat::R32Float, picture),
            moving: key.motion.then(|| texture("vdb_moving_upscaled", MOVING, picture)),
        });
        let resources = ViewResources {
            motion,
            upscaled,
            tile_data,
            volumes: count as u32,
            volumes_beside: beside as u32,
            most_tiles,
            view: buffer("vdb_view", bytemuck::bytes_of(&data)),
            placement: buffer("vdb_placement", bytemuck::bytes_of(&placement)),
            color: texture("vdb_color", TextureFormat::Rgba16Float, size),
            depth: texture("vdb_depth", TextureFormat::R32Float, size),
            size,
            picture,
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
            motion: key.motion,
        };
        let mut composite =
            |fog_alone| specialized.composite(&pipeline_cache, composite_key(fog_alone));
        // Steps are shown where no surface is, too.
        let alone = (shows[2] && with_fog) || settings.mode == VdbRenderMode::Steps;
        let pipelines = ViewPipelines {
            surface: (shows[0] || shows[1]).then(|| composite(false)),
            fog: alone.then(|| composite(true)),
            tonemaps: composite_key(false).tone.is_some(),
            ..pipelines
        };
        commands.entity(entity).insert((resources, pipelines));
    }
    warned.end_frame();
    volume_buffer.0.write_buffer(&device, &queue);
}

fn view_data(rays: &ViewRays, world_from_view: DAffine3, suns: &ExtractedSuns) -> gpu_data::View {
    let mut own = [[0.0; 4]; gpu_data::MOST_SUNS];
    for (own, (direction, factor)) in own.iter_mut().zip(&suns.0) {
        *own = direction.extend(factor.min(MOST_FACTOR)).to_array();
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
        sun_count: suns.0.len().min(gpu_data::MOST_SUNS) as u32,
        ..default()
    }
}

/// Whether a volume is fog that is sampled.
fn steps_through(volume: &gpu_data::Volume) -> bool {
    volume.kind == gpu_data::KIND_FOG && volume.fog_step > 0.0
}

fn overlay_bits(overlays: VdbOverlays) -> u32 {
    u32::from(overlays.leaves) | u32::from(overlays.lower) << 1 | u32::from(overlays.upper) << 2
}
