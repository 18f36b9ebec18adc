//! Levels of detail.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbClipPlane, VdbClippedBy, VdbGpuUsage, VdbMaterial, VdbQuality, VdbRenderMode,
    VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::Vdb543;

use super::common::{Picture, Stage};
use super::need::{all_steps, counting};
use super::{SIZE, SURFACE, looking, pixel_ray};

/// Updates until the pool has `grids` grids with `levels` coarser levels, or the time is up.
pub(super) fn wait_for(stage: &mut Stage, grids: u64, levels: u64) {
    let usage = stage.world().resource::<VdbGpuUsage>().clone();
    for _ in 0..2000 {
        stage.update(1);
        if (usage.grids(), usage.levels()) == (grids, levels) {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let there = (usage.grids(), usage.levels());
    panic!("grids and levels on the GPU: {there:?}, not {:?}", (grids, levels));
}

/// The stage's camera with levels of detail or without.
fn ask(stage: &mut Stage, camera: Entity, mode: VdbRenderMode, detail: f32) {
    stage
        .world()
        .entity_mut(camera)
        .insert((VdbCamera { mode, ..default() }, VdbQuality { detail, ..default() }));
}

const RADIUS: f64 = 4.0;
const VOXEL: f64 = 0.04;
/// A ball of 200 voxels from end to end, and at 1/2 … 1/8 of that. At 1/16 it would be below 16.
const LEVELS: u64 = 3;

/// How far the normals of a ball are off, in degrees, where it is not seen edge on; and of how many
/// pixels the ray passes the ball's edge by more than `margin`, but its colour says otherwise.
fn errors(picture: &Picture, view: Transform, margin: f64) -> (f64, usize) {
    let (mut worst, mut wrong) = (0.0_f64, 0);
    for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
        let (origin, dir) = pixel_ray(view, x, y);
        let dir = dir.normalize();
        let nearest = origin - dir * origin.dot(dir);
        let past = nearest.length() - RADIUS;
        let color = picture.at(x, y).truncate();
        let is_hit = color != Vec3::ZERO;
        wrong += usize::from(past.abs() > margin && is_hit != (past < 0.0));
        if is_hit && past < -0.3 * RADIUS {
            let before = (RADIUS * RADIUS - nearest.length_squared()).sqrt();
            let truth = (nearest - dir * before).normalize();
            let own = (color.as_dvec3() * 2.0 - 1.0).normalize();
            worst = worst.max(own.dot(truth).min(1.0).acos().to_degrees());
        }
    }
    (worst, wrong)
}

/// Where a pixel of the ball is ten voxels.
fn far_view() -> Transform {
    looking(Vec3::new(8.0, 12.0, 26.0))
}

/// Spawns the ball.
fn spawn_ball(stage: &mut Stage) -> Entity {
    let kind = PackKind::Smooth { iso: 0.0 };
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, RADIUS / VOXEL), kind, VOXEL);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default())).id()
}

#[gpu_test]
fn far_surfaces_are_shown_by_coarser_grids() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = far_view();
    let camera = stage.camera(&target, view);
    spawn_ball(&mut stage);
    ask(&mut stage, camera, VdbRenderMode::Normals, 0.0);
    wait_for(&mut stage, 1, 0);
    let exact = stage.picture(&target);
    exact.save("levels_exact");
    let (off, wrong) = errors(&exact, view, 0.01 * VOXEL);
    // By less than they turn from one voxel to the next.
    let turn = (VOXEL / RADIUS).to_degrees();
    assert!(off < turn && wrong == 0, "normals are off by {off}°, {wrong} pixels are wrong");

    ask(&mut stage, camera, VdbRenderMode::Normals, 1.0);
    wait_for(&mut stage, 1, LEVELS);
    let coarse = stage.picture(&target);
    coarse.save("levels_coarse");
    // Voxels eight times as large, 25 across the ball.
    let (off, wrong) = errors(&coarse, view, 0.25 * 8.0 * VOXEL);
    assert!(off < 8.0 * turn && wrong == 0, "normals are off by {off}°, {wrong} pixels are wrong");
    assert!(coarse != exact, "the coarser grid was not shown");

    // From close by, there is nothing to save, and nothing is.
    let near = looking(Vec3::new(2.0, 2.0, 4.0));
    *stage.world().get_mut::<Transform>(camera).unwrap() = near;
    let with = stage.picture(&target);
    ask(&mut stage, camera, VdbRenderMode::Normals, 0.0);
    wait_for(&mut stage, 1, 0);
    assert!(stage.picture(&target) == with, "a near surface is not shown as it is");
    *stage.world().get_mut::<Transform>(camera).unwrap() = view;
    assert!(stage.picture(&target) == exact, "what was exact is so no more");
}

