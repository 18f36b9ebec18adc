//! What Bevy has prepared of the lights of a view, for the trace to bind: its buffers, shadow maps and
//! environment maps as they are, under the numbers that `bevy_pbr::mesh_view_bindings` gives them.

use bevy::ecs::system::SystemParam;
use bevy::light::ShadowFilteringMethod;
use bevy::pbr::{
    DfgLut, ExtractedDirectionalLight, ExtractedPointLight, FogMeta, GlobalClusterableObjectMeta,
    LightMeta, LightProbesBuffer, MeshPipeline, MeshPipelineViewLayoutKey, ShadowSamplers,
    ViewClusterBindings, ViewFogUniformOffset, ViewLightProbesUniformOffset,
    ViewLightsUniformOffset, ViewShadowBindings,
};
use bevy::prelude::*;
use bevy::render::globals::GlobalsBuffer;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::binding_types::{sampler, texture_cube};
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries,
    DynamicBindGroupEntries, PipelineCache, SamplerBindingType, ShaderStages, TextureSampleType,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::{FallbackImage, GpuImage};
use bevy::render::view::{ViewUniformOffset, ViewUniforms};
use bevy::shader::ShaderDefVal;

use super::cast::{CastShadows, MeshDepth};
use super::extract::{ExtractedEnvironment, ExtractedSuns};

/// What a view's lights ask of the trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct LightKey {
    /// If lights throw shadows: the shader def of how the edges of shadow maps are smoothed.
    pub shadows: Option<&'static str>,
    /// Whether a sun that throws shadows has a size.
    pub soft: bool,
    /// Whether there are lights with a position.
    pub local: bool,
    /// Whether the view has an environment map.
    pub environment: bool,
    /// Whether Bevy's [`DistanceFog`] lies before what the view shows.
    pub distance_fog: bool,
}

impl LightKey {
    /// With motion vectors or distance fog, the place of what is seen of a volume's fog matters, as it
    /// does for light that changes from place to place.
    pub fn shader_defs(
        self,
        layouts: &LightLayouts,
        motion: bool,
    ) -> impl Iterator<Item = ShaderDefVal> {
        let table = layouts.has_table.then_some("DFG_LUT");
        let is_placed = motion || self.distance_fog;
        let even = self.shadows.is_none() && !self.local && !is_placed;
        let defs = [
            self.shadows.map(|_| "SHADOWS"),
            self.shadows,
            self.soft.then_some("SOFT_SUNS"),
            self.local.then_some("LOCAL_LIGHTS"),
            even.then_some("EVEN_LIGHT"),
            self.environment.then_some("ENVIRONMENT_MAP"),
            self.distance_fog.then_some("DISTANCE_FOG"),
            table,
        ];
        defs.into_iter().flatten().map(ShaderDefVal::from)
    }
}

/// Bindings of Bevy's group 0 for shadow maps, their samplers included.
const SHADOW_MAPS: [u32; 4] = [2, 3, 5, 6];
/// And for what is needed always: view, lights, clusters, globals, light probes.
const LIGHTS: [u32; 7] = [0, 1, 8, 9, 10, 11, 12];
/// And for the table of how much light surfaces reflect, where Bevy has one: with its feature
/// `dfg_lut`.
const TABLE: [u32; 2] = [37, 38];
/// And for [`DistanceFog`].
const FOG: u32 = 13;

/// Layouts of Bevy's two groups, for compute shaders.
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
            nothing: BindGroupLayoutDescriptor { label: "vdb_nothing".into(), entries: Vec::new() },
            has_table,
        }
    }

    /// Of groups 0 and 1; without a key, both are empty.
    pub fn groups(&self, key: Option<LightKey>) -> [&BindGroupLayoutDescriptor; 2] {
        let Some(key) = key else { return [&self.nothing; 2] };
        let environment = if key.environment { &self.environment } else { &self.nothing };
        let lights = &self.lights[usize::from(key.shadows.is_some())];
        [&lights[usize::from(key.distance_fog)], environment]
    }
}

