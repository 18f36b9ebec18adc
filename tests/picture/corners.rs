//! A grid is as visible from beyond one of its corners as from beyond any other.
//!
//! Local cells start at zero. The coordinates of an eye beyond the lowest corner are therefore all negative, as those of
//! no cell of the grid are.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbTraversal, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};

use super::common::{Picture, Stage};
use super::{SIZE, looking};

/// Voxels.
const RADIUS: f64 = 20.0;
/// Of the eye from the middle of the grid along each axis: beyond its lower node, but less than the edge of one. In
/// world units; a voxel is a tenth.
const DISTANCE: f32 = 14.0;

fn corners() -> impl Iterator<Item = Vec3> {
    (0..8).map(|i| {
        let sign = |axis: u32| if i >> axis & 1 == 0 { -1.0 } else { 1.0 };
        Vec3::new(sign(0), sign(1), sign(2))
    })
}

/// A picture from beyond a corner. The sun is above that corner, so that all pictures are mirror images.
fn shown(
    stage: &mut Stage,
    [camera, sun]: [Entity; 2],
    target: &Handle<Image>,
    at: Vec3,
) -> Picture {
    let view = Transform::from_translation(DISTANCE * at).looking_at(Vec3::ZERO, Vec3::Y);
    stage.world().entity_mut(camera).insert(view);
    stage.world().entity_mut(sun).insert(looking(at * Vec3::new(1.0, 2.0, 0.5)));
    let picture = stage.picture(target);
    picture.save(&format!("corner_{at}").replace([' ', ',', '[', ']'], "_"));
    picture
}

fn scene() -> (Stage, [Entity; 2], Handle<Image>) {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, Transform::IDENTITY);
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
    let sun = stage.world().spawn(sun).id();
    (stage, [camera, sun], target)
}

/// Beams start before the surface.
#[gpu_test]
fn surfaces_are_whole_from_beyond_each_corner() {
    let (mut stage, own, target) = scene();
    let grid =
        stage.grid(level_set::sphere(DVec3::ZERO, RADIUS), PackKind::Smooth { iso: 0.0 }, 0.1);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default()));
    for at in corners() {
        let [with_beams, without] = [VdbTraversal::HddaSkip, VdbTraversal::Hdda].map(|traversal| {
            stage.world().entity_mut(own[0]).insert(VdbQuality { traversal, ..default() });
            shown(&mut stage, own, &target, at)
        });
        assert!(
            without.count(|pixel| pixel.max_element() > 0.0) > 80,
            "{at}: hardly anything is visible"
        );
        let pairs = with_beams.pixels.iter().zip(&without.pixels);
        assert_eq!(pairs.filter(|(a, b)| a != b).count(), 0, "pixels that differ from {at}");
    }
}

/// Fogs are sampled from their first cell on, alone and together.
#[gpu_test]
fn fogs_are_whole_from_beyond_each_corner() {
    for fogs in [1_u8, 2] {
        let (mut stage, own, target) = scene();
        stage.world().entity_mut(own[0]).insert(VdbQuality::HIGH);
        let density_scale = 2.0 / f32::from(fogs);
        for _ in 0..fogs {
            let grid = stage.grid(fog::sphere(DVec3::ZERO, RADIUS, 5.0), PackKind::Fog, 0.1);
            stage.world().spawn((VdbVolume(grid), VdbMaterial { density_scale, ..default() }));
        }
        let brightness = |picture: &Picture| {
            picture
                .pixels
                .iter()
                .map(|pixel| f64::from(pixel.truncate().element_sum()))
                .sum::<f64>()
        };
        let all: Vec<f64> =
            corners().map(|at| brightness(&shown(&mut stage, own, &target, at))).collect();
        println!("{fogs} fogs: {all:.2?}");
        let largest = all.iter().copied().fold(0.0, f64::max);
        assert!(largest > 80.0, "hardly anything is visible: {all:?}");
        assert!(all.iter().all(|own| *own > 0.98 * largest), "{fogs} fogs: {all:?}");
    }
}
