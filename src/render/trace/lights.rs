//! Bind groups of the lights of a view: the buffers, shadow maps and environment maps that Bevy has
//! prepared, under the binding numbers of `bevy_pbr::mesh_view_bindings`.

use bevy::ecs::query::QueryData;
use bevy::ecs::system::SystemParam;
use bevy::pbr::{
    DfgLut, FogMeta, GlobalClusterableObjectMeta, LightMeta, LightProbesBuffer, MeshPipeline,
    MeshPipelineViewLayoutKey, ShadowSamplers, ViewClusterBindings, ViewFogUniformOffset,
    ViewLightProbesUniformOffset, ViewLightsUniformOffset, ViewShadowBindings,
};
use bevy::prelude::*;
use bevy::render::globals::GlobalsBuffer;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::binding_types::{sampler, texture_cube};
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries,
    DynamicBindGroupEntries, PipelineCache, SamplerBindingType, ShaderStages, TextureSampleType,
    TextureView,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::{FallbackImage, GpuImage};
use bevy::render::view::{ViewUniformOffset, ViewUniforms};
use bevy::shader::ShaderDefVal;

use crate::quality::features::Features;
use crate::render::extract::ExtractedEnvironment;
use crate::render::gpu::empty_layout;
use crate::render::view::ViewKey;

/// Copies of Bevy's shadow maps with meshes alone, made where volumes are then drawn into Bevy's
/// own. The trace uses the copies, because volumes shadow each other by rays.
#[derive(Debug, Default, Resource)]
pub(crate) struct MeshShadowMaps {
    /// The maps of directional lights and spot lights.
    pub directional: Option<TextureView>,
    /// The maps of point lights.
    pub point: Option<TextureView>,
}

/// The bindings in Bevy's group 0 of shadow maps and their samplers.
const SHADOW_MAPS: [u32; 4] = [2, 3, 5, 6];
/// The bindings that are always needed: view, lights, clusters, globals, light probes.
const LIGHTS: [u32; 7] = [0, 1, 8, 9, 10, 11, 12];
/// The bindings of the DFG look-up table (directional albedo), which exists with Bevy's feature
/// `dfg_lut`.
const TABLE: [u32; 2] = [37, 38];
/// The binding of [`DistanceFog`].
const FOG: u32 = 13;

/// The layouts of Bevy's two groups, for compute shaders.
#[derive(Clone, Debug)]
pub(super) struct LightLayouts {
    /// Without and with shadow maps, each without and with distance fog.
    lights: [[BindGroupLayoutDescriptor; 2]; 2],
    environment: BindGroupLayoutDescriptor,
    nothing: BindGroupLayoutDescriptor,
    has_table: bool,
}

impl LightLayouts {
    pub fn new(meshes: &MeshPipeline) -> Self {
        let theirs = meshes.get_view_layout(MeshPipelineViewLayoutKey::DISTANCE_FOG);
        let theirs = theirs.main_layout.entries;
        let has_table = theirs.iter().any(|entry| entry.binding == TABLE[0]);
        let lights = |shadows: bool, fog: bool| {
            let wanted = |binding: u32| {
                LIGHTS.contains(&binding)
                    || TABLE.contains(&binding)
                    || (shadows && SHADOW_MAPS.contains(&binding))
                    || (fog && binding == FOG)
            };
            let mut entries = theirs.clone();
            entries.retain(|entry| wanted(entry.binding));
            entries.iter_mut().for_each(|entry| entry.visibility = ShaderStages::COMPUTE);
            BindGroupLayoutDescriptor { label: "vdb_lights".into(), entries }
        };
        let cube = || texture_cube(TextureSampleType::Float { filterable: true });
        let environment = BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (cube(), cube(), sampler(SamplerBindingType::Filtering)),
        );
        let both = [false, true];
        Self {
            lights: both.map(|shadows| both.map(|fog| lights(shadows, fog))),
            environment: BindGroupLayoutDescriptor::new("vdb_environment", &environment),
            nothing: empty_layout(),
            has_table,
        }
    }

    /// The layouts of groups 0 and 1; empty in unlit views.
    pub fn groups(&self, features: Features) -> [&BindGroupLayoutDescriptor; 2] {
        if !features.contains(Features::LIGHT) {
            return [&self.nothing; 2];
        }
        let has_maps = features.contains(Features::ENVIRONMENT);
        let lights = &self.lights[usize::from(features.contains(Features::SHADOWS))];
        [
            &lights[usize::from(features.contains(Features::DISTANCE_FOG))],
            if has_maps { &self.environment } else { &self.nothing },
        ]
    }

    /// The layouts of Bevy's groups, then that of the crate's own group.
    pub fn layouts(
        &self,
        features: Features,
        own: &BindGroupLayoutDescriptor,
    ) -> Vec<BindGroupLayoutDescriptor> {
        self.groups(features).into_iter().chain([own]).cloned().collect()
    }

    /// The shader defs of the light of a view, besides those of its features.
    ///
    /// Fog is lit evenly (`VDB_EVEN_LIGHT`) only if its position along the ray does not matter.
    /// Position matters for light and albedos that vary in space, and for motion vectors and distance fog.
    /// Multiple scattering from lights uses octaves (`VDB_OCTAVES`) only with shadows: without
    /// them, no optical depth towards the light is known.
    pub fn shader_defs(&self, key: &ViewKey) -> impl Iterator<Item = ShaderDefVal> {
        let placed = Features::SHADOWS
            | Features::LAMPS
            | Features::MOTION_VECTORS
            | Features::DISTANCE_FOG
            | Features::FOG_COLORS
            | Features::RAMPS
            | Features::FOG_MATERIALS;
        let is_lit = key.has(Features::LIGHT);
        let even = is_lit && !key.features.intersects(placed);
        let octaves = key.has(Features::MULTIPLE_SCATTERING) && key.has(Features::SHADOWS);
        let defs = [
            key.shadow_filter,
            octaves.then_some("VDB_OCTAVES"),
            even.then_some("VDB_EVEN_LIGHT"),
            (is_lit && self.has_table).then_some("DFG_LUT"),
        ];
        defs.into_iter().flatten().map(ShaderDefVal::from)
    }
}

