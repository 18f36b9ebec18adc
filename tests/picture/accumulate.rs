//! Frames put together while nothing changes.

use std::sync::{Arc, Mutex};

use bevy::anti_alias::taa::TemporalAntiAliasing;
use bevy::light::DirectionalLightShadowMap;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy_vdb::{VdbDiagnostics, VdbGrid, VdbMaterial, VdbQuality, VdbSun, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::materials::{Painted, add_materials};
use super::{GREEN, glow, is_green, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
const SIZE: UVec2 = UVec2::new(48, 32);
/// Pixels of the reference for each of a picture's, along each axis.
const FINER: u32 = 8;

/// The picture of every frame of so many, and how many frames each says that it is the mean of.
fn film(
    stage: &mut Stage,
    target: &Handle<Image>,
    camera: Entity,
    count: usize,
) -> Vec<(u32, Picture)> {
    let size = stage.world().resource::<Assets<Image>>().get(target).unwrap().size();
    let all: Arc<Mutex<Vec<Picture>>> = Arc::default();
    let arrived = all.clone();
    let reader = stage
        .world()
        .spawn(Readback::texture(target.clone()))
        .observe(move |data: On<ReadbackComplete>| {
            let floats: Vec<f32> = bytemuck::pod_collect_to_vec(&data.data);
            let pixels = floats.chunks_exact(4).map(Vec4::from_slice).collect();
            arrived.lock().unwrap().push(Picture { size, pixels });
        })
        .id();
    let mut frames = Vec::new();
    for _ in 0..count {
        stage.update(1);
        frames.push(frames_of(stage, camera));
    }
    // Pictures come later than they are drawn.
    for _ in 0..200 {
        if all.lock().unwrap().len() >= count {
            break;
        }
        stage.update(1);
    }
    stage.world().despawn(reader);
    stage.update(1);
    let pictures = std::mem::take(&mut *all.lock().unwrap());
    assert!(pictures.len() >= count, "{} pictures of {count}", pictures.len());
    frames.into_iter().zip(pictures).collect()
}

fn frames_of(stage: &mut Stage, camera: Entity) -> u32 {
    let diagnostics = stage.world().resource::<VdbDiagnostics>().clone();
    diagnostics.camera(camera).map_or(0, |report| report.frames)
}

fn with(stage: &mut Stage, camera: Entity, target: &Handle<Image>, quality: VdbQuality) -> Picture {
    stage.world().entity_mut(camera).insert(quality);
    stage.picture(target)
}

/// Means of squares of pixels of a picture that is so many times as large.
pub(super) fn filtered(picture: &Picture, times: u32) -> Picture {
    let size = picture.size / times;
    let mean = |x: u32, y: u32| {
        let each = (0..times * times)
            .map(|i| picture.at(x * times + i % times, y * times + i / times))
            .sum::<Vec4>();
        each / (times * times) as f32
    };
    let pixels = (0..size.element_product()).map(|i| mean(i % size.x, i / size.x)).collect();
    Picture { size, pixels }
}

/// The root of the mean of the squares of what two pictures differ by.
pub(super) fn error(a: &Picture, b: &Picture) -> f64 {
    assert_eq!(a.size, b.size);
    let pairs = a.pixels.iter().zip(&b.pixels);
    let sum: f64 = pairs.map(|(a, b)| f64::from((*a - *b).truncate().length_squared()) / 3.0).sum();
    (sum / a.pixels.len() as f64).sqrt()
}

/// A lit torus and a ball of voxels, in a fog.
fn scene(stage: &mut Stage) {
    let torus = stage.grid(level_set::torus(DVec3::ZERO, 20.0, 7.0), SMOOTH, 0.1);
    let tilted = Transform::from_rotation(Quat::from_rotation_x(1.0));
    let matt = VdbMaterial { reflectance: 0.0, ..default() };
    stage.world().spawn((VdbVolume(torus), matt, tilted));
    stage.green_sphere(Transform::from_xyz(0.3, 0.2, 0.0).with_scale(Vec3::splat(0.5)));
    let cloud = stage.grid(fog::sphere(DVec3::ZERO, 15.0, 6.0), PackKind::Fog, 0.1);
    let blue = VdbMaterial { density_scale: 0.7, ..glow(LinearRgba::BLUE) };
    stage.world().spawn((VdbVolume(cloud), blue, Transform::from_xyz(-2.0, 1.0, 0.5)));
    let sun = DirectionalLight { illuminance: 3.0, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(1.0, 3.0, 2.0))));
}

