//! Reports of the passes, features and buffers of each view, for [`VdbDiagnostics`].

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{Buffer, Texture};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::CachedTexture;
use bevy::render::{Render, RenderApp, RenderSystems};

use super::accumulate::{AccumulateView, Accumulated, Mean};
use super::composite::CompositeView;
use super::denoise::DenoiseView;
use super::fog_shadows::{SMOOTHED, SmoothedViews};
use super::light_cache::{LightCache, LightCacheView};
use super::scattered_light::{ScatteredLight, ScatteredLightView};
use super::shadow_maps::CastShadows;
use super::trace::{EdgesView, TraceView};
use super::upscale::UpscaleView;
use super::view::{MaterialTable, PreparedView, RampTexture, ViewPicture, ViewState};
use crate::quality::diagnostics::{
    PASSES, VdbBufferReport, VdbCameraReport, VdbDiagnostics, VdbFeatureReport, VdbPassReport,
};
use crate::quality::features::Features;

/// Reports to the app's world what each camera uses.
pub(super) struct ReportPlugin;

impl Plugin for ReportPlugin {
    fn build(&self, app: &mut App) {
        let diagnostics = app.world().resource::<VdbDiagnostics>().clone();
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .insert_resource(diagnostics)
            .add_systems(Render, report.in_set(RenderSystems::PrepareBindGroups));
    }
}

/// The components of all passes on a view.
type ViewData<'a> = (
    &'a MainEntity,
    &'a ViewState,
    &'a ViewPicture,
    (&'a LightCacheView, &'a ScatteredLightView, &'a TraceView, &'a EdgesView),
    (&'a DenoiseView, &'a UpscaleView),
    &'a AccumulateView,
    &'a CompositeView,
);

fn report(
    views: Query<(Entity, ViewData)>,
    (shadows, smoothed): (Res<CastShadows>, Res<SmoothedViews>),
    (light_cache, scattered): (Res<LightCache>, Res<ScatteredLight>),
    (ramps, materials): (Res<RampTexture>, Res<MaterialTable>),
    diagnostics: Res<VdbDiagnostics>,
) {
    let reports: HashMap<_, _> = views
        .iter()
        .filter_map(|(view, data)| {
            let textures = (&*ramps, &*materials);
            let light = (&*light_cache, &*scattered);
            let casts = shadows.are_cast_for(view);
            let on_meshes = OnMeshes {
                casts,
                opacity: shadows.opacity().filter(|_| casts),
                fills_opacity: casts && shadows.fills_opacity(),
                smoothed: smoothed.textures(view),
            };
            of_view(data, on_meshes, light, textures)
        })
        .collect();
    diagnostics.set(reports);
}

/// The resources that shadows of volumes on meshes use.
struct OnMeshes<'a> {
    casts: bool,
    opacity: Option<&'a Texture>,
    fills_opacity: bool,
    /// See [`SMOOTHED`].
    smoothed: Option<[&'a CachedTexture; 3]>,
}

