//! The denoising of reflections in rough surfaces.

use bevy::anti_alias::taa::TemporalAntiAliasing;
use bevy::camera::RenderTarget;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::camera::TemporalJitter;
use bevy_vdb::{VdbGrid, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::flip::{flip, mean};
use super::{GREEN, SURFACE, glow, looking, parallel};

#[path = "../../examples/glossy.rs"]
#[allow(dead_code, reason = "it is a program of its own")]
mod glossy;

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
const SIZE: UVec2 = UVec2::new(128, 96);
/// Where the ball that mirrors is in the picture, in pixels.
const BALL: Vec2 = Vec2::new(66.4, 39.2);
const BALL_RADIUS: f32 = 23.2;
const RED: LinearRgba = LinearRgba::rgb(1.0, 0.1, 0.05);

/// A metal floor and a metal ball of these roughnesses, which reflect a ball and a post that shine.
fn scene(stage: &mut Stage, floor: f32, ball: f32) -> (Handle<Image>, Entity) {
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.5, 3.0, 7.0)));
    let metal = |perceptual_roughness| VdbMaterial {
        base_color: Color::linear_rgb(0.9, 0.7, 0.4),
        metallic: 1.0,
        perceptual_roughness,
        ..default()
    };
    let plate = CoordBox { min: IVec3::new(-40, -2, -40), max: IVec3::new(39, -1, 39) };
    let plate = stage.grid(fog::block(plate, -1.0), SURFACE, 0.1);
    stage.world().spawn((VdbVolume(plate), metal(floor)));
    let ball_grid = stage.grid(level_set::sphere(DVec3::ZERO, 10.0), SMOOTH, 0.1);
    let shines = (VdbVolume(ball_grid.clone()), glow(GREEN), Transform::from_xyz(-1.5, 1.0, 0.0));
    stage.world().spawn(shines);
    let post = CoordBox { min: IVec3::new(8, 0, -4), max: IVec3::new(13, 24, 1) };
    let post = stage.grid(fog::block(post, -1.0), SURFACE, 0.1);
    stage.world().spawn((VdbVolume(post), glow(RED)));
    let mirrors = (VdbVolume(ball_grid), metal(ball), Transform::from_xyz(0.3, 1.2, 1.8));
    stage.world().spawn(mirrors);
    (target, camera)
}

/// What a camera shows: after a few frames, or as the mean of many.
fn shown(
    stage: &mut Stage,
    (target, camera): &(Handle<Image>, Entity),
    quality: VdbQuality,
) -> Picture {
    stage.world().entity_mut(*camera).insert(quality);
    stage.picture(target);
    stage.update(quality.accumulate as usize);
    stage.picture(target)
}

/// For each pixel, whether neither it nor a neighbour shines: near what shines, differences are those of
/// anti-aliasing.
fn dark(without_reflections: &Picture) -> Vec<bool> {
    let shines = |x: u32, y: u32| without_reflections.at(x, y).truncate().max_element() > 0.5;
    let pixels = (0..SIZE.y).flat_map(|y| (0..SIZE.x).map(move |x| (x, y)));
    let near = |at: u32, size: u32| at.saturating_sub(1)..(at + 2).min(size);
    pixels.map(|(x, y)| !near(y, SIZE.y).any(|y| near(x, SIZE.x).any(|x| shines(x, y)))).collect()
}

/// The root of the mean of the squares of differences.
fn error(a: &Picture, b: &Picture, counts: &[bool]) -> f32 {
    let pairs = a.pixels.iter().zip(&b.pixels).zip(counts).filter(|(_, counts)| **counts);
    let all: Vec<f32> = pairs.map(|((a, b), _)| (*a - *b).truncate().length_squared()).collect();
    (all.iter().sum::<f32>() / all.len() as f32).sqrt()
}

fn check_grain(roughnesses: &[f32], accumulate: u32, reflections: u32) {
    let mut stage = Stage::new();
    for &roughness in roughnesses {
        stage.clear();
        let view = scene(&mut stage, roughness, roughness);
        let on = VdbQuality { reflections, ..default() };
        let off = VdbQuality { denoise: false, ..on };
        let expected = shown(&mut stage, &view, VdbQuality { accumulate, ..off });
        let counts = dark(&shown(&mut stage, &view, VdbQuality { reflections: 0, ..off }));
        let [single, own] = [off, on].map(|quality| shown(&mut stage, &view, quality));
        for (name, picture) in [("mean", &expected), ("off", &single), ("on", &own)] {
            picture.save(&format!("denoise_{roughness}_{name}"));
        }
        let [before, after] = [&single, &own].map(|picture| error(picture, &expected, &counts));
        println!("{roughness}: {before:.4} off, denoised {after:.4}");
        assert!(before > 0.02, "{roughness}: there is no grain: {before}");
        assert!(after < 0.5 * before, "{roughness}: {after} instead of {before}");
    }
}

