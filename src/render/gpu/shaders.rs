//! The shaders, embedded in the binary. With Bevy's feature `embedded_watcher`, an edited file in
//! `assets/shaders/` is reloaded while the app runs.

use std::path::{Path, PathBuf};

use bevy::asset::io::embedded::EmbeddedAssetRegistry;
use bevy::prelude::*;
use bevy::shader::Shader;

macro_rules! shaders {
    ($($name:literal),*) => {
        [$(($name, include_bytes!(concat!("../../../assets/shaders/", $name, ".wgsl")).as_slice())),*]
    };
}

/// The modules that shaders import.
const IMPORTS: [(&str, &[u8]); 67] = shaders![
    "gpu/types",
    "gpu/bindings",
    "material/table",
    "material/fog",
    "traversal/rays",
    "traversal/tree",
    "traversal/samples",
    "traversal/exact",
    "traversal/hdda",
    "traversal/beam",
    "traversal/rebase",
    "traversal/cubic",
    "traversal/smooth",
    "traversal/normals",
    "traversal/ramps",
    "traversal/fog",
    "traversal/maximum",
    "trace/emission",
    "traversal/march",
    "view/depths",
    "view/picture",
    "view/reflection",
    "view/scene",
    "trace/segment",
    "trace/bvh",
    "trace/candidates",
    "trace/caps",
    "trace/surface",
    "trace/color",
    "trace/material",
    "trace/occlusion",
    "trace/scattering",
    "trace/scattered_light",
    "scattered_light/layout",
    "trace/light_list",
    "trace/illuminance",
    "trace/edge_list",
    "trace/mesh_reflections",
    "trace/mesh_shadows",
    "trace/visibility",
    "trace/rect_lights",
    "shadow_maps/opacity",
    "fog_shadows/grain",
    "fog_shadows/maps",
    "trace/lights",
    "trace/cached_lights",
    "trace/shade",
    "trace/reflection",
    "trace/distance_fog",
    "light_cache/lattice",
    "light_cache/store",
    "light_cache/columns",
    "trace/light_cache",
    "trace/fog_march",
    "trace/shared_light",
    "trace/ramp_light",
    "trace/medium",
    "trace/span",
    "trace/intervals",
    "trace/media_step",
    "trace/media",
    "trace/slabs",
    "trace/fogs",
    "trace/show",
    "trace/maximum",
    "trace/seen",
    "trace/path"
];
/// The shaders with entry points.
const PROGRAMS: [(&str, &[u8]); 21] = shaders![
    "trace/beams",
    "trace/edges",
    "trace/trace",
    "trace/lamp_light",
    "denoise/denoise",
    "upscale/upscale",
    "accumulate/accumulate",
    "composite/composite",
    "shadow_maps/quad",
    "shadow_maps/fill_opacity",
    "shadow_maps/cast_fog",
    "shadow_maps/cast",
    "shadow_maps/mesh_depth",
    "fog_shadows/find",
    "fog_shadows/smooth",
    "fog_shadows/draw",
    "light_cache/fill",
    "light_cache/sun_rays",
    "light_cache/sun_samples",
    "scattered_light/octants",
    "scattered_light/solve"
];

pub(crate) fn embed(app: &mut App) {
    let registry = app.world_mut().resource_mut::<EmbeddedAssetRegistry>();
    for (name, source) in IMPORTS.into_iter().chain(PROGRAMS) {
        let file = PathBuf::from(format!("assets/shaders/{name}.wgsl"));
        registry.insert_asset(file, Path::new(&format!("bevy_vdb/shaders/{name}.wgsl")), source);
    }
}

/// A command that reloads the shaders of volumes: from the source folder of the crate if that still
/// exists, otherwise from the binary.
///
/// For developing the shaders, in apps without Bevy's feature `embedded_watcher`:
///
/// ```no_run
/// # use bevy::prelude::*;
/// use bevy_vdb::VdbReloadShaders;
///
/// fn reload(keys: Res<ButtonInput<KeyCode>>, mut commands: Commands) {
///     if keys.just_pressed(KeyCode::F5) {
///         commands.queue(VdbReloadShaders);
///     }
/// }
/// ```
///
/// Until the new shaders are compiled, and if they cannot be, volumes are drawn with the old ones.
/// Errors are logged. Does nothing in an app without a renderer.
#[derive(Clone, Copy, Debug, Default)]
pub struct VdbReloadShaders;

impl Command for VdbReloadShaders {
    type Out = ();