fn of_view(
    (
        camera,
        state,
        picture,
        (light, solve, trace, edges),
        (denoise, upscale),
        accumulate,
        composite,
    ): (
        &MainEntity,
        &ViewState,
        &ViewPicture,
        (&LightCacheView, &ScatteredLightView, &TraceView, &EdgesView),
        (&DenoiseView, &UpscaleView),
        &AccumulateView,
        &CompositeView,
    ),
    on_meshes: OnMeshes,
    (light_cache, scattered): (&LightCache, &ScatteredLight),
    (ramps, materials): (&RampTexture, &MaterialTable),
) -> Option<(Entity, VdbCameraReport)> {
    let (prepared, uniform) = state.prepared()?;
    let frames = accumulate.accumulated.as_ref().map_or(0, |accumulated| accumulated.frame);
    let mut buffers = Buffers::default();
    buffers.add("vdb_view", uniform, "the camera");
    buffers.add_some("vdb_placement", &composite.placement, "the viewport");
    buffers.add_on_meshes(&on_meshes);
    if let Some(traced) = &picture.traced {
        buffers.push("vdb_color", bytes(&traced.color), "the colours of the traced image");
        buffers.push("vdb_depth", bytes(&traced.depth), "the depths of the traced image");
    }
    buffers.add_light(prepared, light, trace, light_cache, scattered);
    if prepared.key.has(Features::RAMPS) {
        buffers.push("vdb_ramps", ramps.table.bytes(), "fogs have a VdbRamp");
    }
    if prepared.key.features.intersects(Features::OWN_MATERIALS) {
        let why = "volumes have a VdbMaterialExtension";
        buffers.push("vdb_materials", materials.table.bytes(), why);
    }
    buffers.add_trace(picture, trace, edges);
    if let Some(motion) = &composite.motion {
        buffers.add("vdb_motion", &motion.matrices, "motion vectors");
        if let Some([velocities, means]) = &motion.of_velocities {
            let why = "a volume in view has a VdbVelocity";
            buffers.add("vdb_velocities", velocities, why);
            buffers.add("vdb_velocity_means", means, why);
        }
    }
    buffers.add_later(trace, denoise, upscale);
    if let Some(mean) = accumulate.accumulated.as_ref().and_then(Accumulated::mean) {
        buffers.add_mean(mean);
    }
    let report = VdbCameraReport {
        volumes: prepared.data.volume_count,
        volumes_beside: prepared.data.offscreen_count,
        rays: prepared.size(),
        frames,
        is_compiling: !prepared.is_ready || prepared.is_fallback,
        features: features(prepared),
        passes: passes(
            &on_meshes,
            (light, solve, trace, edges),
            (denoise, upscale),
            frames,
            composite,
        ),
        buffers: buffers.0,
    };
    Some((camera.id(), report))
}

fn features(prepared: &PreparedView) -> Vec<VdbFeatureReport> {
    let rows = prepared.key.features.rows();
    rows.map(|row| VdbFeatureReport { name: row.name, why: row.why }).collect()
}

/// Why pixels on edges are traced again.
const EDGES: &str = "VdbQuality::edge_samples is more than 0, and a surface is in view";

