//! Bind groups of the lights of a view: the buffers, shadow maps and environment maps that Bevy has
//! prepared, under the binding numbers of `bevy_pbr::mesh_view_bindings`.

use std::num::NonZeroU32;

use bevy::ecs::query::QueryData;
use bevy::ecs::system::SystemParam;
use bevy::light::IrradianceVolume;
use bevy::pbr::{
    AreaLightLuts, DfgLut, FogMeta, GlobalClusterableObjectMeta, LightMeta, LightProbesBuffer,
    MAX_VIEW_LIGHT_PROBES, MeshPipeline, MeshPipelineViewLayoutKey, RenderViewLightProbes,
    ShadowSamplers, ViewClusterBindings, ViewFogUniformOffset, ViewLightProbesUniformOffset,
    ViewLightsUniformOffset, ViewShadowBindings,
};
use bevy::prelude::*;
use bevy::render::globals::GlobalsBuffer;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::binding_types::{sampler, texture_3d, texture_cube};
use bevy::render::render_resource::{
    BindGroup, BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntryBuilder,
    DynamicBindGroupEntries, DynamicBindGroupLayoutEntries, PipelineCache, SamplerBindingType,
    ShaderStages, TextureSampleType, TextureView,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::{FallbackImage, GpuImage};
use bevy::render::view::{ViewUniformOffset, ViewUniforms};
use bevy::shader::ShaderDefVal;

use crate::quality::features::Features;
use crate::render::extract::ExtractedEnvironment;
use crate::render::gpu::empty_layout;
use crate::render::view::ViewKey;

/// Shadow maps to be used instead of Bevy's own.
#[derive(Clone, Debug, Default)]
pub(in crate::render) struct ShadowMaps {
    /// The maps of directional lights and spot lights.
    pub directional: Option<TextureView>,
    /// The maps of point lights.
    pub point: Option<TextureView>,
}

/// Copies of Bevy's shadow maps with meshes alone, made where volumes are then drawn into Bevy's
/// own. The trace uses the copies, because volumes shadow each other by rays.
#[derive(Debug, Default, Resource)]
pub(crate) struct MeshShadowMaps(pub ShadowMaps);

/// The bindings in Bevy's group 0 of shadow maps and their samplers.
const SHADOW_MAPS: [u32; 4] = [2, 3, 5, 6];
/// The bindings that are always needed: view, lights, clusters, globals, light probes.
const LIGHTS: [u32; 7] = [0, 1, 8, 9, 10, 11, 12];
/// The bindings of the DFG look-up table (directional albedo), which exists with Bevy's feature
/// `dfg_lut`.
const TABLE: [u32; 2] = [37, 38];
/// The binding of [`DistanceFog`].
const FOG: u32 = 13;
/// The bindings of the look-up tables of rectangle lights.
const AREA_LIGHTS: [u32; 2] = [35, 36];

/// The layouts of Bevy's two groups, for compute shaders.
#[derive(Clone, Debug)]
pub(in crate::render) struct LightLayouts {
    /// Without and with shadow maps, each without and with distance fog, and then rectangle lights.
    lights: [[[BindGroupLayoutDescriptor; 2]; 2]; 2],
    /// Without and with [`Around::maps`], [`Around::volumes`] and [`Around::arrays`].
    around: [[[BindGroupLayoutDescriptor; 2]; 2]; 2],
    /// Whether shaders can index arrays of textures.
    has_arrays: bool,
    nothing: BindGroupLayoutDescriptor,
    has_table: bool,
}

impl LightLayouts {
    pub fn new(meshes: &MeshPipeline) -> Self {
        let theirs = meshes.get_view_layout(MeshPipelineViewLayoutKey::DISTANCE_FOG);
        let theirs = theirs.main_layout.entries;
        let has_table = theirs.iter().any(|entry| entry.binding == TABLE[0]);
        let lights = |shadows: bool, fog: bool, areas: bool| {
            let wanted = |binding: u32| {
                LIGHTS.contains(&binding)
                    || TABLE.contains(&binding)
                    || (shadows && SHADOW_MAPS.contains(&binding))
                    || (fog && binding == FOG)
                    || (areas && AREA_LIGHTS.contains(&binding))
            };
            let mut entries = theirs.clone();
            entries.retain(|entry| wanted(entry.binding));
            entries.iter_mut().for_each(|entry| entry.visibility = ShaderStages::COMPUTE);
            BindGroupLayoutDescriptor { label: "vdb_lights".into(), entries }
        };
        let both = [false, true];
        Self {
            lights: both
                .map(|shadows| both.map(|fog| both.map(|areas| lights(shadows, fog, areas)))),
            around: both.map(|maps| {
                both.map(|volumes| both.map(|arrays| Around { maps, volumes, arrays }.layout()))
            }),
            has_arrays: meshes.binding_arrays_are_usable,
            nothing: empty_layout(),
            has_table,
        }
    }

    /// The layouts of groups 0 and 1; empty in unlit views.
    pub fn groups(&self, features: Features) -> [&BindGroupLayoutDescriptor; 2] {
        if !features.contains(Features::LIGHT) {
            return [&self.nothing; 2];
        }
        let Around { maps, volumes, arrays } = self.around(features);
        let lights = &self.lights[usize::from(features.contains(Features::SHADOWS))];
        let lights = &lights[usize::from(features.contains(Features::DISTANCE_FOG))];
        [
            &lights[usize::from(features.contains(Features::RECT_LIGHTS))],
            &self.around[usize::from(maps)][usize::from(volumes)][usize::from(arrays)],
        ]
    }

    /// What is bound of the light around a view.
    fn around(&self, features: Features) -> Around {
        let probes = Features::REFLECTION_PROBES;
        Around {
            maps: features.intersects(Features::ENVIRONMENT | probes),
            volumes: features.contains(Features::IRRADIANCE_VOLUMES),
            arrays: self.has_arrays && features.intersects(probes | Features::IRRADIANCE_VOLUMES),
        }
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
    pub fn shader_defs(&self, key: &ViewKey) -> impl Iterator<Item = ShaderDefVal> {
        let placed = Features::SHADOWS
            | Features::LAMPS
            | Features::RECT_LIGHTS
            | Features::MOTION_VECTORS
            | Features::DISTANCE_FOG
            | Features::FOG_COLORS
            | Features::RAMPS
            | Features::FOG_MATERIALS;
        let is_lit = key.has(Features::LIGHT);
        let even = is_lit && !key.features.intersects(placed);
        let defs = [
            key.shadow_filter,
            even.then_some("VDB_EVEN_LIGHT"),
            (is_lit && self.has_table).then_some("DFG_LUT"),
            (is_lit && self.around(key.features).arrays)
                .then_some("MULTIPLE_LIGHT_PROBES_IN_ARRAY"),
        ];
        defs.into_iter().flatten().map(ShaderDefVal::from)
    }
}

/// What is bound of the light around a view, in Bevy's group 1.
#[derive(Clone, Copy, Debug)]
struct Around {
    /// Environment maps: of the view, and in arrays also of reflection probes.
    maps: bool,
    /// Irradiance volumes; one, unless in arrays.
    volumes: bool,
    /// Whether there are arrays of maps and volumes, which not all GPUs can index.
    arrays: bool,
}

impl Around {
    fn layout(self) -> BindGroupLayoutDescriptor {
        let float = TextureSampleType::Float { filterable: true };
        let count = NonZeroU32::new(MAX_VIEW_LIGHT_PROBES as u32).filter(|_| self.arrays);
        let many = |texture: BindGroupLayoutEntryBuilder| match count {
            Some(count) => texture.count(count),
            None => texture,
        };
        let mut entries = DynamicBindGroupLayoutEntries::new(ShaderStages::COMPUTE);
        if self.maps {
            entries = entries.extend_with_indices((
                (0, many(texture_cube(float))),
                (1, many(texture_cube(float))),
                (2, sampler(SamplerBindingType::Filtering)),
            ));
        }
        if self.volumes {
            entries = entries.extend_with_indices((
                (3, many(texture_3d(float))),
                (4, sampler(SamplerBindingType::Filtering)),
            ));
        }
        BindGroupLayoutDescriptor::new("vdb_surroundings", &entries)
    }
}

/// The textures of an array, of which Bevy's shaders read those that are there: padded, as DirectX and Metal require.
fn padded<'a>(
    ids: impl Iterator<Item = AssetId<Image>>,
    images: &'a RenderAssets<GpuImage>,
    fallback: &'a GpuImage,
) -> Vec<&'a wgpu::TextureView> {
    let loaded = ids.map(|id| images.get(id).unwrap_or(fallback));
    let all = loaded.chain(std::iter::repeat(fallback)).take(MAX_VIEW_LIGHT_PROBES);
    all.map(|image| &*image.texture_view).collect()
}

