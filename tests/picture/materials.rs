//! Custom materials: what their functions get, and what becomes of what they return.

mod fogs;
mod reloading;

use bevy::asset::uuid_handle;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy::shader::{Shader, ShaderRef};
use bevy_vdb::{
    VdbDiagnostics, VdbGrid, VdbMaterial, VdbMaterialExtension, VdbMaterialPlugin, VdbQuality,
    VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};

use super::common::Stage;
use super::{GREEN, SIZE, SURFACE, burley, glow, is_green, is_red, looking, pixel_ray};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

/// A material that changes nothing.
#[derive(Clone, Component, Reflect)]
pub(super) struct Unchanged {}

const UNCHANGED: Handle<Shader> = uuid_handle!("6c9bc5b1-6a0c-4f0e-a6a4-8b7f8d9a3c01");

impl VdbMaterialExtension for Unchanged {
    fn shader() -> ShaderRef {
        UNCHANGED.into()
    }
}

/// All that a function can change, and how.
#[derive(Clone, Component, Default, Reflect)]
pub(super) struct Painted {
    pub base_color: LinearRgba,
    pub emissive: Vec3,
    pub perceptual_roughness: f32,
    pub metallic: f32,
    pub reflectance: f32,
}

const PAINTED: Handle<Shader> = uuid_handle!("6c9bc5b1-6a0c-4f0e-a6a4-8b7f8d9a3c02");

impl VdbMaterialExtension for Painted {
    fn shader() -> ShaderRef {
        PAINTED.into()
    }
}

/// Glows green below a height, and red above it.
#[derive(Clone, Component, Reflect)]
struct Banded {
    height: f32,
    /// 0 for the world, 1 for the space of the entity, 2 for index space.
    space: u32,
    /// Whether the normal points along z.
    is_flat: bool,
}

const BANDED: Handle<Shader> = uuid_handle!("6c9bc5b1-6a0c-4f0e-a6a4-8b7f8d9a3c03");

impl VdbMaterialExtension for Banded {
    fn shader() -> ShaderRef {
        BANDED.into()
    }
}

/// Fog of which a share is left, and nothing above a height.
#[derive(Clone, Component, Default, Reflect)]
pub(super) struct Thinned {
    share: f32,
    /// In the space of the entity.
    top: f32,
    color: LinearRgba,
}

const THINNED: Handle<Shader> = uuid_handle!("6c9bc5b1-6a0c-4f0e-a6a4-8b7f8d9a3c04");

impl VdbMaterialExtension for Thinned {
    fn shader() -> ShaderRef {
        THINNED.into()
    }
}

pub(super) fn add_materials(app: &mut App) {
    app.add_plugins((
        VdbMaterialPlugin::<Thinned>::default(),
        VdbMaterialPlugin::<Unchanged>::default(),
        VdbMaterialPlugin::<Painted>::default(),
        VdbMaterialPlugin::<Banded>::default(),
    ));
    let mut shaders = app.world_mut().resource_mut::<Assets<Shader>>();
    for (handle, name, text) in [
        (
            UNCHANGED,
            "unchanged.wgsl",
            "#import bevy_vdb::material::{VdbHit, VdbSurface}
             fn surface(hit: VdbHit, built_in: VdbSurface) -> VdbSurface { return built_in; }",
        ),
        (
            PAINTED,
            "painted.wgsl",
            "#import bevy_vdb::material::{VdbHit, VdbSurface, Painted}
             fn surface(hit: VdbHit, built_in: VdbSurface, painted: Painted) -> VdbSurface {
                 var changed = built_in;
                 changed.base_color = painted.base_color.rgb;
                 changed.emissive = painted.emissive;
                 changed.perceptual_roughness = painted.perceptual_roughness;
                 changed.metallic = painted.metallic;
                 changed.reflectance = painted.reflectance;
                 return changed;
             }",
        ),
        (
            BANDED,
            "banded.wgsl",
            "#import bevy_vdb::material::{VdbHit, VdbSurface, Banded}
             fn surface(hit: VdbHit, built_in: VdbSurface, banded: Banded) -> VdbSurface {
                 var changed = built_in;
                 if banded.is_flat != 0u {
                     changed.normal = vec3(0.0, 0.0, 1.0);
                     return changed;
                 }
                 var at = hit.world_position;
                 if banded.space == 1u {
                     at = hit.local_position;
                 } else if banded.space == 2u {
                     at = hit.index_position;
                 }
                 let is_above = at.y > banded.height;
                 changed.emissive = select(vec3(0.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0), is_above);
                 return changed;
             }",
        ),
        (
            THINNED,
            "thinned.wgsl",
            "#import bevy_vdb::material::{VdbFog, VdbFogPoint, Thinned}
             fn fog(at: VdbFogPoint, built_in: VdbFog, thinned: Thinned) -> VdbFog {
                 let is_above = at.local_position.y > thinned.top;
                 return VdbFog(select(thinned.share, 0.0, is_above), thinned.color.rgb);
             }",
        ),
    ] {
        shaders.insert(handle.id(), Shader::from_wgsl(text, name)).unwrap();
    }
}

