//! Removes the grain that fog in shadow maps leaves on meshes. A texel of a shadow map has one depth, so it
//! lets a part of the light through by chance, and Bevy's filter averages too few texels to hide that.
//!
//! Two dispatches find the grain, from the maps with fog and without; a third takes it from the picture of the
//! meshes, which a draw then replaces.

mod pipeline;

use bevy::camera::{MainPassResolutionOverride, Viewport};
use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::core_3d::{main_opaque_pass_3d, prepare_core_3d_depth_textures};
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::ecs::system::SystemParam;
use bevy::light::ShadowFilteringMethod;
use bevy::pbr::{MeshPipeline, MeshPipelineSystems};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, Buffer, BufferInitDescriptor, BufferUsages, CachedComputePipelineId,
    CachedRenderPipelineId, ComputePassDescriptor, DynamicBindGroupEntries, PipelineCache,
    RenderPassDescriptor, SpecializedComputePipelines, SpecializedRenderPipelines, TextureUsages,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::{CachedTexture, TextureCache};
use bevy::render::view::{
    ExtractedView, Msaa, RenderVisibleEntities, ViewDepthTexture, ViewTarget,
};
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};

use super::extract::ExtractedVolumes;
use super::gpu::{GROUP, PipelineFallback, Shaders, load_shaders, picture_texture, tiles, types};
use super::shadow_maps::{CastShadows, removes_grain};
use super::trace::{AllLights, LightBindGroups, ShadowMaps, ViewLights};
use super::view::{PrepareViews, VdbSystems, shadow_filter_def};
use crate::{VdbCamera, VdbQuality};
use pipeline::{FORMATS, FindKey, FindPipeline, LIGHTS, SmoothPipelines, TargetKey};

/// Removes the grain of fog's shadows, in cameras that see meshes in them.
pub(super) struct FogShadowsPlugin;

impl Plugin for FogShadowsPlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .init_gpu_resource::<SmoothedViews>()
            .init_gpu_resource::<SpecializedComputePipelines<FindPipeline>>()
            .init_gpu_resource::<SpecializedComputePipelines<SmoothPipelines>>()
            .init_gpu_resource::<SpecializedRenderPipelines<SmoothPipelines>>()
            .add_systems(RenderStartup, init.after(MeshPipelineSystems).after(load_shaders))
            .add_systems(
                Render,
                (
                    make_depth_readable
                        .in_set(PrepareViews::Find)
                        .before(prepare_core_3d_depth_textures),
                    prepare.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(
                Core3d,
                smooth
                    .in_set(Core3dSystems::MainPass)
                    .after(main_opaque_pass_3d)
                    .before(VdbSystems::Trace),
            );
    }
}

fn init(
    mut commands: Commands,
    shaders: Res<Shaders>,
    meshes: Res<MeshPipeline>,
    fullscreen: Res<FullscreenShader>,
) {
    commands.insert_resource(FindPipeline::new(&shaders, &meshes));
    commands.insert_resource(SmoothPipelines::new(&shaders, fullscreen.clone()));
}

/// Makes the depth of meshes readable.
fn make_depth_readable(
    mut views: Query<(
        &mut Camera3d,
        Option<&VdbCamera>,
        Option<&VdbQuality>,
        &RenderVisibleEntities,
    )>,
    volumes: Res<ExtractedVolumes>,
) {
    for (mut camera, settings, quality, visible) in &mut views {
        if removes_grain(settings, quality, visible, &volumes) {
            camera.depth_texture_usages.0 |= TextureUsages::TEXTURE_BINDING.bits();
        }
    }
}

/// The labels of the textures of a camera: what each of the three dispatches writes.
pub(super) const SMOOTHED: [&str; 3] = ["vdb_expected_light", "vdb_grain", "vdb_smoothed_meshes"];

/// The cameras whose picture is smoothed in this frame.
#[derive(Default, Resource)]
pub(super) struct SmoothedViews {
    views: HashMap<Entity, SmoothedView>,
    /// Whether a pipeline is being compiled, so a camera shows grain.
    pub is_waiting: bool,
}

