//! What each view needs this frame: its volumes, its rays, its textures. Nothing is made for a view
//! that sees no volume.

use std::any::TypeId;

use bevy::camera::MainPassResolutionOverride;
use bevy::core_pipeline::tonemapping::{
    DebandDither, Tonemapping, TonemappingLuts, get_lut_bindings,
};
use bevy::image::ToExtents;
use bevy::math::{DAffine3, DMat3};
use bevy::prelude::*;
use bevy::render::camera::{ExtractedCamera, TemporalJitter};
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, Buffer, BufferDescriptor, BufferInitDescriptor, BufferUsages,
    DynamicBindGroupEntries, PipelineCache, RawBufferVec, SpecializedComputePipelines,
    SpecializedRenderPipelines, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::{CachedTexture, FallbackImage, GpuImage, TextureCache};
use bevy::render::view::{
    ExtractedView, Msaa, RenderVisibleEntities, ViewDepthTexture, ViewUniforms,
};

use super::extract::{
    ExtractedAmbient, ExtractedSun, ExtractedVolume, ExtractedVolumes, non_negative,
};
use super::gpu_data;
use super::gpu_tree::VdbTreePool;
use super::pipeline::{
    BeamsPipeline, CompositeKey, CompositePipeline, ToneKey, TraceKey, TracePipeline, ViewPipelines,
};
use super::warnings::{Trouble, Warned};
use crate::{VdbCamera, VdbRenderMode, VdbTraversal, VdbVolume};
use vdb_core::pack::PackKind;
use vdb_core::view::{CannotShow, GpuRays, LatticeRays, ViewRays};

/// The volumes of all views of the frame.
#[derive(Resource)]
pub(super) struct VolumeBuffer(RawBufferVec<gpu_data::Volume>);

impl Default for VolumeBuffer {
    fn default() -> Self {
        Self(RawBufferVec::new(BufferUsages::STORAGE))
    }
}

/// On views that see at least one volume: which.
#[derive(Component, Debug)]
pub(super) struct ViewVolumes(Vec<MainEntity>);

/// On views that see at least one volume: what the passes need.
#[derive(Component)]
pub(super) struct ViewResources {
    view: Buffer,
    placement: Buffer,
    color: CachedTexture,
    depth: CachedTexture,
    /// Where the rays of each tile can begin, for each volume.
    starts: Option<Buffer>,
    pub volumes: u32,
    size: UVec2,
}

/// Pixels per edge of a tile: of a workgroup of the trace, and of the rays that share a start.
pub(super) const TILE: u32 = 8;

/// The most starts of rays that a view keeps: 16 MiB. With more volumes than that, each ray finds its
/// own.
const MAX_STARTS: u64 = 1 << 22;

impl ViewResources {
    /// Tiles of the picture.
    pub fn tiles(&self) -> UVec2 {
        (self.size + TILE - 1) / TILE
    }
}

/// On views that see at least one volume: what the passes bind.
#[derive(Component, Debug)]
pub(super) struct ViewBindGroups {
    pub beams: Option<BindGroup>,
    pub trace: BindGroup,
    pub composite: BindGroup,
}

/// Finds the volumes of each view whose grid is on the GPU.
pub(super) fn find_views(
    mut commands: Commands,
    volumes: Res<ExtractedVolumes>,
    pool: Res<VdbTreePool>,
    views: Query<
        (Entity, &RenderVisibleEntities, Option<&VdbCamera>, Has<ViewVolumes>),
        (With<ExtractedCamera>, With<Camera3d>),
    >,
) {
    for (view, visible, camera, had) in &views {
        let mut seen: Vec<MainEntity> = Vec::new();
        if camera.is_none_or(|camera| camera.enabled)
            && let Some(class) = visible.classes.get(&TypeId::of::<VdbVolume>())
        {
            let shown = |entity: &MainEntity| {
                volumes.0.get(entity).is_some_and(|volume| {
                    volume.packed.occupied.is_some() && pool.index(volume.grid).is_some()
                })
            };
            let here = class.entities_cpu_culling.iter().map(|(_, entity)| *entity);
            let here = here.chain(class.entities_gpu_culling.keys().copied());
            seen.extend(here.filter(shown));
        }
        if !seen.is_empty() {
            // An order of their own, so that the picture does not depend on that of spawning.
            seen.sort_unstable();
            commands.entity(view).insert(ViewVolumes(seen));
        } else if had {
            commands.entity(view).remove::<(ViewVolumes, ViewResources, ViewBindGroups)>();
        }
    }
}