/// The bind groups of Bevy's groups, with the dynamic offsets of a view.
#[derive(Clone, Debug)]
pub(in crate::render) struct LightBindGroups {
    pub groups: [BindGroup; 2],
    pub offsets: Vec<u32>,
}

/// Bevy's light components on a view.
#[derive(QueryData)]
pub(in crate::render) struct ViewLights {
    view: &'static ViewUniformOffset,
    lights: &'static ViewLightsUniformOffset,
    probes: &'static ViewLightProbesUniformOffset,
    shadows: &'static ViewShadowBindings,
    clusters: &'static ViewClusterBindings,
    environment: Option<&'static ExtractedEnvironment>,
    reflection_probes: Option<&'static RenderViewLightProbes<EnvironmentMapLight>>,
    irradiance_volumes: Option<&'static RenderViewLightProbes<IrradianceVolume>>,
    fog: Option<&'static ViewFogUniformOffset>,
}

/// Bevy's light resources for all views.
#[derive(SystemParam)]
pub(in crate::render) struct AllLights<'w> {
    views: Res<'w, ViewUniforms>,
    lights: Res<'w, LightMeta>,
    clustered: Res<'w, GlobalClusterableObjectMeta>,
    globals: Res<'w, GlobalsBuffer>,
    probes: Res<'w, LightProbesBuffer>,
    samplers: Res<'w, ShadowSamplers>,
    fogs: Res<'w, FogMeta>,
    table: Res<'w, DfgLut>,
    area_lights: Res<'w, AreaLightLuts>,
    mesh_shadows: Res<'w, MeshShadowMaps>,
    images: Res<'w, RenderAssets<GpuImage>>,
    fallback: Res<'w, FallbackImage>,
}