/// A sun with shadows from the side, and one from the other side.
fn light(stage: &mut Stage) {
    for (from, shadow_maps_enabled) in [(Vec3::new(5.0, 3.0, 1.0), true), (-Vec3::X, false)] {
        let sun = DirectionalLight { illuminance: 4.0, shadow_maps_enabled, ..default() };
        stage.world().spawn((sun, looking(from)));
    }
}

fn features(stage: &mut Stage, camera: Entity) -> Vec<&'static str> {
    let report = stage.world().resource::<VdbDiagnostics>().camera(camera).unwrap();
    report.features.iter().map(|feature| feature.name).collect()
}

const NAME: &str = "custom materials";

/// A function that returns the built-in material changes no bit, on any kind of surface; one that returns other
/// values is the same as `VdbMaterial` with these values.
#[gpu_test]
#[ignore = "slow: each field compiles a function"]
fn a_function_has_the_effect_of_the_fields_that_it_sets() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(1.0, 2.0, 7.0)));
    // Denoised reflections change from frame to frame.
    let quality = VdbQuality { reflections: 1, denoise: false, ..default() };
    stage.world().entity_mut(camera).insert(quality);
    light(&mut stage);
    let voxels = stage.grid(level_set::sphere(DVec3::ZERO, 14.0), SURFACE, 0.1);
    let smooth = stage.grid(level_set::gyroid(DVec3::ZERO, 18.0, 15.0), SMOOTH, 0.1);
    let painted = VdbMaterial {
        base_color: Color::linear_rgb(0.9, 0.5, 0.2),
        emissive: LinearRgba::rgb(0.1, 0.0, 0.3),
        perceptual_roughness: 0.35,
        metallic: 0.75,
        reflectance: 0.25,
        ..default()
    };
    let volumes = [(voxels, -1.6), (smooth, 1.6)].map(|(grid, x)| {
        let place = Transform::from_xyz(x, 0.0, 0.0);
        stage.world().spawn((VdbVolume(grid), painted.clone(), place)).id()
    });
    let built_in = stage.picture(&target);
    built_in.save("materials_built_in");
    assert!(built_in.count(|pixel| pixel.x > 0.2) > 500, "nothing is there");
    assert!(!features(&mut stage, camera).contains(&NAME), "compiled for nothing");

    for volume in volumes {
        stage.world().entity_mut(volume).insert(Unchanged {});
    }
    assert!(stage.picture(&target) == built_in, "what is unchanged looks different");
    assert!(features(&mut stage, camera).contains(&NAME), "no function was called");

    let own = Painted {
        base_color: LinearRgba::rgb(0.9, 0.5, 0.2),
        emissive: Vec3::new(0.1, 0.0, 0.3),
        perceptual_roughness: 0.35,
        metallic: 0.75,
        reflectance: 0.25,
    };
    for volume in volumes {
        let other = (VdbMaterial::default(), own.clone());
        stage.world().entity_mut(volume).remove::<Unchanged>().insert(other);
    }
    let set = stage.picture(&target);
    set.save("materials_painted");
    assert!(set == built_in, "what the function sets is not what is seen");
    // One volume of each kind of material, and then of none.
    stage
        .world()
        .entity_mut(volumes[0])
        .remove::<Painted>()
        .insert((painted.clone(), Unchanged {}));
    assert!(stage.picture(&target) == built_in, "two kinds in a view");
    stage.world().entity_mut(volumes[0]).remove::<Unchanged>();
    stage.world().entity_mut(volumes[1]).remove::<Painted>().insert(painted);
    assert!(stage.picture(&target) == built_in, "what a material did remains");
    assert!(!features(&mut stage, camera).contains(&NAME), "compiled for what is gone");
}