/// Lets the trace read the depth of the opaque meshes.
pub(super) fn make_depth_readable(mut views: Query<&mut Camera3d, With<ViewVolumes>>) {
    for mut camera in &mut views {
        camera.depth_texture_usages.0 |= TextureUsages::TEXTURE_BINDING.bits();
    }
}

type ViewData<'a> = (
    Entity,
    &'a ViewVolumes,
    &'a ExtractedView,
    &'a ExtractedCamera,
    Option<&'a VdbCamera>,
    &'a Msaa,
    Option<&'a ExtractedAmbient>,
    Option<&'a TemporalJitter>,
    Option<&'a MainPassResolutionOverride>,
    Option<&'a Tonemapping>,
    Option<&'a DebandDither>,
    Option<&'a ViewResources>,
);

/// Makes buffers, textures and pipelines for each view that sees a volume.
pub(super) fn prepare_views(
    mut commands: Commands,
    views: Query<ViewData>,
    volumes: Res<ExtractedVolumes>,
    sun: Res<ExtractedSun>,
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
        ambient,
        jitter,
        resolution,
        tonemapping,
        dither,
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
        let first = volume_buffer.0.len() as u32;
        let mut kinds = [false; 3];
        for entity in &seen.0 {
            let (Some(volume), Some(rays)) = (volumes.0.get(entity), &rays) else { continue };
            let Some(index) = pool.index(volume.grid) else { continue };
            let lattice = lattice_rays(volume, rays, world_from_view);
            let trouble = match &lattice {
                Ok(rays) => rays.is_coarse(size.x).then_some(Trouble::Coarse),
                Err(why) => Some(Trouble::NotShown(*why)),
            };
            if let Some(trouble) = trouble
                && let Some(text) = warned.note(*entity, &volume.name, trouble)
            {
                warn!("{text}");
            }
            if let Ok(rays) = lattice {
                let data = volume_data(volume, index, &rays);
                kinds[data.kind as usize] = true;
                volume_buffer.0.push(data);
            }
        }
        let count = volume_buffer.0.len() as u32 - first;
        let (Some(rays), true) = (rays, count > 0 && size.min_element() > 0) else {
            commands.entity(entity).remove::<(ViewResources, ViewBindGroups, ViewPipelines)>();
            continue;
        };
        let origin = view.viewport.xy();
        let data = gpu_data::View {
            sun_direction: sun.direction.to_array(),
            sun_illuminance: light(sun.illuminance),
            ambient: light(ambient.map_or(Vec3::ZERO, |ambient| ambient.0)),
            exposure: non_negative(camera.exposure).min(MOST_EXPOSURE),
            volume_first: first,
            volume_count: count,
            steps_scale: non_negative(settings.steps_scale).max(1.0),
            size: size.to_array(),
            origin: origin.to_array(),
            ..view_data(&rays, world_from_view)
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
        let [has_voxels, has_fogs, has_smooth] = kinds;
        // Normals and depth are those of surfaces: fog is neither traced nor compiled for them.
        let no_fog = matches!(settings.mode, VdbRenderMode::Normals | VdbRenderMode::Depth);
        let has_fogs = has_fogs && !no_fog;
        let tiles = ((size + TILE - 1) / TILE).as_u64vec2().element_product();
        let starts = tiles * u64::from(count);
        let beams = settings.traversal == VdbTraversal::HddaSdf && starts <= MAX_STARTS;
        let starts = beams.then(|| {
            let kept = before.and_then(|before| before.starts.clone());
            kept.filter(|buffer| buffer.size() == starts * 4).unwrap_or_else(|| {
                device.create_buffer(&BufferDescriptor {
                    label: Some("vdb_starts"),
                    size: starts * 4,
                    usage: BufferUsages::STORAGE,
                    mapped_at_creation: false,
                })
            })
        });
        let resources = ViewResources {
            starts,
            volumes: count,
            view: buffer("vdb_view", bytemuck::bytes_of(&data)),
            placement: buffer("vdb_placement", bytemuck::bytes_of(&placement)),
            color: texture("vdb_color", TextureFormat::Rgba16Float),
            depth: texture("vdb_depth", TextureFormat::R32Float),
            size,
        };
        let trace_key = TraceKey {
            multisampled: msaa.samples() > 1,
            surfaces: has_voxels,
            smooth: has_smooth,
            fogs: has_fogs,
            beams,
            page_bits: pool.page_bits(),
            traversal: settings.traversal,
            mode: settings.mode,
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
        };
        let mut composite = |fog_alone: bool| {
            composite_pipelines.specialize(
                &pipeline_cache,
                &composite_pipeline,
                composite_key(fog_alone),
            )
        };
        // Steps are shown where no surface is, too.
        let alone = has_fogs || settings.mode == VdbRenderMode::Steps;
        let pipelines = ViewPipelines {
            beams: beams.then(|| {
                beams_pipelines.specialize(&pipeline_cache, &beams_pipeline, pool.page_bits())
            }),
            trace: trace_pipelines.specialize(&pipeline_cache, &trace_pipeline, trace_key),
            surface: (has_voxels || has_smooth).then(|| composite(false)),
            fog: alone.then(|| composite(true)),
            multisampled: trace_key.multisampled,
            tonemaps: composite_key(false).tone.is_some(),
        };
        commands.entity(entity).insert((resources, pipelines));
    }
    warned.end_frame();
    volume_buffer.0.write_buffer(&device, &queue);
}