const VIEW: Vec3 = Vec3::new(1.0, 2.0, 6.5);

/// Error of a picture without accumulation, and of means of 1, 4, 16 … frames, against a picture of 64 times as
/// many rays.
struct Errors {
    alone: f64,
    means: Vec<f64>,
}

/// For each resolution. The greatest mean is that of `4^powers` frames.
fn errors(resolutions: &[f32], powers: u32) -> Vec<Errors> {
    let mut stage = Stage::new();
    let fine = stage.target(SIZE * FINER);
    let camera = stage.camera(&fine, looking(VIEW));
    scene(&mut stage);
    let expected = filtered(&stage.picture(&fine), FINER);
    expected.save("accumulate_expected");
    let target = stage.target(SIZE);
    let to = bevy::camera::RenderTarget::Image(target.clone().into());
    stage.world().entity_mut(camera).insert(to);

    let most = 4_u32.pow(powers);
    let mut all = Vec::new();
    for &resolution in resolutions {
        let off = VdbQuality { resolution, ..default() };
        let single = with(&mut stage, camera, &target, off);
        let on = VdbQuality { accumulate: most, ..off };
        stage.world().entity_mut(camera).insert(on);
        stage.picture(&target);
        // Starts anew.
        stage.world().entity_mut(camera).insert(VdbQuality { accumulate: most + 1, ..on });
        let film = film(&mut stage, &target, camera, most as usize + 2);
        let numbers: Vec<u32> = film.iter().map(|(frames, _)| *frames).collect();
        assert_eq!(numbers, (0..most + 2).collect::<Vec<_>>());
        assert!(film[0].1 == single, "{resolution}: the first frame is not what it is without");
        let means = (0..=powers).map(|power| {
            let frames = 4_usize.pow(power);
            let picture = &film[frames].1;
            picture.save(&format!("accumulate_{resolution}_{frames}"));
            error(picture, &expected)
        });
        let own = Errors { alone: error(&single, &expected), means: means.collect() };
        println!("{resolution}: alone {:.5}, means {:.5?}", own.alone, own.means);
        all.push(own);
    }
    all
}

/// The error of the mean is below that of as many rays at random positions in each pixel.
fn check_full(full: &Errors) {
    assert!(full.alone > 0.02, "there is nothing to even out: {}", full.alone);
    assert!(full.means[0] == full.alone, "the first of a mean is through the middles");
    // The part of a pixel before an edge anywhere in it is off by √(1 / 12) in the mean by a ray
    // through the middle, and by √(1 / 6n) by n rays through places by chance.
    for (n, error) in [4.0_f64, 16.0, 64.0].into_iter().zip(&full.means[1..]) {
        assert!(*error < full.alone * (2.0 / n).sqrt(), "{n}: {error} of {}", full.alone);
    }
}

#[gpu_test]
fn the_mean_of_frames_becomes_the_picture_of_many_rays() {
    check_full(&errors(&[1.0], 2)[0]);
}

/// A ray for four pixels, too, gets where all rays get.
#[gpu_test]
#[ignore = "slow: means of many frames"]
fn means_of_fewer_rays_become_the_same_picture() {
    let all = errors(&[1.0, 0.5, 0.7], 3);
    let [full, half, part] = all.as_array().unwrap();
    check_full(full);
    // A quarter of the rays: as good as a quarter of the frames.
    let (full, half, part) = (&full.means, &half.means, &part.means);
    assert!(half[3] < full[2] && half[2] < full[1], "{half:?} {full:?}");
    assert!(part[3] < full[2], "{part:?} {full:?}");
}