/// Green or red, as each pixel's ray hits a sphere below or above the height, in each space; each volume has a
/// height of its own.
#[gpu_test]
fn functions_know_where_a_ray_hits() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(2.0, 3.0, 8.0));
    stage.camera(&target, view);
    // A grid that is moved and scaled itself, far from the origin of index space, on entities that are turned.
    let center = DVec3::new(5000.0, -3000.0, 90.0);
    let local_from_index =
        DAffine3::from_scale(DVec3::splat(0.05)) * DAffine3::from_translation(-center);
    let turned = Quat::from_euler(EulerRot::XYZ, 0.4, 0.3, -0.7);
    for (kind, offset) in [(SMOOTH, 0.0), (SURFACE, 0.06)] {
        let tree = level_set::sphere(center, 30.0);
        let grid = VdbGrid::new("test", tree, local_from_index, kind).unwrap();
        let grid = stage.world().resource_mut::<Assets<_>>().add(grid);
        let spheres = [(-1.7, 0.3), (1.7, -0.8)].map(|(x, height)| {
            let place = Transform::from_xyz(x, 0.2, 0.0).with_rotation(turned);
            let volume = stage.world().spawn((VdbVolume(grid.clone()), glow(GREEN), place)).id();
            (volume, place, height)
        });
        for space in 0..3_u32 {
            for (volume, _, height) in spheres {
                // Heights are given in the space of the entity.
                let own = match space {
                    0 => 0.2 + height,
                    1 => height,
                    _ => -3000.0 + height / 0.05,
                };
                let banded = Banded { height: own, space, is_flat: false };
                stage.world().entity_mut(volume).insert(banded);
            }
            let picture = stage.picture(&target);
            picture.save(&format!("materials_space_{space}_{kind:?}"));
            let (mut reds, mut greens) = (0, 0);
            for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
                let (from, dir) = pixel_ray(view, x, y);
                let dir = dir.normalize();
                for (_, place, height) in spheres {
                    let center = place.translation.as_dvec3();
                    let (along, radius) = ((center - from).dot(dir), 1.5);
                    let miss = (from + along * dir).distance(center);
                    // Beside the silhouette, where the ray surely hits.
                    if miss > radius - 0.1 {
                        continue;
                    }
                    let hit =
                        from + (along - (radius * radius - miss * miss).sqrt()) * dir - center;
                    let turned = place.rotation.as_dquat().inverse() * hit;
                    let over = if space == 0 { hit.y } else { turned.y } - f64::from(height);
                    // As far as the surface is from the sphere.
                    if over.abs() < 0.01 + offset {
                        continue;
                    }
                    let (pixel, above) = (picture.at(x, y), over > 0.0);
                    let is_right = if above { is_red(pixel) } else { is_green(pixel) };
                    assert!(is_right, "{kind:?}, space {space}: {x}, {y}: {pixel}, {over} above");
                    *(if above { &mut reds } else { &mut greens }) += 1;
                }
            }
            assert!(
                reds > 50 && greens > 50,
                "{kind:?}, space {space}: {reds} red, {greens} green"
            );
        }
        for (volume, ..) in spheres {
            stage.world().despawn(volume);
        }
    }
}

/// A normal that a function sets is the one that light falls on.
#[gpu_test]
fn light_falls_on_the_normal_that_a_function_sets() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let view = looking(Vec3::Z * 8.0);
    stage.camera(&target, view);
    let sun = DirectionalLight { illuminance: 3.0, ..default() };
    let to_sun = Vec3::new(2.0, 1.0, 2.0);
    stage.world().spawn((sun, looking(to_sun)));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 30.0), SMOOTH, 0.05);
    let roughness = 0.6;
    let matt = VdbMaterial { perceptual_roughness: roughness, reflectance: 0.0, ..default() };
    let flat = Banded { height: 0.0, space: 0, is_flat: true };
    stage.world().spawn((VdbVolume(grid), matt, flat));
    let picture = stage.picture(&target);
    picture.save("materials_flat");
    let mut pixels = 0;
    for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
        let (from, dir) = pixel_ray(view, x, y);
        let dir = dir.normalize();
        if (from - from.dot(dir) * dir).length() > 1.4 {
            continue;
        }
        let to_light = to_sun.as_dvec3().normalize();
        let reflected = burley(DVec3::Z, -dir, to_light, f64::from(roughness));
        let expected = 3.0 * to_light.z * reflected;
        let found = f64::from(picture.at(x, y).y);
        // Bevy's roughness is squared in half floats, and so is the picture.
        assert!((found - expected).abs() < 0.01 * expected, "{x}, {y}: {found} and not {expected}");
        pixels += 1;
    }
    assert!(pixels > 300, "{pixels} pixels");
}
