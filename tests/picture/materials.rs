//! Custom materials: what their functions get, and what becomes of what they return.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use bevy::asset::uuid_handle;
use bevy::light::{DirectionalLightShadowMap, PointLightShadowMap};
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
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::reload::{listen, said_of};
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
    stage.world().entity_mut(camera).insert(VdbQuality { reflections: 1, ..default() });
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

/// A fog over a floor, in the light of a sun and a lamp with shadows.
fn fog_over_floor(stage: &mut Stage) -> Entity {
    let floor = stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(8.0, 0.2, 8.0));
    let white = StandardMaterial { perceptual_roughness: 1.0, ..default() };
    let white = stage.world().resource_mut::<Assets<StandardMaterial>>().add(white);
    let place = Transform::from_xyz(0.0, -1.6, 0.0);
    stage.world().spawn((Mesh3d(floor), MeshMaterial3d(white), place));
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(1.0, 4.0, 1.0))));
    let lamp = PointLight { intensity: 200.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((lamp, Transform::from_xyz(-2.0, 2.0, 2.0)));
    let grid = stage.grid(fog::sphere(DVec3::ZERO, 12.0, 9.0), PackKind::Fog, 0.1);
    stage.world().spawn(VdbVolume(grid)).id()
}

/// The largest difference between two pictures, over the brightest pixel of the first.
fn largest_difference(a: &Picture, b: &Picture) -> f32 {
    let brightest = a.pixels.iter().map(|pixel| pixel.max_element()).fold(0.0, f32::max);
    let pairs = a.pixels.iter().zip(&b.pixels);
    pairs.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max) / brightest
}

/// Fog of which a function leaves half is fog of half the density, in all that sees it: exact and sampled rays, rays
/// towards lights, the light cache and the shadow maps of meshes. And so it is with its albedo.
#[gpu_test]
#[ignore = "slow: each way of lighting compiles shaders of its own"]
fn half_of_a_fog_is_fog_of_half_the_density() {
    let mut stage = Stage::with(add_materials);
    stage.world().insert_resource(DirectionalLightShadowMap { size: 128 });
    stage.world().insert_resource(PointLightShadowMap { size: 64 });
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.5, 2.0, 6.0)));
    let volume = fog_over_floor(&mut stage);
    let color = LinearRgba::rgb(1.0, 0.5, 0.25);
    for (name, quality) in [
        ("exact", VdbQuality { fog_step: 0.0, fog_light_error: 0.0, ..default() }),
        ("sampled", VdbQuality { fog_step: 1.0, fog_light_error: 0.0, ..default() }),
        ("cached", VdbQuality::default()),
    ] {
        stage.world().entity_mut(camera).insert(quality);
        let material = VdbMaterial { density_scale: 2.0, ..default() };
        stage.world().entity_mut(volume).remove::<Thinned>().insert(material.clone());
        let whole = stage.picture(&target);
        let half = VdbMaterial { density_scale: 1.0, base_color: color.into(), ..default() };
        stage.world().entity_mut(volume).insert(half);
        let half = stage.picture(&target);
        let own = Thinned { share: 0.5, top: 9.0, color };
        stage.world().entity_mut(volume).insert((material, own));
        let thinned = stage.picture(&target);
        for (picture, what) in [(&whole, "whole"), (&half, "half"), (&thinned, "thinned")] {
            picture.save(&format!("materials_fog_{name}_{what}"));
        }
        let effect = largest_difference(&half, &whole);
        assert!(effect > 0.1, "{name}: half is the whole but for {effect}");
        // Factors of two are exact; but light is in the cache with 16 bits, and albedos are summed.
        let error = largest_difference(&half, &thinned);
        println!("{name}: {error}, of {effect}");
        assert!(error < 2e-3, "{name}: {error}");
    }
}