/// Whatever changes in what is seen, the first frame after it is the one that there is without
/// accumulation.
#[gpu_test]
#[ignore = "slow: many changes, each with its frames"]
fn whatever_changes_it_starts_anew() {
    let mut stage = Stage::with(add_materials);
    stage.world().insert_resource(DirectionalLightShadowMap { size: 64 });
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(VIEW));
    scene(&mut stage);
    let cube = stage.red_cube(0.8, Transform::from_xyz(9.0, 9.0, 0.0));
    let sun = DirectionalLight { illuminance: 2.0, shadow_maps_enabled: true, ..default() };
    let sun = stage.world().spawn((sun, looking(Vec3::new(-1.0, 4.0, 1.0)))).id();
    let find = |stage: &mut Stage| {
        let mut all = stage.world().query_filtered::<Entity, With<VdbVolume>>();
        all.iter(stage.world()).next().unwrap()
    };
    let volume = find(&mut stage);
    // Another cloud in the same box.
    let mut all = stage.world().query::<(&VdbVolume, &VdbMaterial)>();
    let cloud = all.iter(stage.world()).find(|(_, material)| material.density_scale == 0.7);
    let cloud = cloud.unwrap().0.0.id();
    let other = stage.grid(fog::sphere(DVec3::ZERO, 15.0, 2.0), PackKind::Fog, 0.1);
    let other = stage.world().resource_mut::<Assets<VdbGrid>>().remove(&other).unwrap();
    let on = VdbQuality { accumulate: 32, ..default() };
    with(&mut stage, camera, &target, on);
    stage.update(4);
    type Change<'a> = (&'a str, &'a dyn Fn(&mut World));
    let changes: [Change; 14] = [
        ("what is in a grid", &|world| {
            let mut grids = world.resource_mut::<Assets<VdbGrid>>();
            *grids.get_mut(cloud).unwrap() = other.clone();
        }),
        ("the camera", &|world| {
            world.get_mut::<Transform>(camera).unwrap().translation.x += 0.01;
        }),
        ("the camera's lens", &|world| {
            let lens = PerspectiveProjection { fov: 0.8, ..default() };
            world.entity_mut(camera).insert(Projection::Perspective(lens));
        }),
        ("a volume's place", &|world| {
            world.get_mut::<Transform>(volume).unwrap().translation.y += 0.01;
        }),
        ("a material", &|world| {
            world.get_mut::<VdbMaterial>(volume).unwrap().metallic = 0.5;
        }),
        ("a custom material", &|world| {
            world.entity_mut(volume).insert(Painted::default());
        }),
        ("a parameter of a custom material", &|world| {
            world.get_mut::<Painted>(volume).unwrap().reflectance = 0.7;
        }),
        ("a light", &|world| {
            world.get_mut::<DirectionalLight>(sun).unwrap().illuminance = 2.5;
        }),
        ("a light's place", &|world| {
            world.entity_mut(sun).insert(looking(Vec3::new(-1.0, 4.0, 2.0)));
        }),
        ("a light probe", &|world| {
            world.spawn(LightProbe::default());
        }),
        ("the ambient light", &|world| {
            world.resource_mut::<GlobalAmbientLight>().brightness = 3.0;
        }),
        ("what throws a shadow", &|world| {
            world.entity_mut(cube).insert(Transform::from_xyz(-0.5, 3.0, 0.5));
        }),
        ("a light that goes", &|world| {
            world.despawn(sun);
        }),
        ("a volume that goes", &|world| {
            world.despawn(volume);
        }),
    ];
    for (what, change) in changes {
        assert!(frames_of(&mut stage, camera) > 4, "before {what}");
        change(stage.world());
        let film = film(&mut stage, &target, camera, 6);
        // Bevy tells the renderer of some things a frame late.
        let first = film.iter().position(|(frames, _)| *frames == 0);
        let first = first.unwrap_or_else(|| panic!("{what}: {:?}", frames_of(&mut stage, camera)));
        assert!(first <= 1, "{what}: after {first} frames");
        let last = film.iter().rposition(|(frames, _)| *frames == 0).unwrap();
        let alone = with(&mut stage, camera, &target, VdbQuality::default());
        assert!(film[last].1 == alone, "{what}: off by {}", error(&film[last].1, &alone));
        with(&mut stage, camera, &target, on);
        stage.update(4);
    }
}

