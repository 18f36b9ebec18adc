//! The CPU twin of the shader's walk against the exact reference tracer: no voxel and no face may
//! differ, on rays made to be hard.

use glam::{DVec3, Vec3};
use vdb_core::pack::exact::T_ERROR;
use vdb_core::pack::traverse::{self, first_hit};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::reference::{Blocky, Occupied, Ray};
use vdb_core::synth::{Random, level_set, rays, sparse};
use vdb_core::tree::{CoordBox, IVec3, Vdb543};

fn check(tree: &Vdb543<f32>, count: usize, seed: u64) {
    let grid = PackedGrid::new(tree, PackKind::Surface { iso: 0.0 }).unwrap();
    let oracle = Blocky::new(tree, Occupied::BelowIso(0.0));
    let bounds = grid.occupied.unwrap();
    let bbox = CoordBox { min: bounds.min + grid.base, max: bounds.max + grid.base };
    let mut random = Random::new(seed);
    let (mut met, mut tried) = (0, 0);
    while tried < count {
        // Every fourth from far away.
        let ray = match tried % 4 {
            0 => rays::far(&mut random, bbox).map(|(ray, _)| ray),
            _ => Some(rays::adversarial(&mut random, bbox)),
        };
        let Some(ray) = ray else { continue };
        let Some(dir) = rays::normalized(ray.dir) else { continue };
        let ray = traverse::Ray::from_index(&grid, ray.cell, ray.frac, dir);
        let Some(cell) = ray.cell.checked_add(grid.base) else { continue };
        // Half a voxel between lattice and index space: exact, as the fraction has 24 bits.
        let exact = Ray::new(cell, ray.frac - 0.5, ray.dir).flushed();
        for exact in [exact, rays::ended(&mut random, exact, bbox, 0.5)] {
            let ray = traverse::Ray { t_min: exact.t_min, t_max: exact.t_max, ..ray };
            let exact = exact.flushed();
            let hit = oracle.first_voxel(&exact);
            let expected = hit.map(|hit| (hit.ijk, hit.face.map_or(3, |face| face.axis.into())));
            let found = first_hit(&grid, &ray);
            let voxel = found.map(|hit| (hit.cell + grid.base, hit.axis));
            assert_eq!(voxel, expected, "{ray:?} (seed {seed}, ray {tried})");
            if let (Some(hit), Some(found)) = (hit, found) {
                let off = (f64::from(found.t) - hit.t).abs();
                assert!(off <= hit.t * f64::from(T_ERROR), "{found:?}, not {hit:?}: {ray:?}");
                assert!((exact.begin()..=exact.t_max).contains(&found.t), "{found:?} of {ray:?}");
            }
            met += usize::from(expected.is_some());
        }
        tried += 1;
    }
    println!("2 · {count} rays, {met} meet a voxel, none differs");
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
fn no_voxel_and_no_face_differs() {
    check(&level_set::sphere(DVec3::new(3.3, -200.7, 40.1), 30.3), 40_000, 1);
    check(&level_set::gyroid(DVec3::ZERO, 40.0, 18.0), 40_000, 2);
    check(&level_set::torus(DVec3::splat(1e6), 40.0, 12.5), 40_000, 3);
    check(&turned_over(&sparse::random(cube(-40, 40), 0.01, 5)), 40_000, 4);
    check(&turned_over(&sparse::checkerboard(cube(-5, 6))), 40_000, 5);
    check(&turned_over(&sparse::box_shell(cube(-20, 13))), 40_000, 6);
    check(&turned_over(&sparse::voxels(&[IVec3::new(7, 8, -9)])), 40_000, 7);
}

#[test]
fn voxels_next_to_the_limits() {
    for corner in [IVec3::MIN + 9, IVec3::MAX - 9] {
        check(&turned_over(&sparse::voxels(&[corner])), 10_000, 21);
    }
}

#[test]
fn two_million_voxels_of_nothing() {
    let apart = [IVec3::ZERO, IVec3::splat(2_000_000), IVec3::new(0, 2_000_000, 0)];
    let tree = turned_over(&sparse::voxels(&apart));
    let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
    for (from, to) in [(0, 1), (1, 0), (2, 0), (0, 2), (1, 2)].map(|(a, b)| (apart[a], apart[b])) {
        let dir = (to - from).as_vec3();
        // From beyond the first voxel, so that the walk has to leave it.
        let start = from + (to - from).signum();
        let ray = traverse::Ray::from_index(&grid, start, Vec3::ZERO, dir);
        let hit = first_hit(&grid, &ray).map(|hit| hit.cell + grid.base);
        assert_eq!(hit, Some(to), "from {from}");
    }
}
