//! What is hidden costs nothing, in steps of the walk.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbQuality, VdbRenderMode, VdbTraversal, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking, parallel};

/// Steps that are shown as the hottest colour; more than any ray here takes.
const SCALE: f32 = 1024.0;

/// A camera that shows steps.
pub(super) fn counting() -> VdbCamera {
    VdbCamera { mode: VdbRenderMode::Steps, steps_scale: SCALE, ..default() }
}

/// The steps of a pixel's ray, by its colour: green goes from 0.8, for none, to 0. Nothing is drawn
/// without any.
pub(super) fn steps(pixel: Vec4) -> f64 {
    if pixel.truncate() == Vec3::ZERO {
        return 0.0;
    }
    assert!(pixel.y > 0.0, "there are more than {SCALE} steps");
    f64::from(SCALE * (1.0 - pixel.y / 0.8))
}

pub(super) fn all_steps(picture: &Picture) -> f64 {
    picture.pixels.iter().map(|pixel| steps(*pixel)).sum()
}

/// A wall of a black mesh, across the line of sight.
fn wall(stage: &mut Stage, min: Vec3, max: Vec3) -> Entity {
    let mesh = Cuboid::from_corners(min, max);
    let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(mesh);
    let material = StandardMaterial { base_color: Color::BLACK, unlit: true, ..default() };
    let material = stage.world().resource_mut::<Assets<StandardMaterial>>().add(material);
    let at = Transform::from_translation(0.5 * (min + max));
    stage.world().spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// By any projection and with several samples a pixel: rays to what a wall hides take no step, those
/// beside it take as many as without the wall.
#[gpu_test]
#[ignore = "slow: each kind of grid in each projection"]
fn behind_a_wall_rays_take_no_step() {
    let block = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(19) };
    let kinds = [
        ("voxels", level_set::sphere(DVec3::ZERO, 20.0), SURFACE),
        ("smooth", level_set::gyroid(DVec3::ZERO, 20.0, 15.0), PackKind::Smooth { iso: 0.0 }),
        ("fog", fog::block(block, 0.1), PackKind::Fog),
    ];
    let lens = PerspectiveProjection { fov: 45.0_f32.to_radians(), ..default() };
    let mut stage = Stage::new();
    for (name, tree, kind) in kinds {
        for (msaa, projection) in [
            (Msaa::Off, Projection::Perspective(lens.clone())),
            (Msaa::Sample4, Projection::Perspective(lens.clone())),
            (Msaa::Off, parallel(6.0)),
        ] {
            let is_parallel = matches!(projection, Projection::Orthographic(_));
            let what = format!("{name}_{msaa:?}_{}", if is_parallel { "parallel" } else { "lens" });
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
            stage.world().entity_mut(camera).insert((msaa, projection, counting()));
            let grid = stage.grid(tree.clone(), kind, 0.1);
            stage.world().spawn(VdbVolume(grid));
            for traversal in [VdbTraversal::HddaSkip, VdbTraversal::Hdda] {
                let quality = VdbQuality { traversal, ..default() };
                stage.world().entity_mut(camera).insert(quality);
                let open = stage.picture(&target);
                assert!(all_steps(&open) > 2000.0, "{what}: {}", all_steps(&open));
                // Nearer than the volume, whose box begins at 2.1.
                let whole = wall(&mut stage, Vec3::new(-9.0, -9.0, 2.2), Vec3::new(9.0, 9.0, 2.5));
                let hidden = stage.picture(&target);
                assert_eq!(all_steps(&hidden), 0.0, "{what} {traversal:?}: all is hidden");
                stage.world().despawn(whole);
                let left = wall(&mut stage, Vec3::new(-9.0, -9.0, 2.2), Vec3::new(0.0, 9.0, 2.5));
                let half = stage.picture(&target);
                half.save(&format!("need_{what}_{traversal:?}"));
                stage.world().despawn(left);
                for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
                    let (own, free) = (steps(half.at(x, y)), steps(open.at(x, y)));
                    // Where the wall's edge goes through a pixel's samples, its ray goes on.
                    if x + 1 < SIZE.x / 2 {
                        assert_eq!(own, 0.0, "{what} {traversal:?}: {x}, {y}");
                    } else if x > SIZE.x / 2 {
                        assert_eq!(own, free, "{what} {traversal:?}: {x}, {y}");
                    }
                }
            }
        }
    }
}

/// A mesh in a fog ends its rays: what is behind it takes no step.
#[gpu_test]
fn rays_through_fog_end_at_meshes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 30.0));
    stage.world().entity_mut(camera).insert(counting());
    // Of densities that differ from voxel to voxel, so that each is a step.
    let long = CoordBox { min: IVec3::new(-24, -24, -80), max: IVec3::new(23, 23, 79) };
    let tree =
        fog::from_values(long, |at| 0.01 + 0.001 * ((at.x + 3 * at.y + 7 * at.z) & 7) as f32);
    let grid = stage.grid(tree, PackKind::Fog, 0.1);
    stage.world().spawn(VdbVolume(grid));
    let whole = steps(stage.picture(&target).center());
    assert!(whole > 160.0, "{whole} steps");
    for part in [0.25, 0.5, 0.75] {
        // From 8 on, the ray goes 16 through the fog.
        let z = 8.0 - 16.0 * part;
        let wall = wall(&mut stage, Vec3::new(-9.0, -9.0, z - 0.1), Vec3::new(9.0, 9.0, z));
        let own = steps(stage.picture(&target).center());
        stage.world().despawn(wall);
        // A leaf is entered, and a cell begun, at most.
        let most = f64::from(part) * whole + 2.0;
        println!("{part} of the way: {own} of {whole} steps");
        assert!(own > 0.0 && own <= most, "{part}: {own} of {whole}");
    }
}
