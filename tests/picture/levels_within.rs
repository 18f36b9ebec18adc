//! Levels of detail within one volume: a terrain that reaches from the camera's feet to the horizon.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbGrid, VdbMaterial, VdbQuality, VdbRenderMode, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::level_set;
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::flip::{flip, mean};
use super::levels::wait_for;
use super::need::{all_steps, counting};
use super::{SIZE, SURFACE, pixel_ray};

const VOXEL: f64 = 0.02;
/// The edge of the terrain in voxels, and the coarser levels down to less than 32.
const EDGE: i32 = 800;
const LEVELS: u64 = 5;

/// The height of the hills over a point of the plane, and its slope there, in world units.
pub(super) fn hills(x: f64, z: f64) -> (f64, DVec3) {
    let (a, b) = (1.1 * x + 0.4 * z, 0.9 * z - 0.3 * x);
    let height = 0.35 * a.sin() * b.cos();
    let [along_a, along_b] = [0.35 * a.cos() * b.cos(), -0.35 * a.sin() * b.sin()];
    (height, DVec3::new(1.1 * along_a - 0.3 * along_b, 0.0, 0.4 * along_a + 0.9 * along_b))
}

/// The distance of a point from the hills to first order, in world units.
pub(super) fn above_hills(at: DVec3) -> f64 {
    let (height, slope) = hills(at.x, at.z);
    (at.y - height) / (1.0 + slope.length_squared()).sqrt()
}

fn terrain() -> Vdb543<f32> {
    let bbox =
        CoordBox { min: IVec3::new(-EDGE / 2, -40, -EDGE), max: IVec3::new(EDGE / 2, 40, 0) };
    let depth = 30.0;
    // Dividing by 1.2 keeps the Lipschitz constant below 1 on the steepest slope.
    level_set::from_distance(bbox, |at| {
        (at.y * VOXEL - hills(at.x * VOXEL, at.z * VOXEL).0).max(-depth * VOXEL - at.y * VOXEL)
            / (1.2 * VOXEL)
    })
}

/// A camera just above the near end of the terrain.
fn view() -> Transform {
    Transform::from_xyz(0.1, 1.0, 0.3).looking_at(Vec3::new(0.0, -0.3, -4.0), Vec3::Y)
}

/// A stage with the terrain, and a camera that draws it at a level of detail.
struct Land {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
}

impl Land {
    fn new(kind: PackKind) -> Self {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, view());
        let grid: Handle<VdbGrid> = stage.grid(terrain(), kind, VOXEL);
        stage.world().spawn((VdbVolume(grid), VdbMaterial::default()));
        let sun = DirectionalLight { illuminance: 4.0, shadow_maps_enabled: true, ..default() };
        let low = Transform::from_xyz(3.0, 1.5, 1.0).looking_at(Vec3::ZERO, Vec3::Y);
        stage.world().spawn((sun, low));
        Self { stage, target, camera }
    }

    fn picture(&mut self, camera: VdbCamera, detail: f32) -> Picture {
        let quality = VdbQuality { detail, ..default() };
        self.stage.world().entity_mut(self.camera).insert((camera, quality));
        wait_for(&mut self.stage, 1, if detail > 0.0 { LEVELS } else { 0 });
        self.stage.picture(&self.target)
    }

    fn shown(&mut self, mode: VdbRenderMode, detail: f32) -> Picture {
        self.picture(VdbCamera { mode, ..default() }, detail)
    }
}

/// Pixels of the terrain whose neighbours all show it: there it has no edge.
fn inner(picture: &Picture) -> Vec<UVec2> {
    let hit = |x: u32, y: u32| picture.at(x, y).w > 0.0;
    let all = (1..SIZE.y - 1).flat_map(|y| (1..SIZE.x - 1).map(move |x| (x, y)));
    all.filter(|&(x, y)| (0..9).all(|i| hit(x + i % 3 - 1, y + i / 3 - 1)))
        .map(|(x, y)| UVec2::new(x, y))
        .collect()
}