fn affine(m: bevy::math::Affine3A) -> DAffine3 {
    DAffine3 {
        matrix3: DMat3::from_cols(
            m.matrix3.x_axis.as_dvec3(),
            m.matrix3.y_axis.as_dvec3(),
            m.matrix3.z_axis.as_dvec3(),
        ),
        translation: m.translation.as_dvec3(),
    }
}

fn view_data(rays: &ViewRays, world_from_view: DAffine3) -> gpu_data::View {
    let world = |v| world_from_view.transform_vector3(v).as_vec3().to_array();
    gpu_data::View {
        t_from_depth: rays.t_from_depth.map(|x| x as f32),
        depth_from_t: rays.depth_from_t.map(|x| x as f32),
        dir: world(rays.dir),
        dir_x: world(rays.dir_x),
        dir_y: world(rays.dir_y),
        t_near: rays.t_near as f32,
        t_far: rays.t_far as f32,
        ..default()
    }
}

fn lattice_rays(
    volume: &ExtractedVolume,
    rays: &ViewRays,
    world_from_view: DAffine3,
) -> Result<LatticeRays, CannotShow> {
    let world_from_index = affine(volume.world_from_local) * volume.local_from_index;
    LatticeRays::new(rays, world_from_view, world_from_index, &volume.packed)
}

// What a shader computes with must not exceed f32, which it may assume: infinities are not for WGSL.
// With these, albedo · light · exposure stays below 10³⁵. No picture shows the difference.

/// Luminance and illuminance; the sun's surface has 2·10⁹ cd/m².
const MOST_LIGHT: f32 = 1e15;
/// Albedo: one above 1 is not physical, but Bevy's colours allow it.
const MOST_ALBEDO: f32 = 1e6;
/// What turns luminance into the camera's values.
const MOST_EXPOSURE: f32 = 1e12;
/// Extinction per unit of density.
const MOST_EXTINCTION: f32 = 1e30;

fn light(color: Vec3) -> [f32; 3] {
    color.to_array().map(|c| non_negative(c).min(MOST_LIGHT))
}