/// Where a function leaves nothing, there is nothing; elsewhere all is as it was.
#[gpu_test]
fn functions_know_where_they_are_in_a_fog() {
    let mut stage = Stage::with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    // In tiles and in leaves, away from the origin of index space.
    let cube = CoordBox { min: IVec3::new(90, -40, 0), max: IVec3::new(149, 19, 63) };
    let local_from_index = DAffine3::from_scale(DVec3::splat(0.05))
        * DAffine3::from_translation(DVec3::new(-119.5, 10.5, -31.5));
    let grid =
        VdbGrid::new("test", fog::block(cube, 1.0), local_from_index, PackKind::Fog).unwrap();
    let grid = stage.world().resource_mut::<Assets<VdbGrid>>().add(grid);
    let shine = VdbMaterial { emissive: GREEN, base_color: Color::BLACK, ..default() };
    // What is above in the space of the entity is on the left.
    let turned = Transform::from_rotation(Quat::from_rotation_z(std::f32::consts::FRAC_PI_2));
    let volume = stage.world().spawn((VdbVolume(grid), shine, turned)).id();
    for fog_step in [0.0, 1.0] {
        stage.world().entity_mut(camera).insert(VdbQuality { fog_step, ..default() });
        let [all, below] =
            [9.0, 0.0].map(|top| Thinned { share: 1.0, top, color: LinearRgba::WHITE });
        stage.world().entity_mut(volume).insert(all);
        let whole = stage.picture(&target);
        stage.world().entity_mut(volume).insert(below);
        let part = stage.picture(&target);
        part.save(&format!("materials_fog_part_{fog_step}"));
        let (mut left, mut right) = (0, 0);
        for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
            let (before, now) = (whole.at(x, y), part.at(x, y));
            if before.y < 0.1 || x.abs_diff(SIZE.x / 2) < 2 {
                continue;
            }
            if x < SIZE.x / 2 {
                assert!(now.y == 0.0, "{fog_step}: {x}, {y}: {now} is left of {before}");
                left += 1;
            } else {
                assert!(now == before, "{fog_step}: {x}, {y}: {now}, {before}");
                right += 1;
            }
        }
        assert!(left > 300 && right > 300, "{fog_step}: {left} left, {right} right");
    }
}

/// Volumes are in every frame, with and without a material that has just been added.
#[gpu_test]
fn no_frame_is_blank_while_a_material_is_compiled() {
    let mut stage = Stage::compiling_beside_with(add_materials);
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    let volume = stage.world().spawn((VdbVolume(grid), glow(GREEN))).id();
    assert!(is_green(stage.picture(&target).center()));
    let red = Painted { emissive: Vec3::X, ..default() };
    stage.world().entity_mut(volume).insert(red);
    let (frames, waited) = stage.frames_until_settled(&target);
    assert!(waited > 0, "nothing was compiled");
    let center = |frame: &Picture| frame.center();
    assert!(frames.iter().map(center).all(|pixel| is_green(pixel) || is_red(pixel)));
    assert!(is_red(frames.last().unwrap().center()));
}

/// When a function changes, frames with the one before leave the mean.
#[gpu_test]
fn a_new_function_leaves_nothing_of_the_old_in_the_mean() {
    let mut stage = Stage::compiling_beside_with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
    stage.world().entity_mut(camera).insert(VdbQuality { accumulate: 64, ..default() });
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    stage.world().spawn((VdbVolume(grid), glow(GREEN), Unchanged {}));
    let before = stage.picture(&target);
    assert!(is_green(before.center()));
    stage.update(8);
    let red = "#import bevy_vdb::material::{VdbHit, VdbSurface}
        fn surface(hit: VdbHit, built_in: VdbSurface) -> VdbSurface {
            var changed = built_in;
            changed.emissive = vec3(1.0, 0.0, 0.0);
            return changed;
        }";
    let mut shaders = stage.world().resource_mut::<Assets<Shader>>();
    shaders.insert(UNCHANGED.id(), Shader::from_wgsl(red, "unchanged.wgsl")).unwrap();
    let (frames, _) = stage.frames_until_settled(&target);
    assert!(is_green(frames[0].center()), "the change came before it was waited for");
    let last = frames.last().unwrap().center();
    assert!(last.y == 0.0 && is_red(last), "{last} has green of the frames before");
}

/// A material whose shader is in a file.
#[derive(Clone, Component, Reflect)]
struct Watched {
    color: LinearRgba,
}

impl VdbMaterialExtension for Watched {
    fn shader() -> ShaderRef {
        "watched_material.wgsl".into()
    }
}

