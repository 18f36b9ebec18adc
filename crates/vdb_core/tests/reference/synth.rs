//! The procedural grids are what they say they are.

use glam::DVec3;
use vdb_core::{
    synth,
    tree::{CoordBox, Found, IVec3, Node, Vdb543},
};

#[test]
fn a_level_set_is_that_of_its_formula_with_a_flood_filled_rest() {
    let (center, radius) = (DVec3::new(3.5, -100.25, 7.0), 90.0);
    let tree = synth::level_set::sphere(center, radius);
    let (mut active, mut random) = (0, synth::Random::new(1));
    for _ in 0..200_000 {
        let at = |random: &mut synth::Random| random.range(-100.0, 100.0);
        let p = center + DVec3::new(at(&mut random), at(&mut random), at(&mut random));
        let ijk = p.floor().as_ivec3();
        let distance = (ijk.as_dvec3().distance(center) - radius) as f32;
        let expected = if distance.abs() < 3.0 {
            (distance, true)
        } else {
            (3.0_f32.copysign(distance), false)
        };
        assert_eq!(tree.probe(ijk), expected, "{ijk}");
        active += u32::from(expected.1);
    }
    assert!(active > 1000);
    // The middle is a tile of an inner level, and nothing is left to prune.
    assert!(
        matches!(tree.find(center.as_ivec3()), Found::Tile(tile) if tile.value == -3.0 && !tile.active)
    );
    let mut pruned = tree.clone();
    pruned.prune();
    assert_eq!(pruned.stats().levels, tree.stats().levels);
    // A shell of 6 voxels about the sphere: 4π (r² + 3²/3) · 6 voxels, up to its own surface.
    let volume = 4.0 * std::f64::consts::PI * (radius * radius + 3.0) * 6.0;
    let voxels = tree.active_voxel_count() as f64;
    assert!((voxels / volume - 1.0).abs() < 1e-2, "{voxels} {volume}");
}

#[test]
fn a_block_has_tiles_of_every_level() {
    let tiles = |tree: &Vdb543<f32>, log2_dim| {
        tree.active_values().filter(|value| value.log2_dim == log2_dim).count()
    };
    let bbox = CoordBox { min: IVec3::splat(-9), max: IVec3::splat(128) };
    let tree = synth::fog::block(bbox, 0.5);
    assert_eq!(tiles(&tree, 7), 1);
    assert!(tiles(&tree, 3) > 0 && tiles(&tree, 0) > 0);
    assert_eq!(tree.active_bbox(), Some(bbox));
    assert_eq!(tree.active_voxel_count(), 138_u64.pow(3));
    let bbox = CoordBox { min: IVec3::splat(-4096), max: IVec3::splat(4095) };
    let tree = synth::fog::block(bbox, 0.5);
    assert_eq!((tiles(&tree, 12), tree.active_bbox()), (8, Some(bbox)));
}

fn count(tree: &Vdb543<f32>) -> u64 {
    tree.active_voxel_count()
}

#[test]
fn patterns_have_as_many_voxels_as_they_should() {
    let bbox = CoordBox { min: IVec3::splat(-5), max: IVec3::splat(14) };
    assert_eq!(count(&synth::sparse::checkerboard(bbox)), 20_u64.pow(3) / 2);
    assert_eq!(count(&synth::sparse::box_shell(bbox)), 20_u64.pow(3) - 18_u64.pow(3));
    assert_eq!(count(&synth::sparse::voxels(&[IVec3::MIN, IVec3::MAX])), 2);
    // Beams of 2 in a pitch of 10, twice along each edge: 3 a² b - 2 a³ with a = 4, b = 20.
    assert_eq!(count(&synth::sparse::truss(bbox, 10, 2)), 3 * 16 * 20 - 2 * 64);
    let random = count(&synth::sparse::random(bbox, 0.25, 1)) as f64 / 8000.0;
    assert!((random - 0.25).abs() < 0.02, "{random}");
    let shell = synth::sparse::sphere_shell(DVec3::splat(0.25), 12.0);
    assert!(
        shell
            .active_values()
            .all(|v| { (v.origin.as_dvec3().distance(DVec3::splat(0.25)) - 12.0).abs() <= 0.5 })
    );
    assert!(count(&shell) > 1500);
}

#[test]
fn solids_are_inside_where_they_should_be() {
    let torus = synth::level_set::torus(DVec3::ZERO, 40.0, 10.0);
    assert_eq!(torus.get(IVec3::new(40, 0, 0)), -3.0);
    // From the circle of radius 40, less 10.
    assert_eq!(torus.get(IVec3::new(50, 0, 1)), (10.0_f64.hypot(1.0) - 10.0) as f32);
    assert_eq!(torus.get(IVec3::ZERO), 3.0);
    let cuboid = synth::level_set::cuboid(DVec3::splat(-10.5), DVec3::splat(20.0));
    assert_eq!(cuboid.get(IVec3::new(-11, 0, 0)), 0.5);
    assert_eq!(cuboid.get(IVec3::new(21, 21, 0)), 2.0_f32.sqrt());
    assert_eq!(cuboid.get(IVec3::new(5, 5, 5)), -3.0);
    let gyroid = synth::level_set::gyroid(DVec3::ZERO, 30.0, 20.0);
    assert_eq!(gyroid.get(IVec3::ZERO), 0.0);
    assert_eq!(gyroid.get(IVec3::new(40, 0, 0)), 3.0);
    let fog = synth::fog::sphere(DVec3::ZERO, 50.0, 10.0);
    assert_eq!((fog.get(IVec3::ZERO), fog.get(IVec3::new(45, 0, 0))), (1.0, 0.5));
    assert_eq!(fog.probe(IVec3::new(50, 0, 0)), (0.0, false));
    assert!(fog.leaves().all(|leaf| leaf.uniform().is_none()));
}
