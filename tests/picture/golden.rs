//! Pictures as they were when someone last looked at them and found them good: `tests/golden/`.
//!
//! A test that fails leaves the new picture and one of the differences in `target/tmp/golden/` and says
//! where. Where the new one is as it should be, `BEVY_VDB_ACCEPT=1` puts it in place of the old.

use std::path::{Path, PathBuf};

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::fog;
use vdb_core::synth::level_set::{cuboid, sphere, torus};

use super::common::{Picture, Stage};
use super::flip::{flip, mean};
use super::{SURFACE, looking};

const SIZE: UVec2 = UVec2::new(128, 96);
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

/// Of the mean over the picture, both of eight bits a colour. Another adapter rounds the edge of a
/// shadow or of a surface into the pixel beside. What is let pass so, and what is not, each test says.
const TOLERANCE: f64 = 0.008;

/// A colour of the camera in eight bits, as PNG files have it.
fn bytes(pixel: &Vec4) -> [u8; 3] {
    let color = Srgba::from(LinearRgba::from_vec4(*pixel)).to_f32_array_no_alpha();
    color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8)
}

fn linear([red, green, blue]: [u8; 3]) -> Vec4 {
    Color::srgb_u8(red, green, blue).to_linear().to_vec4()
}

fn write(path: &Path, size: UVec2, colors: impl Iterator<Item = [u8; 3]>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    let mut encoder = png::Encoder::new(file, size.x, size.y);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    let colors: Vec<u8> = colors.flatten().collect();
    encoder.write_header().unwrap().write_image_data(&colors).unwrap();
}

fn read(path: &Path) -> Option<Picture> {
    let file = std::io::BufReader::new(std::fs::File::open(path).ok()?);
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    let pixels = bytes.chunks_exact(3).map(|c| linear([c[0], c[1], c[2]]));
    Some(Picture { size: UVec2::new(info.width, info.height), pixels: pixels.collect() })
}

/// Where the picture of a name is kept.
fn kept(name: &str) -> PathBuf {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "tests", "golden", name].iter().collect();
    path.with_extension("png")
}

/// How different each pixel looks from the picture that was accepted, if there is one of this size.
fn errors(name: &str, picture: &Picture) -> Option<Vec<f64>> {
    let pixels = picture.pixels.iter().map(|pixel| linear(bytes(pixel))).collect();
    let shown = Picture { size: picture.size, pixels };
    read(&kept(name)).filter(|kept| kept.size == shown.size).map(|kept| flip(&kept, &shown))
}

/// Asserts that a picture looks like the one that was accepted.
fn compare(name: &str, picture: &Picture) {
    let kept = kept(name);
    if std::env::var_os("BEVY_VDB_ACCEPT").is_some_and(|accept| accept == "1") {
        write(&kept, picture.size, picture.pixels.iter().map(bytes));
        println!("accepted: {}", kept.display());
        return;
    }
    let errors = errors(name, picture);
    let error = errors.as_deref().map(mean);
    println!("{name}: FLIP {error:?}");
    if error.is_some_and(|error| error < TOLERANCE) {
        return;
    }
    let folder: PathBuf = [env!("CARGO_TARGET_TMPDIR"), "golden"].iter().collect();
    let new = folder.join(name).with_extension("png");
    write(&new, picture.size, picture.pixels.iter().map(bytes));
    let difference = folder.join(format!("{name}_difference.png"));
    if let Some(errors) = errors {
        // Black, red, yellow, white.
        let heat = |error: &f64| {
            [0.0, 1.0, 2.0].map(|from| ((3.0 * error - from).clamp(0.0, 1.0) * 255.0) as u8)
        };
        write(&difference, picture.size, errors.iter().map(heat));
    }
    panic!(
        "{name} looks different: FLIP {error:?}, of at most {TOLERANCE}; was {}, is {}, differs as {}; \
         with BEVY_VDB_ACCEPT=1 it is taken as it should be",
        kept.display(),
        new.display(),
        difference.display(),
    );
}

/// A scene: what is shown, after something was changed in it.
type Scene = fn(&mut Stage, &dyn Fn(&mut World)) -> Picture;

/// Asserts that a scene looks as it should; that what another adapter rounds otherwise is let pass; and
/// that what is wrong is not.
fn judge(name: &str, scene: Scene, wrong: &[(&str, &dyn Fn(&mut World))]) {
    let mut stage = Stage::new();
    compare(name, &scene(&mut stage, &|_| ()));
    let mut error = |change: &dyn Fn(&mut World)| {
        stage.clear();
        mean(&errors(name, &scene(&mut stage, change)).expect("it has been compared"))
    };
    // A hundredth of a pixel to the side, and a thousandth brighter.
    let rounded = error(&|world| {
        let mut cameras = world.query_filtered::<&mut Transform, With<Camera3d>>();
        cameras.single_mut(world).unwrap().rotate_y(0.01 * 45_f32.to_radians() / SIZE.y as f32);
        let mut suns = world.query::<&mut DirectionalLight>();
        suns.single_mut(world).unwrap().illuminance *= 1.001;
    });
    println!("{name}: rounded otherwise {rounded}");
    assert!(rounded < TOLERANCE, "{name}: rounded otherwise, {rounded}");
    for (what, change) in wrong {
        let error = error(*change);
        println!("{name}: {what} {error}");
        assert!(error > TOLERANCE, "{name}: {what} is not seen: {error}");
    }
}

/// Takes a scene away.
fn without_shadows(world: &mut World) {
    let mut cameras = world.query::<&mut VdbQuality>();
    cameras.single_mut(world).unwrap().shadows = false;
}