/// At every depth, a surface is shown by voxels no larger than a pixel, and is off by less than that; rays take fewer
/// steps, and there are no holes.
fn check_within_a_pixel(kind: PackKind, name: &str, most: f64) {
    let mut land = Land::new(kind);
    let exact = land.shown(VdbRenderMode::Depth, 0.0);
    let coarse = land.shown(VdbRenderMode::Depth, 1.0);
    coarse.save(&format!("levels_within_{name}"));
    let pixels = inner(&exact);
    assert!(pixels.len() > 3_000, "{} pixels of terrain", pixels.len());
    let holes = pixels.iter().filter(|at| coarse.at(at.x, at.y).w == 0.0).count();
    let pixel = 2.0 * (22.5_f64.to_radians()).tan() / f64::from(SIZE.y);
    let mut worst = [0.0_f64; 4];
    for at in &pixels {
        let (origin, dir) = pixel_ray(view(), at.x, at.y);
        // Bevy's reversed depth, with a near plane of 0.1.
        let t = 0.1 / f64::from(coarse.at(at.x, at.y).x);
        // In pixels at that depth; the exact surface has voxels, too.
        let off = above_hills(origin + t * dir).abs() / (t * pixel).max(0.5 * VOXEL);
        let level = (t * pixel / VOXEL).log2().clamp(0.0, 3.0) as usize;
        worst[level] = worst[level].max(off);
    }
    println!("{name}: off by at most {worst:.3?} pixels at levels 0, 1, 2, 3…; {holes} holes");
    assert_eq!(holes, 0, "{name}");
    assert!(worst.iter().all(|&off| off > 0.0 && off < most), "{name}: {worst:?}");
    let [plain, fewer] = [0.0, 1.0].map(|detail| all_steps(&land.picture(counting(), detail)));
    println!("{name}: {plain:.0} steps, with levels {fewer:.0}");
    assert!(fewer < 0.95 * plain, "{name}: {fewer} of {plain} steps");
}

#[gpu_test]
#[ignore = "slow: pictures of a terrain at many pixels"]
fn a_smooth_terrain_is_within_a_pixel() {
    check_within_a_pixel(PackKind::Smooth { iso: 0.0 }, "smooth", 0.5);
}

#[gpu_test]
#[ignore = "slow: a large grid"]
fn a_terrain_of_voxels_is_within_a_pixel() {
    // The corner of a voxel is √3/2 of its edge away from its middle.
    check_within_a_pixel(SURFACE, "voxels", 1.0);
}

/// On a slow flight in the sun, frames look like those at full resolution, and differ from each other by no more.
#[gpu_test]
#[ignore = "slow: two flights"]
fn levels_do_not_shimmer() {
    let mut land = Land::new(PackKind::Smooth { iso: 0.0 });
    let mut flight = |detail: f32| {
        (0..6)
            .map(|i| {
                let at = view().with_translation(view().translation - Vec3::Z * 0.03 * i as f32);
                *land.stage.world().get_mut::<Transform>(land.camera).unwrap() = at;
                let picture = land.shown(VdbRenderMode::Lit, detail);
                picture.save(&format!("levels_within_{detail}_{i}"));
                picture
            })
            .collect::<Vec<Picture>>()
    };
    let [exact, half] = [0.0, 0.5].map(&mut flight);
    let pairs = exact.iter().zip(&half).map(|(a, b)| mean(&flip(a, b)));
    let off = pairs.fold(0.0, f64::max);
    let [exact, half] = [exact, half].map(|frames| {
        frames.windows(2).map(|two| mean(&flip(&two[0], &two[1]))).sum::<f64>() / 5.0
    });
    println!("FLIP between frames: {exact:.4}, with levels {half:.4}; of both {off:.4}");
    assert!(off < 0.01, "levels look different by {off}");
    assert!(half < 1.05 * exact, "{half} instead of {exact}");
}
