//! The CPU twin of the shader's walk against the exact reference tracer: no voxel and no face may
//! differ, on rays made to be hard.

use glam::DVec3;
use vdb_core::pack::walk::{self, first_hit};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::reference::{Blocky, Occupied, Ray};
use vdb_core::synth::rays::{HardRay, hard_ray};
use vdb_core::synth::{Random, level_set, sparse};
use vdb_core::tree::{CoordBox, IVec3, Vdb543};

fn check(tree: &Vdb543<f32>, count: usize, seed: u64, far: f64) {
    let grid = PackedGrid::new(tree, PackKind::Surface { iso: 0.0 }).unwrap();
    let oracle = Blocky::new(tree, Occupied::BelowIso(0.0));
    let bounds = grid.occupied.unwrap();
    let mut random = Random::new(seed);
    let (mut met, mut tried) = (0, 0);
    let solid: Vec<IVec3> = tree.values().filter(|v| v.value < 0.0).map(|v| v.origin).collect();
    while tried < count {
        let mut vector = |low, high| DVec3::from_array([0; 3].map(|_| random.range(low, high)));
        // Every other at a voxel that is there, or close by; the rest anywhere in the box.
        let target = if tried % 2 == 0 {
            let spread = vector(-0.6, 1.6);
            let voxel = solid[random.below(solid.len() as u64) as usize] - grid.base;
            voxel.as_dvec3() + spread
        } else {
            let size = (bounds.max - bounds.min).as_dvec3() + 4.0;
            bounds.min.as_dvec3() - 2.0 + size * vector(0.0, 1.0)
        };
        let Some(HardRay { cell, frac, dir }) = hard_ray(&mut random, target, far) else {
            continue;
        };
        let ray = walk::Ray { cell, frac, dir, t_min: 0.0, t_max: 1e30 };
        // Voxel `ijk` is the lattice cell `ijk`, half a voxel lower in index space: exact in f32.
        let Some(index_cell) = cell.checked_add(grid.base) else { continue };
        let exact = Ray::new(index_cell, frac - 0.5, dir).with_span(0.0, 1e30).flushed();
        let expected = oracle.first_voxel(&exact);
        let found = first_hit(&grid, &ray);
        let expected = expected.map(|hit| (hit.ijk, hit.face.map_or(3, |face| face.axis.into())));
        let found = found.map(|hit| (hit.cell + grid.base, hit.axis));
        assert_eq!(found, expected, "{ray:?} (seed {seed}, ray {tried})");
        met += usize::from(expected.is_some());
        tried += 1;
    }
    println!("{count} rays, {met} meet a voxel, none differs");
    assert!(met * 20 > count, "hardly a ray met anything: {met}");
}

fn turned_over(positive: &Vdb543<f32>) -> Vdb543<f32> {
    let mut tree = Vdb543::new(1.0);
    positive.active_values().for_each(|voxel| {
        assert_eq!(voxel.log2_dim, 0, "the pattern has tiles");
        tree.set(voxel.origin, -1.0);
    });
    tree
}

fn cube(min: i32, max: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) }
}

#[test]
fn no_voxel_and_no_face_differs_near() {
    check(&level_set::sphere(DVec3::new(3.3, -200.7, 40.1), 30.3), 40_000, 1, 200.0);
    check(&level_set::gyroid(DVec3::ZERO, 40.0, 18.0), 40_000, 2, 200.0);
    check(&turned_over(&sparse::random(cube(-40, 40), 0.01, 5)), 40_000, 3, 200.0);
    check(&turned_over(&sparse::checkerboard(cube(-5, 6))), 40_000, 4, 50.0);
    check(&turned_over(&sparse::box_shell(cube(-20, 13))), 40_000, 5, 100.0);
    check(&turned_over(&sparse::voxels(&[IVec3::new(7, 8, -9)])), 20_000, 6, 20.0);
}

#[test]
fn no_voxel_and_no_face_differs_far_away() {
    for (i, far) in [1e4, 1e5, 1e6, 1e7, 5e8].into_iter().enumerate() {
        let shift = DVec3::splat(1e6 * i as f64);
        check(&level_set::torus(shift, 40.0, 12.5), 10_000, 10 + i as u64, far);
    }
}

#[test]
fn voxels_two_million_apart_and_next_to_the_limits() {
    let apart = [IVec3::ZERO, IVec3::splat(2_000_000), IVec3::new(0, 2_000_000, 0)];
    check(&turned_over(&sparse::voxels(&apart)), 400, 20, 10.0);
    for corner in [IVec3::MIN + 9, IVec3::MAX - 9] {
        check(&turned_over(&sparse::voxels(&[corner])), 10_000, 21, 30.0);
    }
}