/// The body of the function, on line 4 of the file.
fn watched(body: &str) -> String {
    format!(
        "#import bevy_vdb::material::{{VdbHit, VdbSurface, Watched}}\n\nfn surface(hit: VdbHit, built_in: \
         VdbSurface, own: Watched) -> VdbSurface {{\n    {body}\n}}\n"
    )
}

/// Whatever is wrong with a shader is said once, with its file and line, and the picture stays; when the file is
/// mended, the picture is of the new function.
#[gpu_test]
#[ignore = "slow: each error compiles a function"]
fn errors_name_the_line_and_leave_the_picture() {
    listen();
    let name = "watched_material.wgsl";
    let folder = std::env::temp_dir().join(format!("bevy_vdb_material_{}", std::process::id()));
    fs::remove_dir_all(&folder).ok();
    fs::create_dir_all(&folder).unwrap();
    let path: PathBuf = folder.join(name);
    // It is broken from the beginning.
    fs::write(&path, watched("return built_in + nothing;")).unwrap();
    let mut stage = Stage::watching(&folder, |app| {
        app.add_plugins(VdbMaterialPlugin::<Watched>::default());
    });
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    let material = Watched { color: LinearRgba::rgb(1.0, 0.0, 0.0) };
    stage.world().spawn((VdbVolume(grid), glow(GREEN), material));
    let mut heard = 0;
    // What is said within longer than the watcher takes or, if something has to be, after that.
    let mut news = |stage: &mut Stage, is_due: bool| {
        let begin = Instant::now();
        let mut end = begin + Duration::from_secs(2);
        while Instant::now() < end {
            stage.update(1);
            std::thread::sleep(Duration::from_millis(5));
            let is_late = begin.elapsed() > Duration::from_secs(60);
            if is_due && said_of(name).len() == heard && !is_late {
                end = Instant::now() + Duration::from_secs(1);
            }
        }
        let all = said_of(name);
        let news = all[heard..].to_vec();
        heard = all.len();
        news
    };
    // The middle of the picture, once it holds or has had time enough.
    let until = |stage: &mut Stage, target: &Handle<Image>, holds: fn(Vec4) -> bool| {
        let end = Instant::now() + Duration::from_secs(60);
        loop {
            let picture = stage.picture(target);
            if holds(picture.center()) || Instant::now() > end {
                return picture;
            }
        }
    };
    let line = |said: &[String], line: u32| {
        assert_eq!(said.len(), 1, "{said:#?}");
        assert!(said[0].contains(&format!("{name}:{line}:")), "{said:#?}");
    };
    line(&news(&mut stage, true), 4);
    assert!(is_green(stage.picture(&target).center()), "a broken shader took the volume away");

    let sound =
        "var own_surface = built_in; own_surface.emissive = own.color.rgb; return own_surface;";
    fs::write(&path, watched(sound)).unwrap();
    let red = until(&mut stage, &target, is_red);
    assert_eq!(news(&mut stage, false), Vec::<String>::new());
    assert!(is_red(red.center()), "the function is not called: {}", red.center());

    for (broken, expected) in [
        (watched("return nothing;"), ":4:"),
        (watched("let a: u32 = 1.5; return built_in;"), ":4:"),
        (watched("return built_in").replace("}\n", ""), name),
        ("fn elsewhere() {}\n".to_owned(), "no function surface"),
        ("fn surface() -> f32 { return 1.0; }\n".to_owned(), "its functions are not surface"),
        (
            "@group(0) @binding(7) var<uniform> extra: vec4<f32>;\n".to_owned()
                + &watched("var s = built_in; s.emissive = extra.rgb; return s;"),
            "cannot have bindings of their own",
        ),
    ] {
        fs::write(&path, &broken).unwrap();
        let said = news(&mut stage, true);
        assert!(said.len() == 1 && said[0].contains(expected), "{broken}: {said:#?}");
        assert!(stage.picture(&target) == red, "{broken}: the picture is another");
    }
    fs::write(&path, watched(&sound.replace("own.color.rgb", "own.color.brg"))).unwrap();
    let green = until(&mut stage, &target, is_green).center();
    assert_eq!(news(&mut stage, false), Vec::<String>::new());
    assert!(is_green(green), "the mended function is not called: {green}");
    fs::remove_dir_all(folder).unwrap();
}