    fn apply(self, world: &mut World) {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/assets/shaders"));
        let Some(registry) = world.get_resource::<EmbeddedAssetRegistry>() else { return };
        for (name, _) in IMPORTS.into_iter().chain(PROGRAMS) {
            if let Ok(source) = std::fs::read(folder.join(name).with_extension("wgsl")) {
                let asset = PathBuf::from(format!("bevy_vdb/shaders/{name}.wgsl"));
                registry.insert_asset(folder.join(name).with_extension("wgsl"), &asset, source);
            }
        }
        let Some(assets) = world.get_resource::<AssetServer>() else { return };
        for (name, _) in IMPORTS.into_iter().chain(PROGRAMS) {
            assets.reload(format!("embedded://bevy_vdb/shaders/{name}.wgsl"));
        }
    }
}

/// Handles of the shaders with entry points, and of the modules that they import.
#[derive(Clone, Debug, Resource)]
pub(crate) struct Shaders {
    pub beams: Handle<Shader>,
    pub edges: Handle<Shader>,
    pub trace: Handle<Shader>,
    pub lamp_light: Handle<Shader>,
    pub denoise: Handle<Shader>,
    pub upscale: Handle<Shader>,
    pub accumulate: Handle<Shader>,
    pub composite: Handle<Shader>,
    pub quad: Handle<Shader>,
    pub fill_opacity: Handle<Shader>,
    pub cast_fog: Handle<Shader>,
    pub cast: Handle<Shader>,
    pub mesh_depth: Handle<Shader>,
    pub find_grain: Handle<Shader>,
    pub remove_grain: Handle<Shader>,
    pub draw_smoothed: Handle<Shader>,
    pub fill: Handle<Shader>,
    pub sun_rays: Handle<Shader>,
    pub sun_samples: Handle<Shader>,
    pub octants: Handle<Shader>,
    pub solve: Handle<Shader>,
    _imports: [Handle<Shader>; IMPORTS.len()],
}

/// Loads the shaders when the renderer starts.
pub(crate) fn load_shaders(mut commands: Commands, assets: Res<AssetServer>) {
    commands.insert_resource(Shaders::load(&assets));
}

impl Shaders {
    fn load(assets: &AssetServer) -> Self {
        let load = |(name, _)| assets.load(format!("embedded://bevy_vdb/shaders/{name}.wgsl"));
        let [
            beams,
            edges,
            trace,
            lamp_light,
            denoise,
            upscale,
            accumulate,
            composite,
            quad,
            fill_opacity,
            cast_fog,
            cast,
            mesh_depth,
            find_grain,
            remove_grain,
            draw_smoothed,
            fill,
            sun_rays,
            sun_samples,
            octants,
            solve,
        ] = PROGRAMS.map(load);
        let _imports = IMPORTS.map(load);
        Self {
            beams,
            edges,
            trace,
            lamp_light,
            denoise,
            upscale,
            accumulate,
            composite,
            quad,
            fill_opacity,
            cast_fog,
            cast,
            mesh_depth,
            find_grain,
            remove_grain,
            draw_smoothed,
            fill,
            sun_rays,
            sun_samples,
            octants,
            solve,
            _imports,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::VdbRenderMode;
    use crate::quality::features::FEATURES;

    /// Shader defs that belong neither to features of a view nor to render modes: those of formats and adapters,
    /// and those of the programs of `vdb_probe`.
    const OTHERS: [&str; 10] = [
        "VDB_CACHED_SUNS",
        "VDB_EMITTER_SLOTS",
        "VDB_EVEN_LIGHT",
        "VDB_FOG_ALONE",
        "VDB_FOG_SLOTS",
        "VDB_FORMAT",
        "VDB_PAGED",
        "VDB_PAGE_BITS",
        "VDB_STORABLE_LATTICE",
        "VDB_WITH_FOG",
    ];

    /// A misspelt shader def has no effect, and is not reported.
    #[test]
    fn shaders_ask_for_defs_that_are_set_and_for_no_others() {
        let sources = IMPORTS.into_iter().chain(PROGRAMS).map(|(_, source)| source);
        let all: String = sources.map(|source| String::from_utf8_lossy(source)).collect();
        let words = all.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        let asked: BTreeSet<_> = words.filter(|word| word.starts_with("VDB_")).collect();
        let features = FEATURES.iter().flat_map(|feature| feature.defs).copied();
        let modes = VdbRenderMode::ALL.iter().filter_map(|mode| mode.traits().shader_def);
        let set: BTreeSet<_> =
            features.chain(modes).chain(OTHERS).filter(|def| def.starts_with("VDB_")).collect();
        assert_eq!(asked, set);
    }
}