#[gpu_test]
fn rectangle_lights_that_change_or_go_start_it_anew() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(VIEW));
    stage.green_sphere(Transform::default());
    let panes = [-2.0, 2.0].map(|x| {
        let pane = RectLight { intensity: 300.0, ..default() };
        stage.world().spawn((pane, looking(Vec3::new(x, 3.0, 2.0)))).id()
    });
    with(&mut stage, camera, &target, VdbQuality { accumulate: 32, ..default() });
    let changes: [&dyn Fn(&mut World); 2] =
        [&|world| world.get_mut::<RectLight>(panes[0]).unwrap().width = 2.0, &|world| {
            assert!(world.despawn(panes[1]))
        }];
    for (i, change) in changes.into_iter().enumerate() {
        stage.update(8);
        let before = frames_of(&mut stage, camera);
        assert!(before >= 8, "{before} frames before change {i}");
        change(stage.world());
        // Bevy tells the renderer of some things a frame late.
        stage.update(3);
        let after = frames_of(&mut stage, camera);
        assert!(after <= 3, "{after} frames after change {i}, {before} before it");
    }
}

/// A mesh that goes by leaves nothing behind in the pixels that it has hidden, and hides what it comes
/// to hide at once, though nothing else starts anew.
#[gpu_test]
#[ignore = "slow: three cameras, each with its frames"]
fn a_mesh_that_goes_by_leaves_no_trace() {
    for (msaa, resolution) in [(Msaa::Off, 1.0), (Msaa::Sample4, 1.0), (Msaa::Off, 0.5)] {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
        stage.world().entity_mut(camera).insert(msaa);
        stage.green_sphere(Transform::default());
        let before = Transform::from_xyz(-0.8, 0.0, 3.0);
        let cube = stage.red_cube(0.8, before);
        let on = VdbQuality { accumulate: 64, resolution, ..default() };
        with(&mut stage, camera, &target, on);
        stage.update(20);
        let frames = frames_of(&mut stage, camera);
        assert!(frames > 20);
        stage.world().entity_mut(cube).insert(Transform::from_xyz(0.8, 0.0, 3.0));
        let film = film(&mut stage, &target, camera, 12);
        let (own, first) = &film[0];
        assert!(*own > frames, "{msaa:?}: all has started anew");
        let fresh = with(&mut stage, camera, &target, VdbQuality { accumulate: 0, ..on });
        first.save(&format!("accumulate_mesh_{msaa:?}_{resolution}"));
        // Inside of the ball, and off the edges of the cube, all is as it is alone.
        let mut wrong = 0;
        for (x, y) in (4..SIZE.x - 4).flat_map(|x| (4..SIZE.y - 4).map(move |y| (x, y))) {
            let even = (-2..=2).all(|i: i32| {
                let at =
                    |dx: i32, dy: i32| fresh.at((x as i32 + dx) as u32, (y as i32 + dy) as u32);
                (-2..=2).all(|j| at(i, j) == fresh.at(x, y))
            });
            wrong += usize::from(even && first.at(x, y) != fresh.at(x, y));
        }
        assert!(fresh.count(is_green) > 100, "{msaa:?}: the ball is there");
        assert_eq!(wrong, 0, "{msaa:?} {resolution}: pixels are not what they are alone");
        // And the last frame is as one that has never seen the cube elsewhere.
        let last = &film[11].1;
        assert!(error(last, &fresh) < error(first, &fresh).max(0.08), "{msaa:?}");
    }
}

