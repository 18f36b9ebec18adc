//! Rendering: from the app's world to the image. A folder is a stage, and imports only from earlier
//! stages: [`gpu`], [`extract`], [`pool`], [`view`], then one plugin per pass.

mod accumulate;
mod composite;
mod denoise;
mod drawn;
mod extract;
mod fog_shadows;
mod gpu;
mod light_cache;
mod pool;
mod report;
mod scattered_light;
mod shadow_maps;
mod trace;
mod upscale;
mod view;

use bevy::core_pipeline::core_3d::{main_opaque_pass_3d, main_transparent_pass_3d};
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::pbr::main_transmissive_pass_3d;
use bevy::prelude::*;
use bevy::render::RenderApp;

pub use extract::VdbMaterialPlugin;
pub use gpu::VdbReloadShaders;
pub use pool::VdbGpuUsage;
pub use view::VdbSystems;

/// Renders volumes: adds the plugins of all stages.
pub(crate) struct RenderVolumesPlugin;

impl Plugin for RenderVolumesPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins((
            gpu::GpuPlugin,
            extract::ExtractPlugin,
            pool::PoolPlugin,
            view::ViewPlugin,
            light_cache::LightCachePlugin,
            scattered_light::ScatteredLightPlugin,
            trace::TracePlugin,
            denoise::DenoisePlugin,
            upscale::UpscalePlugin,
            accumulate::AccumulatePlugin,
            shadow_maps::ShadowMapsPlugin,
            fog_shadows::FogShadowsPlugin,
            composite::CompositePlugin,
            report::ReportPlugin,
            drawn::DrawnPlugin,
        ));
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.configure_sets(
            Core3d,
            (VdbSystems::Trace, VdbSystems::Composite)
                .chain()
                .in_set(Core3dSystems::MainPass)
                .after(main_opaque_pass_3d)
                .before(main_transmissive_pass_3d)
                .before(main_transparent_pass_3d),
        );
    }
}