/// Changes the materials of all volumes.
fn material(world: &mut World, change: impl Fn(&mut VdbMaterial)) {
    let mut materials = world.query::<&mut VdbMaterial>();
    materials.iter_mut(world).for_each(|mut material| change(&mut material));
}

fn sun(to_sun: Vec3) -> impl Bundle {
    let illuminance = 2.5;
    (DirectionalLight { illuminance, shadow_maps_enabled: true, ..default() }, looking(to_sun))
}

/// A floor of voxels.
fn floor(stage: &mut Stage, top: f32, color: Color) {
    let tree = cuboid(DVec3::new(-50.0, -4.0, -50.0), DVec3::new(50.0, 0.0, 50.0));
    let grid = stage.grid(tree, SURFACE, 0.1);
    let material = VdbMaterial { base_color: color, reflectance: 0.2, ..default() };
    let at = Transform::from_xyz(0.0, top, 0.0);
    stage.world().spawn((VdbVolume(grid), material, at));
}

fn level_set(stage: &mut Stage, change: &dyn Fn(&mut World)) -> Picture {
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::new(2.0, 4.5, 6.0)));
    let grid = stage.grid(torus(DVec3::ZERO, 14.0, 5.0), SMOOTH, 0.1);
    let material = VdbMaterial {
        base_color: Color::linear_rgb(0.8, 0.35, 0.1),
        perceptual_roughness: 0.4,
        ..default()
    };
    let turned = Transform::from_rotation(Quat::from_rotation_x(1.0));
    stage.world().spawn((VdbVolume(grid), material, turned.with_translation(Vec3::Y * 0.6)));
    floor(stage, -1.2, Color::linear_rgb(0.4, 0.5, 0.4));
    stage.world().spawn(sun(Vec3::new(0.8, 1.0, 0.3)));
    let ambient = GlobalAmbientLight { brightness: 0.15, ..default() };
    stage.world().insert_resource(ambient);
    change(stage.world());
    stage.picture(&target)
}

fn cloud(stage: &mut Stage, change: &dyn Fn(&mut World)) -> Picture {
    let target = stage.target(SIZE);
    let sky = Color::linear_rgb(0.1, 0.2, 0.45);
    stage.world().insert_resource(ClearColor(sky));
    let camera = stage.camera(&target, looking(Vec3::new(0.0, -0.5, 5.0)));
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    let grid = stage.grid(fog::cloud(20.0, 7), PackKind::Fog, 0.1);
    let material = VdbMaterial {
        base_color: Color::linear_rgb(0.999, 0.999, 0.999),
        density_scale: 12.0,
        anisotropy: 0.5,
        ..default()
    };
    stage.world().spawn((VdbVolume(grid), material));
    stage
        .world()
        .spawn((sun(Vec3::new(1.0, 0.8, -0.3)), bevy_vdb::VdbSun { intensity: 2.0, ..default() }));
    let color = Color::linear_rgb(0.3, 0.5, 1.0);
    stage.world().insert_resource(GlobalAmbientLight { brightness: 0.3, color, ..default() });
    change(stage.world());
    stage.picture(&target)
}

fn mirror(stage: &mut Stage, change: &dyn Fn(&mut World)) -> Picture {
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(-1.0, 2.5, 6.0)));
    stage.world().entity_mut(camera).insert(VdbQuality { reflections: 1, ..default() });
    let ball = stage.grid(sphere(DVec3::ZERO, 14.0), SMOOTH, 0.1);
    let mirror = VdbMaterial {
        base_color: Color::linear_rgb(0.9, 0.85, 0.7),
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    };
    stage.world().spawn((VdbVolume(ball), mirror, Transform::from_xyz(-0.6, 0.2, 0.0)));
    let ring = stage.grid(torus(DVec3::ZERO, 8.0, 3.0), SMOOTH, 0.1);
    let red = VdbMaterial { base_color: Color::linear_rgb(0.8, 0.1, 0.1), ..default() };
    stage.world().spawn((VdbVolume(ring), red, Transform::from_xyz(1.2, -0.5, 1.2)));
    floor(stage, -1.2, Color::linear_rgb(0.2, 0.4, 0.7));
    stage.world().spawn(sun(Vec3::new(0.5, 1.0, 0.6)));
    stage.world().insert_resource(GlobalAmbientLight { brightness: 0.3, ..default() });
    change(stage.world());
    stage.picture(&target)
}

#[gpu_test]
fn a_level_set_in_the_sun() {
    judge(
        "level_set",
        level_set,
        &[
            ("no shadow", &without_shadows),
            ("gloss", &|world| material(world, |material| material.perceptual_roughness = 0.6)),
            // Of three degrees, seen in the same place.
            ("normals", &|world| {
                let mut suns = world.query_filtered::<&mut Transform, With<DirectionalLight>>();
                suns.single_mut(world).unwrap().rotate_x(3_f32.to_radians());
            }),
        ],
    );
}

#[gpu_test]
fn a_cloud_in_the_sun() {
    judge(
        "cloud",
        cloud,
        &[
            ("no shadow", &without_shadows),
            ("phase", &|world| material(world, |material| material.anisotropy = 0.4)),
            ("scattered once", &|world| {
                let mut cameras = world.query::<&mut VdbCamera>();
                cameras.single_mut(world).unwrap().multiple_scattering = false;
            }),
        ],
    );
}

#[gpu_test]
fn a_ball_that_mirrors() {
    judge(
        "mirror",
        mirror,
        &[
            ("no reflection", &|world| {
                let mut cameras = world.query::<&mut VdbQuality>();
                cameras.single_mut(world).unwrap().reflections = 0;
            }),
            ("not of metal", &|world| material(world, |material| material.metallic = 0.0)),
        ],
    );
}