impl AllLights<'_> {
    /// The shadow maps for volumes: without volumes, because those shadow each other by rays.
    pub fn mesh_maps(&self) -> &ShadowMaps {
        &self.mesh_shadows.0
    }

    /// The bind groups of a view, with given shadow maps; empty in unlit views. `None` until Bevy has prepared all
    /// resources, including images.
    pub fn bind(
        &self,
        features: Features,
        layouts: &LightLayouts,
        view: Option<&ViewLightsItem>,
        maps: &ShadowMaps,
        device: &RenderDevice,
        cache: &PipelineCache,
    ) -> Option<LightBindGroups> {
        let group_layouts =
            layouts.groups(features).map(|layout| cache.get_bind_group_layout(layout));
        let group = |i: usize, entries: &[_]| {
            device.create_bind_group("vdb_lights", &group_layouts[i], entries)
        };
        if !features.contains(Features::LIGHT) {
            return Some(LightBindGroups {
                groups: [group(0, &[]), group(1, &[])],
                offsets: Vec::new(),
            });
        }
        let around =
            self.bind_around(layouts.around(features), view?, &group_layouts[1], device)?;
        let &ViewLightsItem { view, lights, probes, shadows, clusters, fog, .. } = view?;
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
            let ShadowMaps { directional, point } = maps;
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
        if features.contains(Features::RECT_LIGHTS) {
            let image = self.images.get(&self.area_lights.image)?;
            entries = entries.extend_with_indices((
                (AREA_LIGHTS[0], &image.texture_view),
                (AREA_LIGHTS[1], &image.sampler),
            ));
        }
        if layouts.has_table {
            let image = self.images.get(&self.table.texture).unwrap_or(&self.fallback.d2);
            entries = entries
                .extend_with_indices(((TABLE[0], &image.texture_view), (TABLE[1], &image.sampler)));
        }
        Some(LightBindGroups { groups: [group(0, &entries), around], offsets })
    }

    /// The bind group of the light around a view. `None` until Bevy has prepared it.
    fn bind_around(
        &self,
        bound: Around,
        view: &ViewLightsItem,
        layout: &BindGroupLayout,
        device: &RenderDevice,
    ) -> Option<BindGroup> {
        let images = &*self.images;
        let (diffuse, specular, volumes);
        let mut entries = DynamicBindGroupEntries::new();
        if bound.maps && bound.arrays {
            let probes = view.reflection_probes.map(|probes| &probes.binding_index_to_textures);
            let probes = || probes.into_iter().flatten();
            let first = probes().next().and_then(|maps| images.get(maps.diffuse));
            diffuse = padded(probes().map(|maps| maps.diffuse), images, &self.fallback.cube);
            specular = padded(probes().map(|maps| maps.specular), images, &self.fallback.cube);
            entries = entries.extend_with_indices((
                (0, diffuse.as_slice()),
                (1, specular.as_slice()),
                (2, &first.unwrap_or(&self.fallback.cube).sampler),
            ));
        } else if bound.maps {
            let maps = view.environment?;
            let maps = [images.get(maps.diffuse)?, images.get(maps.specular)?];
            entries = entries.extend_with_indices((
                (0, &maps[0].texture_view),
                (1, &maps[1].texture_view),
                (2, &maps[0].sampler),
            ));
        }
        if bound.volumes {
            let all = &view.irradiance_volumes?.binding_index_to_textures;
            let first = images.get(*all.first()?)?;
            if bound.arrays {
                volumes = padded(all.iter().copied(), images, &self.fallback.d3);
                entries = entries.extend_with_indices(((3, volumes.as_slice()),));
            } else {
                entries = entries.extend_with_indices(((3, &first.texture_view),));
            }
            entries = entries.extend_with_indices(((4, &first.sampler),));
        }
        Some(device.create_bind_group("vdb_surroundings", layout, &entries))
    }
}