/// Which lights there are.
#[derive(SystemParam)]
pub(super) struct Lights<'w, 's> {
    suns: Query<'w, 's, &'static ExtractedDirectionalLight>,
    local: Query<'w, 's, &'static ExtractedPointLight>,
    images: Res<'w, RenderAssets<GpuImage>>,
}

impl Lights<'_, '_> {
    /// What they ask of the trace of a view with such settings.
    pub fn key(
        &self,
        shadows: bool,
        filter: Option<&ShadowFilteringMethod>,
        environment: Option<&ExtractedEnvironment>,
        distance_fog: bool,
        suns: &ExtractedSuns,
    ) -> LightKey {
        let thrown = self.suns.iter().any(|light| light.shadow_maps_enabled)
            || self.local.iter().any(|light| light.shadow_maps_enabled);
        let filter = match filter.copied().unwrap_or_default() {
            ShadowFilteringMethod::Hardware2x2 => "SHADOW_FILTER_METHOD_HARDWARE_2X2",
            ShadowFilteringMethod::Gaussian => "SHADOW_FILTER_METHOD_GAUSSIAN",
            ShadowFilteringMethod::Temporal => "SHADOW_FILTER_METHOD_TEMPORAL",
        };
        LightKey {
            shadows: (shadows && thrown).then_some(filter),
            soft: shadows && thrown && suns.0.iter().any(|sun| sun.angular_diameter > 0.0),
            local: !self.local.is_empty(),
            environment: environment.is_some_and(|maps| {
                [maps.diffuse, maps.specular].iter().all(|map| self.images.get(*map).is_some())
            }),
            distance_fog,
        }
    }
}

/// On views that see at least one volume by light: Bevy's groups, and where in its buffers the view is.
#[derive(Clone, Debug)]
pub(super) struct LightBindGroups {
    pub groups: [BindGroup; 2],
    pub offsets: Vec<u32>,
}

/// What Bevy has on a view.
pub(super) type ViewLights<'a> = (
    &'a ViewUniformOffset,
    &'a ViewLightsUniformOffset,
    &'a ViewLightProbesUniformOffset,
    &'a ViewShadowBindings,
    &'a ViewClusterBindings,
    Option<&'a ExtractedEnvironment>,
    Option<&'a ViewFogUniformOffset>,
);

/// What Bevy has for all views.
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
    cast: Res<'w, CastShadows>,
    images: Res<'w, RenderAssets<GpuImage>>,
    fallback: Res<'w, FallbackImage>,
}

impl AllLights<'_> {
    /// The groups of a view; `None` while Bevy has not prepared all of it, or without an image that it
    /// needs. Without a key, they are empty.
    pub fn bind(
        &self,
        key: Option<LightKey>,
        layouts: &LightLayouts,
        view: Option<<ViewLights<'static> as bevy::ecs::query::QueryData>::Item<'_, '_>>,
        device: &RenderDevice,
        cache: &PipelineCache,
    ) -> Option<LightBindGroups> {
        let group = |i: usize, entries: &[_]| {
            let layout = cache.get_bind_group_layout(layouts.groups(key)[i]);
            device.create_bind_group("vdb_lights", &layout, entries)
        };
        let Some(key) = key else {
            return Some(LightBindGroups {
                groups: [group(0, &[]), group(1, &[])],
                offsets: Vec::new(),
            });
        };
        let (view, lights, probes, shadows, clusters, environment, fog) = view?;
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
        if key.shadows.is_some() {
            let directional = &shadows.directional_light_depth_texture_view;
            entries = entries.extend_with_indices((
                (2, MeshDepth::or(&self.cast.point, &shadows.point_light_depth_texture_view)),
                (3, &self.samplers.point_light_comparison_sampler),
                (5, MeshDepth::or(&self.cast.directional, directional)),
                (6, &self.samplers.directional_light_comparison_sampler),
            ));
        }
        if key.distance_fog {
            offsets.push(fog?.offset);
            entries = entries.extend_with_indices(((FOG, self.fogs.gpu_fogs.binding()?),));
        }
        if layouts.has_table {
            let image = self.images.get(&self.table.texture).unwrap_or(&self.fallback.d2);
            entries = entries
                .extend_with_indices(((TABLE[0], &image.texture_view), (TABLE[1], &image.sampler)));
        }
        let maps = if key.environment {
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