/// The bind groups of Bevy's groups, with the dynamic offsets of a view.
#[derive(Clone, Debug)]
pub(super) struct LightBindGroups {
    pub groups: [BindGroup; 2],
    pub offsets: Vec<u32>,
}

/// Bevy's light components on a view.
#[derive(QueryData)]
pub(super) struct ViewLights {
    view: &'static ViewUniformOffset,
    lights: &'static ViewLightsUniformOffset,
    probes: &'static ViewLightProbesUniformOffset,
    shadows: &'static ViewShadowBindings,
    clusters: &'static ViewClusterBindings,
    environment: Option<&'static ExtractedEnvironment>,
    fog: Option<&'static ViewFogUniformOffset>,
}

/// Bevy's light resources for all views.
#[derive(SystemParam)]
pub(super) struct AllLights<'w> {
    views: Res<'w, ViewUniforms>,
    lights: Res<'w, LightMeta>,
    clustered: Res<'w, GlobalClusterableObjectMeta>,
    globals: Res<'w, GlobalsBuffer>,
    probes: Res<'w, LightProbesBuffer>,
    samplers: Res<'w, ShadowSamplers>,
    fogs: Res<'w, FogMeta>,
    table: Res<'w, DfgLut>,
    mesh_shadows: Res<'w, MeshShadowMaps>,
    images: Res<'w, RenderAssets<GpuImage>>,
    fallback: Res<'w, FallbackImage>,
}

impl AllLights<'_> {
    /// The bind groups of a view; empty in unlit views. `None` until Bevy has prepared all
    /// resources, including images.
    pub fn bind(
        &self,
        features: Features,
        layouts: &LightLayouts,
        view: Option<&ViewLightsItem>,
        device: &RenderDevice,
        cache: &PipelineCache,
    ) -> Option<LightBindGroups> {
        let group = |i: usize, entries: &[_]| {
            let layout = cache.get_bind_group_layout(layouts.groups(features)[i]);
            device.create_bind_group("vdb_lights", &layout, entries)
        };
        if !features.contains(Features::LIGHT) {
            return Some(LightBindGroups {
                groups: [group(0, &[]), group(1, &[])],
                offsets: Vec::new(),
            });
        }
        let &ViewLightsItem { view, lights, probes, shadows, clusters, environment, fog } = view?;
        let mut offsets = vec![view.offset, lights.offset, **probes];
        let mut entries = DynamicBindGroupEntries::new_with_indices((
            (0, self.views.uniforms.binding()?),
            (1, self.lights.view_gpu_lights.binding()?),
            (8, self.clustered.gpu_clustered_lights.binding()?),
            (9, clusters.clusterable_object_index_lists_binding()?),
            (10, clusters.offsets_and_counts_binding()?),
            (11, self.globals.buffer.binding()?),
            (12, self.probes.binding()?),
        ));
        if features.contains(Features::SHADOWS) {
            let MeshShadowMaps { directional, point } = &*self.mesh_shadows;
            let own_point = &shadows.point_light_depth_texture_view;
            let own_directional = &shadows.directional_light_depth_texture_view;
            entries = entries.extend_with_indices((
                (2, point.as_ref().unwrap_or(own_point)),
                (3, &self.samplers.point_light_comparison_sampler),
                (5, directional.as_ref().unwrap_or(own_directional)),
                (6, &self.samplers.directional_light_comparison_sampler),
            ));
        }
        if features.contains(Features::DISTANCE_FOG) {
            offsets.push(fog?.offset);
            entries = entries.extend_with_indices(((FOG, self.fogs.gpu_fogs.binding()?),));
        }
        if layouts.has_table {
            let image = self.images.get(&self.table.texture).unwrap_or(&self.fallback.d2);
            entries = entries
                .extend_with_indices(((TABLE[0], &image.texture_view), (TABLE[1], &image.sampler)));
        }
        let maps = if features.contains(Features::ENVIRONMENT) {
            let maps = environment?;
            let (diffuse, specular) =
                (self.images.get(maps.diffuse)?, self.images.get(maps.specular)?);
            let maps = BindGroupEntries::sequential((
                &diffuse.texture_view,
                &specular.texture_view,
                &diffuse.sampler,
            ));
            group(1, &maps)
        } else {
            group(1, &[])
        };
        Some(LightBindGroups { groups: [group(0, &entries), maps], offsets })
    }
}