impl SmoothedViews {
    /// The textures of a camera.
    pub fn textures(&self, camera: Entity) -> Option<[&CachedTexture; 3]> {
        self.views.get(&camera).map(|view| view.textures.each_ref())
    }
}

/// The pipelines, textures and bind groups of a camera.
struct SmoothedView {
    pipelines: ViewPipelines,
    /// See [`SMOOTHED`].
    textures: [CachedTexture; 3],
    placement: Buffer,
    size: UVec2,
    lights: [LightBindGroups; 2],
    found: [BindGroup; 2],
}

#[derive(Clone, Copy)]
struct ViewPipelines {
    find: [CachedComputePipelineId; 2],
    remove: CachedComputePipelineId,
    draw: CachedRenderPipelineId,
}

/// The pipelines of all cameras.
#[derive(SystemParam)]
struct AllPipelines<'w> {
    find: Res<'w, FindPipeline>,
    smooth: Res<'w, SmoothPipelines>,
    specialized_find: ResMut<'w, SpecializedComputePipelines<FindPipeline>>,
    specialized_remove: ResMut<'w, SpecializedComputePipelines<SmoothPipelines>>,
    specialized_draw: ResMut<'w, SpecializedRenderPipelines<SmoothPipelines>>,
    cache: Res<'w, PipelineCache>,
    fallback: Res<'w, PipelineFallback>,
}

impl AllPipelines<'_> {
    /// The pipelines of a camera; starts to compile new ones.
    fn of(&mut self, keys: [FindKey; 2], target: TargetKey) -> ViewPipelines {
        let cache = &self.cache;
        ViewPipelines {
            find: keys.map(|key| self.specialized_find.specialize(cache, &self.find, key)),
            remove: self.specialized_remove.specialize(cache, &self.smooth, ()),
            draw: self.specialized_draw.specialize(cache, &self.smooth, target),
        }
    }

    fn are_ready(&self, ids: ViewPipelines) -> bool {
        let mut computes = ids.find.into_iter().chain([ids.remove]);
        computes.all(|id| self.fallback.compute(&self.cache, id).is_some())
            && self.fallback.render(&self.cache, ids.draw).is_some()
    }
}

/// The components of a camera that the passes depend on.
type CameraData<'a> = (
    Entity,
    (&'a ExtractedView, &'a Msaa, Option<&'a MainPassResolutionOverride>),
    Option<&'a ShadowFilteringMethod>,
    &'a ViewDepthTexture,
    ViewLights,
);

/// Creates the textures and bind groups of each camera.
fn prepare(
    mut smoothed: ResMut<SmoothedViews>,
    shadows: Res<CastShadows>,
    cameras: Query<CameraData, With<ExtractedCamera>>,
    all_lights: AllLights,
    mut pipelines: AllPipelines,
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    *smoothed = default();
    for (camera, (view, msaa, resolution), filter, depth, lights) in &cameras {
        let Some(grain) = shadows.grain_for(camera) else { continue };
        let key = |with_fog| FindKey {
            is_multisampled: msaa.samples() > 1,
            has_lamps: grain.has_lamps,
            filter: shadow_filter_def(filter),
            with_fog,
        };
        let keys = [false, true].map(key);
        let target = TargetKey { format: view.target_format, samples: msaa.samples() };
        let ids = pipelines.of(keys, target);
        if !pipelines.are_ready(ids) {
            smoothed.is_waiting = true;
            continue;
        }
        let size = resolution.map_or(view.viewport.zw(), |size| size.0);
        let placement =
            types::Placement { origin: view.viewport.xy().to_array(), size: size.to_array() };
        let placement = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_fog_shadows"),
            contents: bytemuck::bytes_of(&placement),
            usage: BufferUsages::UNIFORM,
        });
        let mut texture = |i: usize| {
            let (label, format) = (SMOOTHED[i], FORMATS[i]);
            textures.get(&device, picture_texture(label, format, size))
        };
        let own = std::array::from_fn(&mut texture);
        let (find, cache) = (&pipelines.find, &*pipelines.cache);
        let bind_lights = |maps: &ShadowMaps| {
            all_lights.bind(LIGHTS, &find.lights, Some(&lights), maps, &device, cache)
        };
        let (Some(without_fog), Some(with_fog)) =
            (bind_lights(&grain.without_fog), bind_lights(&ShadowMaps::default()))
        else {
            continue;
        };
        let bind = |i: usize| {
            let mut entries = DynamicBindGroupEntries::sequential((
                depth.view(),
                placement.as_entire_binding(),
                &own[i].default_view,
            ));
            if i == 0 {
                let layers = &grain.layers[..1 + usize::from(grain.has_lamps)];
                for [with_fog, without_fog] in layers {
                    entries = entries.extend_sequential((with_fog, without_fog));
                }
            } else {
                entries = entries.extend_sequential((&own[0].default_view,));
            }
            let layout = cache.get_bind_group_layout(&FindPipeline::layout(keys[i]));
            device.create_bind_group("vdb_fog_shadows", &layout, &entries)
        };
        let found = std::array::from_fn(bind);
        let lights = [without_fog, with_fog];
        let view = SmoothedView { pipelines: ids, textures: own, placement, size, lights, found };
        smoothed.views.insert(camera, view);
    }
}