/// After a few frames, denoised reflections are closer to the mean of many than a single frame is.
#[gpu_test]
#[ignore = "slow: means of many frames"]
fn reflections_are_smoother() {
    check_grain(&[0.35], 64, 1);
}

#[gpu_test]
#[ignore = "slow: means of many frames"]
fn reflections_are_smoother_whatever_the_roughness() {
    check_grain(&[0.2, 0.6], 64, 2);
}

/// While the camera moves by half a pixel, frames change little more than means of many do.
#[gpu_test]
#[ignore = "slow: means of many frames"]
fn denoised_reflections_do_not_flicker() {
    let mut stage = Stage::new();
    for roughness in [0.2, 0.5] {
        stage.clear();
        let view = scene(&mut stage, roughness, roughness);
        let eye = |x: f32| looking(Vec3::new(0.5 + x, 3.0, 7.0));
        let means = [0.05, 0.025].map(|x| {
            stage.world().entity_mut(view.1).insert(eye(x));
            shown(&mut stage, &view, MANY)
        });
        shown(&mut stage, &view, ON);
        stage.update(20);
        let frames = [0.05, 0.025].map(|x| {
            stage.world().entity_mut(view.1).insert(eye(x));
            stage.next_picture(&view.0)
        });
        let [frames, means] = [frames, means].map(|[a, b]| mean(&flip(&a, &b)));
        println!("{roughness}: FLIP between frames {frames:.4}, of means {means:.4}");
        assert!(frames < 1.5 * means, "{roughness}: {frames} instead of {means}");
    }
}

const ON: VdbQuality = VdbQuality { reflections: 2, ..VdbQuality::HIGH };
const MANY: VdbQuality = VdbQuality { denoise: false, accumulate: 64, ..ON };

/// The first frame with some settings, when their pipelines are there.
fn first_frame(
    stage: &mut Stage,
    (target, camera): &(Handle<Image>, Entity),
    quality: VdbQuality,
) -> Picture {
    for quality in [quality, VdbQuality { denoise: false, ..quality }] {
        stage.world().entity_mut(*camera).insert(quality);
        stage.picture(target);
    }
    stage.world().entity_mut(*camera).insert(quality);
    stage.next_picture(target)
}

/// Fails unless, while nothing changes, reflections approach the mean of many frames and then hardly change any more,
/// and a camera that moves sees what one that has just arrived sees, with less grain. `projection` may replace the
/// camera's.
fn check_history(name: &str, projection: impl Bundle) {
    let mut stage = Stage::new();
    let view = scene(&mut stage, 0.2, 0.2);
    stage.world().entity_mut(view.1).insert(projection);
    let counts = dark(&shown(&mut stage, &view, VdbQuality { reflections: 0, ..ON }));
    let expected = shown(&mut stage, &view, VdbQuality { accumulate: 128, ..MANY });
    let first = first_frame(&mut stage, &view, ON);
    stage.update(40);
    let last = [(); 2].map(|()| stage.next_picture(&view.0));
    first.save(&format!("history_{name}_first"));
    last[0].save(&format!("history_{name}_last"));
    let [first, later] = [&first, &last[0]].map(|picture| error(picture, &expected, &counts));
    let flicker = error(&last[0], &last[1], &counts);
    println!("{name}: {first:.4}, later {later:.4}; from frame to frame {flicker:.4}");
    assert!(later < 0.4 * first, "{later} instead of {first}");
    assert!(flicker < 0.1 * first, "{flicker} from frame to frame");
    for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
        let mut moving = None;
        for step in (0..24_i16).rev() {
            let eye = Vec3::new(0.5, 3.0, 7.0) - 0.04 * f32::from(step) * axis;
            stage.world().entity_mut(view.1).insert(looking(eye));
            moving = Some(stage.next_picture(&view.0));
        }
        let moving = moving.expect("a picture of every step");
        moving.save(&format!("history_{name}_moving_{axis}"));
        let moving = error(&moving, &expected, &counts);
        println!("{name}, moving along {axis}: {moving:.4}");
        assert!(moving < 0.8 * first, "{axis}: {moving} instead of {first}");
    }
}

#[gpu_test]
#[ignore = "slow: the mean of many frames"]
fn reflections_approach_their_mean_and_follow_a_camera() {
    check_history("lens", ());
}

#[gpu_test]
#[ignore = "slow: the mean of many frames"]
fn reflections_of_parallel_rays_approach_their_mean() {
    check_history("parallel", parallel(6.3));
}

