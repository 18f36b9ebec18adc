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
    Buffer, BufferInitDescriptor, BufferUsages, PipelineCache, RawBufferVec, TextureDescriptor,
    TextureDimension, TextureFormat, TextureUsages,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::{CachedTexture, TextureCache};
use bevy::render::view::{ExtractedView, Msaa};

use super::accumulate::{self, Accumulated};
use super::bind::ViewBindGroups;
use super::changes::SceneChanges;
use super::entries::ViewEntries;
use super::extract::{ExtractedEnvironment, ExtractedSuns, ExtractedVolumes, non_negative};
use super::extras::color_data;
use super::find::ViewVolumes;
use super::gpu_data;
use super::gpu_tree::VdbTreePool;
use super::hierarchy;
use super::lights::{LightKey, Lights};
use super::motion::{ViewMotion, matrices};
use super::pipeline::{CompositeKey, ToneKey, TraceKey, ViewPipelines};
use super::stand_in::{self, Specialized};
use super::tiles::{self, TileLayout};
use super::upscale::{self, Upscaled};
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
    /// And in place of that, where frames are put together.
    pub accumulated: Option<Accumulated>,
    /// Rays, and pixels of the viewport.
    pub size: UVec2,
    pub picture: UVec2,
}

impl ViewResources {
    /// What the composite shows: colour, depth, and what moves.
    pub fn shown(&self) -> (&CachedTexture, &CachedTexture, Option<&CachedTexture>) {
        let own = match &self.upscaled {
            Some(upscaled) => (&upscaled.color, &upscaled.depth, upscaled.moving.as_ref()),
            None => (&self.color, &self.depth, self.motion.as_ref().map(|motion| &motion.moving)),
        };
        match self.accumulated.as_ref().and_then(Accumulated::shown) {
            Some(mean) => (&mean.color, &mean.depth, own.2),
            None => own,
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
    (Option<&'a VdbCamera>, Option<&'a VdbQuality>, Option<&'a LeftOut>, &'a MainEntity),
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
    (suns, frame, changes): (Res<ExtractedSuns>, Res<FrameCount>, Res<SceneChanges>),
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
        (settings, quality, left_out, camera_entity),
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
        let mut settings = settings.cloned().unwrap_or_default();
        let (mut quality, wrong) = quality.copied().unwrap_or_default().sound();
        if let Some(name) = wrong
            && let Some(text) = warned.note(*camera_entity, "", Trouble::CameraQuality(name))
        {
            warn!("{text}");
        }
        let left_out = left_out.and_then(|left_out| left_out.0);
        if let Some(feature) = left_out {
            feature.leave_out(&mut settings, &mut quality);
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
        let present =
            lights.key(quality.shadows, shadow_filter, environment, has_distance_fog, &suns);
        let lights = settings.mode.is_lit().then_some(LightKey { distance_fog, ..present });
        // Of what is only diffuse, no ray sees a reflection.
        let mirrors = matches!(settings.mode, VdbRenderMode::Lit | VdbRenderMode::Glossy);
        let reflections = if mirrors { quality.reflections } else { 0 };
        let is_lit = settings.mode.is_lit();
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
        let made = rays.as_ref().filter(|_| picture.min_element() > 0).map(|rays| {
            let eye = Eye { rays, world_from_view, size: picture };
            ViewEntries { pool: &pool, eye, quality: &quality, left_out }
        });
        let list = volume_buffer.0.values_mut();
        let first = list.len();
        let mut entries = Vec::with_capacity(seen.len() + beside.len());
        for entity in seen {
            let (Some(made), Some(volume)) = (&made, volumes.0.get(entity)) else { continue };
            for (data, entry) in made.of(*entity, volume, is_lit, Some(&mut warned)) {
                list.push(data);
                entries.push(entry);
            }
        }
        let count = entries.len();
        let has = kinds(&list[first..]);
        let shows = [gpu_data::KIND_SURFACE, gpu_data::KIND_SMOOTH, gpu_data::KIND_FOG].map(&has);
        let shows_fire = has(gpu_data::KIND_EMISSION) || has(gpu_data::KIND_BLACKBODY);
        let Some(made) = made.filter(|_| count > 0) else {
            commands.entity(entity).remove::<(ViewResources, ViewBindGroups, ViewPipelines)>();
            continue;
        };
        for entity in beside {
            let Some(volume) = volumes.0.get(entity) else { continue };
            // Fire throws no shadows, but mirrors show it.
            for (data, entry) in made.of(*entity, volume, reflections > 0 && is_lit, None) {
                list.push(data);
                entries.push(entry);
            }
        }
        let beside = entries.len() - count;
        let has = kinds(&list[first..]);
        let traces = [gpu_data::KIND_SURFACE, gpu_data::KIND_SMOOTH, gpu_data::KIND_FOG].map(&has);
        let blackbody = has(gpu_data::KIND_BLACKBODY);
        let emission = blackbody || has(gpu_data::KIND_EMISSION);
        // Colours come behind all that rays can meet.
        let view_of = (made.eye.rays, world_from_view);
        let mut colors = false;
        for (i, entry) in entries.iter().enumerate().filter(|_| is_lit) {
            let kind = list[first + i].kind;
            if matches!(kind, gpu_data::KIND_SURFACE | gpu_data::KIND_SMOOTH)
                && let Some(data) = color_data(entry.volume, &pool, view_of)
            {
                colors = true;
                list[first + i].color_grids = list.len() as u32;
                list.extend(data);
            }
        }
        // Other modes are about surfaces: fog is neither traced nor compiled for them.
        let with_fog = is_lit || settings.mode == VdbRenderMode::Steps;
        let fogs = traces[2] && with_fog;
        let accumulated =
            accumulate::wanted(&quality, settings.mode, jitter.is_some(), picture, &device);
        if let Err(why) = accumulated
            && let Some(text) = warned.note(*camera_entity, "", why)
        {
            warn!("{text}");
        }
        let wanted = TraceKey {
            multisampled: msaa.samples() > 1,
            surfaces: traces[0],
            smooth: traces[1],
            fogs: fogs || emission,
            many,
            beams: quality.traversal == VdbTraversal::HddaSdf,
            page_bits: pool.page_bits(),
            format: pool.format(),
            traversal: quality.traversal,
            mode: settings.mode,
            lights,
            motion: has_motion && prepass.is_some_and(|all| all.motion_vectors.is_some()),
            reflections: reflections > 0,
            fog_steps: fogs && list[first..].iter().any(steps_through),
            overlays: settings.overlays != VdbOverlays::default(),
            emission,
            blackbody,
            colors,
            multiple_scattering: settings.multiple_scattering && traces[2] && is_lit,
            scaled: quality.resolution < 1.0,
            accumulated: accumulated.unwrap_or(false),
        };
        let pipelines = specialized.choose(&pipeline_cache, wanted, pipelines_before, &present);
        let key = pipelines.key;
        let size = if key.scaled { upscale::rays(picture, quality.resolution) } else { picture };
        let clip_from_world = clip_from_view.as_dmat4() * DMat4::from(world_from_view.inverse());
        let mut most_tiles = 0;
        for (i, (data, entry)) in list[first..].iter_mut().zip(&entries).enumerate() {
            data.kind = stand_in::kind_for(&key, data.kind, entry.sample_format());
            if !stand_in::reads_colors(&key, &entry.volume.extras.colors) {
                data.color_grids = gpu_data::NO_COLOR;
            }
            if i < count {
                let range = entry.tile_range(clip_from_world, size);
                most_tiles = most_tiles.max(range.count());
                [data.tiles_first, data.tiles_last] = range.words();
            }
        }
        if key.many {
            let eye = world_from_view.transform_point3(made.eye.rays.eye);
            let owners: Vec<_> = entries.iter().map(|entry| entry.volume).collect();
            hierarchy::fill(&mut list[first..first + owners.len()], &owners, eye);
        }
        let origin = view.viewport.xy();
        let layout = TileLayout::new(size, count as u32);
        let mut data = gpu_data::View {
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
            turn: turn_of(jitter, *frame),
            frame: jitter.map_or(0, |_| frame.0),
            most_frames: quality.accumulate,
            ..view_data(made.eye.rays, world_from_view, &suns)
        };
        let accumulated = key.accumulated.then(|| {
            let shown = (&key, pipelines.is_ready);
            let fingerprint = accumulate::fingerprint(shown, &data, &list[first..], &changes);
            let before = before.and_then(|before| before.accumulated.as_ref());
            Accumulated::new(before, fingerprint, picture, &device)
        });
        if let Some(accumulated) = &accumulated {
            accumulated.place(&mut data, key.scaled);
        }
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
            let seen = entries[..count].iter().map(|entry| entry.volume);
            let matrices = matrices(view, clip_from_view, view_before, seen);
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
            accumulated,
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
            emission: key.emission,
        };
        let mut composite =
            |fog_alone| specialized.composite(&pipeline_cache, composite_key(fog_alone));
        // Steps are shown where no surface is, too.
        // So is a surface in less than half of the frames that are put together.
        let alone = ((shows[2] || shows_fire) && with_fog)
            || settings.mode == VdbRenderMode::Steps
            || key.accumulated;
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

/// Whether a list has an entry of a kind.
fn kinds(list: &[gpu_data::Volume]) -> impl Fn(u32) -> bool + use<> {
    let all = list.iter().fold(0_u32, |all, volume| all | 1 << volume.kind);
    move |kind| all >> kind & 1 != 0
}

/// Whether a volume is fog that is sampled.
fn steps_through(volume: &gpu_data::Volume) -> bool {
    volume.kind == gpu_data::KIND_FOG && volume.fog_step > 0.0
}

fn overlay_bits(overlays: VdbOverlays) -> u32 {
    u32::from(overlays.leaves) | u32::from(overlays.lower) << 1 | u32::from(overlays.upper) << 2
}