/// The passes that run, of [`PASSES`].
fn passes(
    on_meshes: &OnMeshes,
    (light, solve, trace, edges): (&LightCacheView, &ScatteredLightView, &TraceView, &EdgesView),
    (denoise, upscale): (&DenoiseView, &UpscaleView),
    frames: u32,
    composite: &CompositeView,
) -> Vec<VdbPassReport> {
    let is_composited = composite.surface.is_some() || composite.fog.is_some();
    let lamps = light.lamp_light();
    let gathers = trace.lamp_light.as_ref().is_some_and(|own| own.is_due(lamps));
    let all: [(bool, &'static str); PASSES.len()] = [
        (on_meshes.fills_opacity, "a fog that casts shadows on meshes, or its light, has changed"),
        (on_meshes.casts, "VdbCamera::mesh_shadows, and a light with shadow_maps_enabled"),
        (on_meshes.smoothed.is_some(), "VdbQuality::denoise, and fog casts shadows on a mesh"),
        (light.is_filled(), "a fog, its light or an occluder has changed"),
        (solve.is_solved(), "a fog or its light has changed"),
        (gathers, "lamps light a fog, and the camera or something in their light has moved"),
        (true, "a volume is in view"),
        (edges.list.is_some(), EDGES),
        (edges.list.is_some(), EDGES),
        (denoise.runs(), "VdbQuality::denoise, and a rough surface reflects"),
        (upscale.pipeline.is_some(), "VdbQuality::resolution is less than 1"),
        (frames > 0, "VdbQuality::accumulate, and nothing has changed"),
        (is_composited, "the traced image is displayed"),
    ];
    let on = PASSES.into_iter().zip(all).filter(|(_, (on, _))| *on);
    on.map(|(name, (_, why))| VdbPassReport { name, why }).collect()
}

#[derive(Default)]
struct Buffers(Vec<VdbBufferReport>);

impl Buffers {
    fn push(&mut self, name: &'static str, bytes: u64, why: &'static str) {
        self.0.push(VdbBufferReport { name, bytes, why });
    }

    fn add(&mut self, name: &'static str, buffer: &Buffer, why: &'static str) {
        self.push(name, buffer.size(), why);
    }

    fn add_some(&mut self, name: &'static str, buffer: &Option<Buffer>, why: &'static str) {
        if let Some(buffer) = buffer {
            self.add(name, buffer, why);
        }
    }

    fn add_on_meshes(&mut self, on_meshes: &OnMeshes) {
        if let Some(texture) = on_meshes.opacity {
            let why = "fog casts shadows on meshes, in maps that all cameras share";
            self.push("vdb_opacity", texture_bytes(texture), why);
        }
        if let Some(textures) = on_meshes.smoothed {
            let why = "fog casts shadows on meshes";
            for (name, texture) in SMOOTHED.into_iter().zip(textures) {
                self.push(name, bytes(texture), why);
            }
        }
    }

    /// What light in fog is stored in.
    fn add_light(
        &mut self,
        prepared: &PreparedView,
        light: &LightCacheView,
        trace: &TraceView,
        light_cache: &LightCache,
        scattered: &ScatteredLight,
    ) {
        if light.is_used() {
            let [atlas, staging, depths] = light_cache.bytes();
            self.push("vdb_light_atlas", atlas, "the light cache, which all cameras share");
            if light.bytes() > 0 {
                let why = "point or spot lights cast shadows in the light cache";
                self.push("vdb_lamp_lattices", light.bytes(), why);
            }
            if let Some(scattered) = &trace.lamp_light {
                let why = "light that lamps scatter in fog towards the camera";
                self.push("vdb_lamp_light", scattered.bytes(), why);
            }
            if staging > 0 {
                self.push("vdb_light_staging", staging, "the light cache is being filled");
            }
            if depths > 0 {
                self.push("vdb_light_depths", depths, "the light cache is being filled for a sun");
            }
        }
        if prepared.key.has(Features::SCATTERED_LIGHT) {
            let [texture, changing] = scattered.bytes();
            let why = "light that fogs scatter repeatedly, which all cameras share";
            self.push("vdb_scattered_light", texture, why);
            if changing > 0 {
                self.push("vdb_scattered_changes", changing, "scattered light is being solved for");
            }
        }
    }

    fn add_trace(&mut self, picture: &ViewPicture, trace: &TraceView, edges: &EdgesView) {
        self.add_some("vdb_tiles", &trace.tiles, "the rays of a tile share a start");
        self.add_some("vdb_edge_pixels", &edges.list, EDGES);
        if let Some(moving) = picture.traced.as_ref().and_then(|traced| traced.moving.as_ref()) {
            self.push("vdb_moving", bytes(moving), "motion vectors");
        }
    }

    /// What the passes between the trace and the mean of frames write.
    fn add_later(&mut self, trace: &TraceView, denoise: &DenoiseView, upscale: &UpscaleView) {
        if let (Some(reflections), Some(outputs)) = (&trace.reflections, &denoise.outputs) {
            let why = "reflections in rough surfaces are denoised";
            self.push("vdb_reflections", bytes(reflections), why);
            self.push("vdb_denoised", outputs.iter().map(bytes).sum(), why);
        }
        if let (Some(firsts), Some(means)) = (&trace.first_reflections, denoise.means()) {
            let why = "reflections are averaged over frames";
            self.push("vdb_first_reflections", bytes(firsts), why);
            self.push("vdb_reflection_means", means.iter().map(bytes).sum(), why);
        }
        if let Some(upscaled) = &upscale.picture {
            let why = "there are fewer rays than pixels";
            self.push("vdb_color_upscaled", bytes(&upscaled.color), why);
            self.push("vdb_depth_upscaled", bytes(&upscaled.depth), why);
            if let Some(moving) = &upscaled.moving {
                let why = "motion vectors, with fewer rays than pixels";
                self.push("vdb_moving_upscaled", bytes(moving), why);
            }
        }
    }

    fn add_mean(&mut self, mean: &Mean) {
        let why = "frames are accumulated";
        self.add("vdb_means", &mean.buffer, why);
        self.push("vdb_color_mean", bytes(&mean.color), why);
        self.push("vdb_depth_mean", bytes(&mean.depth), why);
    }
}

/// The size of a texture in bytes.
fn bytes(texture: &CachedTexture) -> u64 {
    texture_bytes(&texture.texture)
}

fn texture_bytes(texture: &Texture) -> u64 {
    let size = texture.size();
    let texel = texture.format().block_copy_size(None).unwrap_or(0);
    u64::from(size.width)
        * u64::from(size.height)
        * u64::from(size.depth_or_array_layers)
        * u64::from(texel)
}