/// Finds the grain in the picture of the opaque meshes, and removes it.
fn smooth(
    view: ViewQuery<(Entity, &ExtractedCamera, &ViewTarget, Option<&MainPassResolutionOverride>)>,
    smoothed: Res<SmoothedViews>,
    pipelines: Res<SmoothPipelines>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (camera, extracted, target, resolution) = view.into_inner();
    let Some(own) = smoothed.views.get(&camera) else { return };
    let ids = own.pipelines;
    let compute = |id| fallback.compute(&cache, id);
    let ([Some(expect), Some(find)], Some(remove), Some(draw)) =
        (ids.find.map(compute), compute(ids.remove), fallback.render(&cache, ids.draw))
    else {
        return;
    };
    let [_, grain, result] = own.textures.each_ref().map(|texture| &texture.default_view);
    // The target's two textures are swapped while cameras that share it are drawn.
    let removed = device.create_bind_group(
        "vdb_fog_shadows_smooth",
        &cache.get_bind_group_layout(&pipelines.remove),
        &DynamicBindGroupEntries::sequential((
            grain,
            target.main_texture_view(),
            own.placement.as_entire_binding(),
            result,
        )),
    );
    let drawn = device.create_bind_group(
        "vdb_fog_shadows_draw",
        &cache.get_bind_group_layout(&pipelines.draw),
        &DynamicBindGroupEntries::sequential((grain, result, own.placement.as_entire_binding())),
    );
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_fog_shadows");
    {
        let descriptor =
            ComputePassDescriptor { label: Some("vdb_fog_shadows"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        let groups = tiles(own.size);
        for (i, pipeline) in [expect, find].iter().enumerate() {
            pass.set_pipeline(pipeline);
            let LightBindGroups { groups: [lights, around], offsets } = &own.lights[i];
            pass.set_bind_group(0, lights, offsets);
            pass.set_bind_group(1, around, &[]);
            pass.set_bind_group(GROUP, &own.found[i], &[]);
            pass.dispatch_workgroups(groups.x, groups.y, 1);
        }
        pass.set_pipeline(&remove);
        pass.set_bind_group(0, &removed, &[]);
        pass.dispatch_workgroups(groups.x, groups.y, 1);
    }
    {
        let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
            label: Some("vdb_fog_shadows_draw"),
            color_attachments: &[Some(target.get_color_attachment())],
            ..default()
        });
        if let Some(viewport) =
            Viewport::from_viewport_and_override(extracted.viewport.as_ref(), resolution)
        {
            pass.set_camera_viewport(&viewport);
        }
        pass.set_render_pipeline(&draw);
        pass.set_bind_group(0, &drawn, &[]);
        pass.draw(0..3, 0..1);
    }
    span.end(context.command_encoder());
}