#[gpu_test]
fn far_fog_dims_as_much() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(3.0, 4.0, 28.0)));
    // Before a bright sky: what is seen of that is the transmittance.
    stage.world().insert_resource(ClearColor(Color::linear_rgb(1.0, 1.0, 1.0)));
    let grid = stage.grid(fog::sphere(DVec3::ZERO, 90.0, 40.0), PackKind::Fog, VOXEL);
    let material = VdbMaterial { base_color: Color::BLACK, density_scale: 0.3, ..default() };
    stage.world().spawn((VdbVolume(grid), material));
    ask(&mut stage, camera, VdbRenderMode::Lit, 0.0);
    wait_for(&mut stage, 1, 0);
    let exact = stage.picture(&target);
    exact.save("levels_fog");
    ask(&mut stage, camera, VdbRenderMode::Lit, 1.0);
    wait_for(&mut stage, 1, LEVELS);
    let coarse = stage.picture(&target);
    let pairs = exact.pixels.iter().zip(&coarse.pixels);
    let dimmed = |pixel: &Vec4| f64::from(1.0 - pixel.x);
    let [least, all, both] = pairs.fold([f64::INFINITY, 0.0, 0.0], |[least, all, both], (a, b)| {
        let off = (dimmed(a) - dimmed(b)).abs();
        assert!(off < 0.02, "{a} became {b}");
        [least.min(1.0 - dimmed(a)), all + dimmed(a), both + dimmed(b)]
    });
    assert!(least < 0.5, "the fog is thin: {least}");
    assert!((both / all - 1.0).abs() < 2e-3, "{all} of light in all became {both}");
    assert!(coarse != exact, "the coarser grid was not shown");
}

/// The cap of a ball that is cut in half, and what is left of its outline, at full detail and at an eighth of it.
#[gpu_test]
fn clip_planes_cut_every_level_in_the_same_place() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = far_view();
    let camera = stage.camera(&target, view);
    let ball = spawn_ball(&mut stage);
    let normal = DVec3::new(0.2, 0.3, 1.0).normalize();
    let turn = Quat::from_rotation_arc(Vec3::Y, normal.as_vec3());
    let point = 0.1 * RADIUS * normal;
    let plane = Transform::from_translation(point.as_vec3()).with_rotation(turn);
    let plane = stage.world().spawn((VdbClipPlane, plane)).id();
    stage.world().entity_mut(ball).insert(VdbClippedBy(vec![plane]));
    for (detail, levels) in [(0.0, 0), (1.0, LEVELS)] {
        ask(&mut stage, camera, VdbRenderMode::Normals, detail);
        wait_for(&mut stage, 1, levels);
        let picture = stage.picture(&target);
        picture.save(&format!("levels_cut_{detail}"));
        let (mut on_cap, mut wrong) = (0, 0);
        for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
            let (origin, dir) = pixel_ray(view, x, y);
            let met = origin + dir * ((point - origin).dot(normal) / dir.dot(normal));
            // Of the rim, a coarse surface may be off by a quarter of its voxel.
            let margin = if levels > 0 { 2.0 * VOXEL } else { 0.01 * VOXEL };
            if met.length() < RADIUS - margin {
                let own = picture.at(x, y).truncate().as_dvec3() * 2.0 - 1.0;
                on_cap += 1;
                wrong += usize::from(own.distance(normal) > 4e-3);
            }
        }
        assert!(on_cap > 300, "the cap has {on_cap} pixels");
        assert_eq!(wrong, 0, "of {on_cap} pixels of the cap, at detail {detail}");
    }
}

/// With levels of detail, what a far volume costs follows the pixels that it covers: with twice as many voxels
/// along each edge, rays take no more steps. Without, they do.
#[gpu_test]
#[ignore = "slow: levels of large grids of each kind"]
fn twice_the_voxels_far_away_cost_the_same() {
    let shapes: [(&str, PackKind, &dyn Fn(f64) -> Vdb543<f32>); 3] = [
        ("voxels", SURFACE, &|edge| level_set::gyroid(DVec3::ZERO, 0.45 * edge, 0.5 * edge)),
        ("smooth", PackKind::Smooth { iso: 0.0 }, &|edge| {
            level_set::torus(DVec3::ZERO, 0.3 * edge, 0.15 * edge)
        }),
        ("fog", PackKind::Fog, &|edge| fog::sphere(DVec3::ZERO, 0.45 * edge, 0.25 * edge)),
    ];
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    // Eight world units are twenty pixels.
    let camera = stage.camera(&target, looking(Vec3::new(12.0, 15.0, 24.0)));
    for (name, kind, shape) in shapes {
        let mut cost = |edge: f64, detail: f32| {
            let grid = stage.grid(shape(edge), kind, 8.0 / edge);
            let material = VdbMaterial { density_scale: 0.02, ..default() };
            let volume = stage.world().spawn((VdbVolume(grid), material)).id();
            let quality = VdbQuality { detail, ..default() };
            stage.world().entity_mut(camera).insert((counting(), quality));
            // Down to less than 32 voxels.
            let levels = if detail > 0.0 { (edge / 32.0).log2() as u64 } else { 0 };
            wait_for(&mut stage, 1, levels);
            let picture = stage.picture(&target);
            picture.save(&format!("need_{name}_{edge}_{detail}"));
            stage.world().despawn(volume);
            wait_for(&mut stage, 0, 0);
            all_steps(&picture)
        };
        let [once, twice] = [128.0, 256.0].map(|edge| cost(edge, 1.0));
        let [plain, finer] = [128.0, 256.0].map(|edge| cost(edge, 0.0));
        println!(
            "{name}: {once:.0} and {twice:.0} steps; without levels {plain:.0} and {finer:.0}"
        );
        assert!(once > 500.0 && (twice / once - 1.0).abs() < 0.1, "{name}: {once}, {twice}");
        assert!(finer > 1.1 * twice, "{name}: {twice}, {finer}: there was nothing to save");
    }
}