/// What is reflected may change its colour, move, vanish, or show another grid: a few frames later, its reflection has
/// changed as well.
#[gpu_test]
#[ignore = "slow: means of many frames"]
fn a_changed_scene_is_soon_reflected() {
    let mut stage = Stage::new();
    for change in ["colour", "place", "presence", "grid"] {
        stage.clear();
        let other = stage.grid(level_set::sphere(DVec3::ZERO, 4.0), SMOOTH, 0.1);
        let view = scene(&mut stage, 0.35, 0.35);
        shown(&mut stage, &view, ON);
        stage.update(20);
        let before = stage.next_picture(&view.0);
        let mut all = stage.world().query::<(Entity, &VdbMaterial)>();
        let is_post =
            |(entity, own): (Entity, &VdbMaterial)| (own.emissive.red > 0.5).then_some(entity);
        let post = all.iter(stage.world()).find_map(is_post).expect("a post that shines");
        let mut post = stage.world().entity_mut(post);
        match change {
            "colour" => {
                post.insert(glow(LinearRgba::rgb(0.1, 0.2, 1.0)));
            }
            "place" => {
                post.insert(Transform::from_xyz(-1.0, 0.0, 1.0));
            }
            "grid" => {
                post.insert(VdbVolume(other.clone()));
            }
            _ => post.despawn(),
        }
        stage.update(4);
        let soon = stage.next_picture(&view.0);
        soon.save(&format!("history_{change}_soon"));
        let counts = dark(&shown(&mut stage, &view, VdbQuality { reflections: 0, ..ON }));
        let expected = shown(&mut stage, &view, MANY);
        let [before, soon] = [&before, &soon].map(|picture| error(picture, &expected, &counts));
        println!("{change}: {before:.4} before, {soon:.4} soon");
        assert!(soon < 0.35 * before, "{change}: {soon} instead of {before}");
    }
}

/// Only the rough ball changes: the mirror and everything that reflects nothing stay the same, bit for bit.
#[gpu_test]
fn mirrors_and_what_is_not_reflected_stay() {
    let mut stage = Stage::new();
    let view = scene(&mut stage, 0.05, 0.5);
    let on = VdbQuality { reflections: 1, ..default() };
    let [own, single] =
        [on, VdbQuality { denoise: false, ..on }].map(|own| shown(&mut stage, &view, own));
    own.save("denoise_mirror");
    let differ: Vec<UVec2> = (0..SIZE.element_product())
        .map(|i| UVec2::new(i % SIZE.x, i / SIZE.x))
        .filter(|at| own.at(at.x, at.y) != single.at(at.x, at.y))
        .collect();
    // The ball is in the middle of the picture.
    let ball = |at: &UVec2| at.as_vec2().distance(BALL) < BALL_RADIUS;
    assert!(differ.len() > 100, "{} pixels of the ball are denoised", differ.len());
    assert!(differ.iter().all(ball), "{:?}", differ.iter().find(|at| !ball(at)));
}

/// The example with anti-aliasing, in its first frame and later, beside the mean of 64. `VDB_GLOSSY_SIZE=1920x1080`
/// shows it larger, beside the mean of 256.
#[gpu_test]
#[ignore = "slow: means of hundreds of frames"]
fn the_glossy_example_has_no_visible_grain() {
    let asked = std::env::var("VDB_GLOSSY_SIZE");
    let (accumulate, updates) = if asked.is_ok() { (256, 40) } else { (64, 24) };
    let asked = asked.unwrap_or("208x117".into());
    let (x, y) = asked.split_once('x').unwrap();
    let size = UVec2::new(x.parse().unwrap(), y.parse().unwrap());
    let mut stage = Stage::new();
    glossy::scene(&mut stage.app);
    let target = stage.target(size);
    stage.update(1);
    let mut cameras = stage.world().query_filtered::<Entity, With<Camera3d>>();
    let camera = cameras.single(stage.world()).unwrap();
    stage.world().entity_mut(camera).remove::<(TemporalAntiAliasing, TemporalJitter)>();
    stage.world().entity_mut(camera).insert(RenderTarget::Image(target.clone().into()));
    let start = std::time::Instant::now();
    while stage.world().resource::<Assets<VdbGrid>>().len() < 5 {
        assert!(start.elapsed() < std::time::Duration::from_secs(60), "the models do not come");
        stage.update(1);
    }
    let view = (target, camera);
    let on = VdbQuality { reflections: 2, edge_samples: 8, ..default() };
    let single = VdbQuality { denoise: false, edge_samples: 0, ..on };
    let expected = shown(&mut stage, &view, VdbQuality { accumulate, ..single });
    expected.save("glossy_mean");
    let edges = VdbQuality { denoise: false, ..on };
    let [single, edges] = [("single", single), ("edges", edges)].map(|(name, quality)| {
        let picture = shown(&mut stage, &view, quality);
        picture.save(&format!("glossy_{name}"));
        mean(&flip(&picture, &expected))
    });
    let first = first_frame(&mut stage, &view, on);
    stage.update(updates);
    let later = stage.next_picture(&view.0);
    let [first, later] = [("first", first), ("later", later)].map(|(name, picture)| {
        picture.save(&format!("glossy_{name}"));
        mean(&flip(&picture, &expected))
    });
    println!(
        "glossy, {size}: FLIP {single:.4}, rays on edges {edges:.4}, denoised {first:.4}, {} frames later {later:.4}",
        updates + 1
    );
    assert!(first < 0.7 * single, "{first} instead of {single}");
    assert!(later < 0.9 * first, "{later} instead of {first}");
}