fn volume_data(volume: &ExtractedVolume, grid: u32, rays: &LatticeRays) -> gpu_data::Volume {
    let material = &volume.material;
    let base_color = material.base_color.to_linear().to_vec3().to_array();
    let kind = match volume.packed.kind {
        PackKind::Surface { .. } => gpu_data::KIND_SURFACE,
        PackKind::Smooth { .. } => gpu_data::KIND_SMOOTH,
        PackKind::Fog => gpu_data::KIND_FOG,
    };
    gpu_data::Volume {
        rays: GpuRays::from(rays),
        grid,
        kind,
        density_scale: non_negative(material.density_scale).min(MOST_EXTINCTION),
        normal_x: rays.normal.x_axis.as_vec3().to_array(),
        normal_y: rays.normal.y_axis.as_vec3().to_array(),
        normal_z: rays.normal.z_axis.as_vec3().to_array(),
        base_color: base_color.map(|c| non_negative(c).min(MOST_ALBEDO)),
        emissive: light(material.emissive.to_vec3()),
        ..default()
    }
}

/// Binds what the passes read and write.
pub(super) fn prepare_bind_groups(
    mut commands: Commands,
    views: Query<(Entity, &ViewResources, &ViewPipelines, &ViewDepthTexture, Option<&Tonemapping>)>,
    pool: Res<VdbTreePool>,
    volumes: Res<VolumeBuffer>,
    (beams, trace, composite): (Res<BeamsPipeline>, Res<TracePipeline>, Res<CompositePipeline>),
    pipeline_cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    view_uniforms: Res<ViewUniforms>,
    (luts, images, fallback): (
        Res<TonemappingLuts>,
        Res<RenderAssets<GpuImage>>,
        Res<FallbackImage>,
    ),
) {
    let (Some(pool), Some(volumes)) = (pool.buffers(), volumes.0.buffer()) else { return };
    let [page_a, page_b, page_c] = pool.pages();
    for (entity, resources, pipelines, depth, tonemapping) in &views {
        let mut trace_entries = DynamicBindGroupEntries::sequential((
            pool.grids.as_entire_binding(),
            page_a.as_entire_binding(),
            page_b.as_entire_binding(),
            page_c.as_entire_binding(),
            resources.view.as_entire_binding(),
            volumes.as_entire_binding(),
            depth.view(),
            &resources.color.default_view,
            &resources.depth.default_view,
        ));
        if let Some(starts) = &resources.starts {
            trace_entries = trace_entries.extend_sequential((starts.as_entire_binding(),));
        }
        let layout = trace.layout(pipelines.multisampled, resources.starts.is_some());
        let trace = device.create_bind_group(
            "vdb_trace",
            &pipeline_cache.get_bind_group_layout(layout),
            &trace_entries,
        );
        let beams = resources.starts.as_ref().map(|starts| {
            device.create_bind_group(
                "vdb_beams",
                &pipeline_cache.get_bind_group_layout(&beams.layout),
                &BindGroupEntries::with_indices((
                    (0, pool.grids.as_entire_binding()),
                    (1, page_a.as_entire_binding()),
                    (2, page_b.as_entire_binding()),
                    (3, page_c.as_entire_binding()),
                    (4, resources.view.as_entire_binding()),
                    (5, volumes.as_entire_binding()),
                    (9, starts.as_entire_binding()),
                )),
            )
        });
        let mut entries = DynamicBindGroupEntries::sequential((
            &resources.color.default_view,
            &resources.depth.default_view,
            resources.placement.as_entire_binding(),
        ));
        if pipelines.tonemaps {
            let Some(view) = view_uniforms.uniforms.binding() else { continue };
            let curve = tonemapping.copied().unwrap_or(Tonemapping::None);
            let (lut, sampler) = get_lut_bindings(&images, &luts, &curve, &fallback);
            entries = entries.extend_sequential((view, lut, sampler));
        }
        let composite = device.create_bind_group(
            "vdb_composite",
            &pipeline_cache.get_bind_group_layout(composite.layout(pipelines.tonemaps)),
            &entries,
        );
        commands.entity(entity).insert(ViewBindGroups { beams, trace, composite });
    }
}