/// Few rays to a sun with a size, and rough mirrors: grain in a frame, none in the mean of many.
#[gpu_test]
#[ignore = "slow: means of hundreds of frames"]
fn grain_is_evened_out() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.world().insert_resource(DirectionalLightShadowMap { size: 64 });
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 5.0, 4.0)));
    let floor = CoordBox { min: IVec3::new(-40, -2, -40), max: IVec3::new(39, -1, 39) };
    let floor = stage.grid(fog::block(floor, -1.0), super::SURFACE, 0.1);
    let floor = stage.world().spawn((VdbVolume(floor), VdbMaterial::default())).id();
    let ball = stage.grid(level_set::sphere(DVec3::ZERO, 10.0), SMOOTH, 0.1);
    let up = Transform::from_xyz(0.0, 1.5, 0.0);
    stage.world().spawn((VdbVolume(ball), glow(GREEN), up));
    let light = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    let sun = |samples| VdbSun { angular_diameter: 0.5, samples, ..default() };
    let sun_at = stage.world().spawn((light, sun(1), looking(Vec3::new(0.3, 1.0, 0.2)))).id();
    let white = VdbMaterial { reflectance: 0.0, ..default() };
    let rough = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.35, ..default() };
    for (what, material, reflections) in [("shadow", white, 0), ("mirror", rough, 1)] {
        stage.world().entity_mut(floor).insert(material);
        let on = VdbQuality { accumulate: 256, reflections, denoise: false, ..default() };
        let mut mean_of = |samples: u32, frames: usize| {
            stage.world().entity_mut(sun_at).insert(sun(samples));
            with(&mut stage, camera, &target, VdbQuality { accumulate: 0, ..on });
            stage.world().entity_mut(camera).insert(on);
            film(&mut stage, &target, camera, frames + 1).remove(frames)
        };
        let (_, expected) = mean_of(16, 127);
        expected.save(&format!("accumulate_{what}"));
        // Both are means of as many frames, so that edges are alike.
        let errors = [4, 16, 64].map(|frames| {
            let (own, picture) = mean_of(1, frames);
            assert_eq!(own as usize, frames);
            picture.save(&format!("accumulate_{what}_{frames}"));
            error(&picture, &expected)
        });
        println!("{what}: {errors:.5?}");
        if reflections == 0 {
            // Where no shadow falls, all of the floor is as bright, in each frame: a ray that misses it
            // is dark.
            let rows =
                [4, 12, 20, 28].map(|row| (row..row + 4).map(|y| expected.at(SIZE.x - 8, y)));
            let floor = rows.into_iter().flatten().filter(|pixel| pixel.x > 0.0);
            let [least, most] = floor.fold([f32::MAX, 0.0_f32], |[least, most], pixel| {
                [least.min(pixel.x), most.max(pixel.x)]
            });
            // The term by which Burley looks at the direction of the viewer makes less of a difference.
            assert!(most - least < 1e-2 * most, "from {least} to {most}");
        }
        assert!(errors[0] > 1e-3, "{what}: there is no grain: {errors:?}");
        assert!(errors[1] * 2.0 < errors[0] && errors[2] * 2.0 < errors[1], "{what}: {errors:?}");
    }
}

/// There is nothing of it while it is off, while everything moves, or where TAA does it.
#[gpu_test]
#[ignore = "slow: five sets of pipelines"]
fn it_is_there_only_where_frames_are_put_together() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(VIEW));
    scene(&mut stage);
    let report = |stage: &mut Stage| {
        stage.picture(&target);
        let report = stage.world().resource::<VdbDiagnostics>().camera(camera).unwrap();
        let bytes = |name: &str| {
            report
                .buffers
                .iter()
                .filter(|buffer| buffer.name == name)
                .map(|buffer| buffer.bytes)
                .sum()
        };
        let all: [u64; 3] = ["vdb_means", "vdb_color_mean", "vdb_depth_mean"].map(bytes);
        let runs = report.passes.iter().any(|pass| pass.name == "vdb_accumulate");
        (report.has("accumulation"), runs, all, report.frames)
    };
    let pixels = u64::from(SIZE.element_product());
    for accumulate in [0, 1] {
        let off = VdbQuality { accumulate, ..default() };
        stage.world().entity_mut(camera).insert(off);
        assert_eq!(report(&mut stage), (false, false, [0; 3], 0), "{accumulate}");
    }
    let on = VdbQuality { accumulate: 16, ..default() };
    stage.world().entity_mut(camera).insert(on);
    // The frames of one picture are too few for a mean of several.
    stage.update(1);
    let (has, runs, bytes, frames) = report(&mut stage);
    assert!(has && runs && frames > 1);
    assert_eq!(bytes, [32 * pixels, 8 * pixels, 4 * pixels]);
    stage.world().entity_mut(camera).insert(TemporalAntiAliasing::default());
    assert_eq!(report(&mut stage), (false, false, [0; 3], 0), "TAA does it");
    stage.world().entity_mut(camera).remove::<TemporalAntiAliasing>();
    stage.world().entity_mut(camera).remove::<bevy::render::camera::TemporalJitter>();
    assert!(report(&mut stage).0, "it is back");
    stage.world().entity_mut(camera).insert(VdbQuality::default());
    assert_eq!(report(&mut stage), (false, false, [0; 3], 0), "it is freed");
}
