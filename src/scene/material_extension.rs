//! Custom materials.

use bevy::prelude::*;
use bevy::reflect::Typed;
use bevy::reflect::structs::Struct;
use bevy::shader::ShaderRef;

/// A custom material: a function in WGSL that changes the
/// [`VdbMaterial`](crate::VdbMaterial) of a surface wherever a ray hits it, like Bevy's
/// `MaterialExtension` for meshes.
///
/// The component holds the parameters. Add it to the entity of a [`VdbVolume`](crate::VdbVolume),
/// and register its type with [`VdbMaterialPlugin`](crate::VdbMaterialPlugin):
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy::shader::ShaderRef;
/// # use bevy_vdb::prelude::*;
/// /// Sand that is dark and glossy below the water line.
/// #[derive(Clone, Component, Reflect)]
/// struct WetSand {
///     /// A height in the local space of the entity.
///     water_line: f32,
///     wet_color: Color,
/// }
///
/// impl VdbMaterialExtension for WetSand {
///     fn shader() -> ShaderRef {
///         "shaders/wet_sand.wgsl".into()
///     }
/// }
///
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// let wet_color = Color::linear_rgb(0.1, 0.07, 0.04);
/// commands.spawn((
///     VdbVolume(assets.load("beach.vdb")),
///     VdbMaterial { base_color: Color::linear_rgb(0.6, 0.5, 0.35), ..default() },
///     WetSand { water_line: 0.4, wet_color },
/// ));
/// # }
/// # fn main() {
/// App::new().add_plugins((DefaultPlugins, VdbRenderPlugin, VdbMaterialPlugin::<WetSand>::default()));
/// # }
/// ```
///
/// The shader, here `assets/shaders/wet_sand.wgsl`, has a function `surface`:
///
/// ```wgsl
/// #import bevy_vdb::material::{VdbHit, VdbSurface, WetSand}
///
/// fn surface(hit: VdbHit, built_in: VdbSurface, sand: WetSand) -> VdbSurface {
///     var changed = built_in;
///     if hit.local_position.y < sand.water_line {
///         changed.base_color = sand.wet_color.rgb;
///         changed.perceptual_roughness = 0.2;
///     }
///     return changed;
/// }
/// ```
///
/// The plugin generates the shader's struct `WetSand` from the component. It has the same fields:
/// `f32`, `i32`, `u32`, [`Vec2`], [`Vec3`] and [`Vec4`] as they are, `bool` as `u32`, and [`Color`]
/// and [`LinearRgba`] as `vec4<f32>` in linear colours. Fields with `#[reflect(ignore)]` are left
/// out; all others together may have at most 16 numbers. If the component has no fields, there is
/// no struct in the shader, and the function has no third parameter.
///
/// [The guide](https://github.com/bevy-vdb/bevy_vdb/blob/main/docs/guide/materials.md) describes
/// `VdbHit` and `VdbSurface`.
///
/// A function `fog(at: VdbFogPoint, built_in: VdbFog, parameters) -> VdbFog` changes the density and
/// the albedo of fog in the same way, for all rays that meet it. A shader has one of the two
/// functions, or both. Fog with a [`VdbRamp`](crate::VdbRamp) ignores its function, unlit render
/// modes show surfaces without theirs, and [`VdbSpatialQuery`](crate::VdbSpatialQuery) uses the grid
/// as it is.
///
/// A volume uses one custom material. While its shader is not loaded yet, or if it does not compile,
/// the volume is shown with its `VdbMaterial`.
pub trait VdbMaterialExtension: Component + Clone + Struct + Typed {
    /// The shader with the function. With Bevy's feature `file_watcher`, changes to its file are
    /// displayed while the app runs; errors in the file are reported, and the previous function stays
    /// in use.
    fn shader() -> ShaderRef;
}
