//! First voxels.

use glam::{DVec3, IVec3, Vec3};
use vdb_core::pack::exact::T_ERROR;
use vdb_core::pack::{PackKind, PackedGrid, walk};
use vdb_core::reference::{Blocky, Occupied, Ray};
use vdb_core::synth::{Random, level_set, rays, sparse};
use vdb_core::tree::{CoordBox, Vdb543};

use vdb_probe::{Gpu, ProbeKind, ProbeRay};

use crate::{probe, ray_count};

/// A ray whose numbers are the same in lattice and in index coordinates, up to the half voxel
/// between the two: the fraction has 20 bits, so that adding ½ to it is exact in f32.
fn exact_ray(base: IVec3, origin: DVec3, dir: Vec3) -> (ProbeRay, Ray) {
    let steps = f64::from(1 << 20);
    let origin = (origin * steps).floor() / steps;
    let cell = origin.floor();
    let frac = (origin - cell).as_vec3();
    let cell = cell.as_ivec3();
    let probe = walk::Ray { cell, frac, dir, t_min: 0.0, t_max: 1e30 };
    // Voxel `ijk` is the lattice cell `ijk`, half a voxel towards lower coordinates in index space.
    (probe.into(), Ray::new(cell + base, frac - 0.5, dir))
}

fn random_rays(grid: &PackedGrid, seed: u64, count: usize) -> Vec<(ProbeRay, Ray)> {
    let mut random = Random::new(seed);
    let bounds = grid.occupied.unwrap();
    let center = (bounds.min + bounds.max).as_dvec3() * 0.5;
    let radius = (bounds.max - bounds.min).as_dvec3().length() * 0.5 + 1.0;
    let mut vector = || DVec3::from_array(std::array::from_fn(|_| random.range(-1.0, 1.0)));
    (0..count)
        .map(|_| {
            let origin = center + vector() * radius * 3.0;
            let target = center + vector() * radius * 0.6;
            exact_ray(grid.base, origin, (target - origin).as_vec3())
        })
        .collect()
}

/// Rays made to be hard, every fourth from far away.
fn hard_rays(grid: &PackedGrid, seed: u64, count: usize) -> Vec<(ProbeRay, Ray)> {
    let mut random = Random::new(seed);
    let bounds = grid.occupied.unwrap();
    let bbox = CoordBox { min: bounds.min + grid.base, max: bounds.max + grid.base };
    let mut hard = Vec::new();
    while hard.len() < count {
        let ray = match hard.len() % 4 {
            0 => rays::far(&mut random, bbox).map(|(ray, _)| ray),
            _ => Some(rays::adversarial(&mut random, bbox)),
        };
        let Some(ray) = ray else { continue };
        let Some(dir) = rays::normalized(ray.dir) else { continue };
        let ray = walk::Ray::from_index(grid, ray.cell, ray.frac, dir);
        let Some(cell) = ray.cell.checked_add(grid.base) else { continue };
        hard.push((ray.into(), Ray::new(cell, ray.frac - 0.5, ray.dir).flushed()));
    }
    hard
}

/// Compares each ray: the voxel and the face have to be the exact ones, without exception; `t` is
/// an f32 and may be off by what the walk says of it.
fn check(gpu: &Gpu, tree: &Vdb543<f32>, rays: &[(ProbeRay, Ray)], grid: &PackedGrid) {
    let probes: Vec<ProbeRay> = rays.iter().map(|(probe, _)| *probe).collect();
    let hits = probe(gpu, ProbeKind::Voxels, grid, &probes);
    let oracle = Blocky::new(tree, Occupied::BelowIso(0.0));
    let mut met = 0;
    for ((_, ray), hit) in rays.iter().zip(&hits) {
        let expected = oracle.first_voxel(&ray.with_span(0.0, 1e30));
        let found = (hit.hit != 0).then(|| (IVec3::from_array(hit.cell) + grid.base, hit.axis));
        let exact = expected.map(|hit| (hit.ijk, hit.face.map_or(3, |face| face.axis.into())));
        assert_eq!(found, exact, "{ray:?}");
        if let Some(expected) = expected {
            let error = (f64::from(hit.t) - expected.t).abs();
            assert!(
                error <= expected.t * f64::from(T_ERROR),
                "{ray:?}: t is {} for {expected:?}",
                hit.t
            );
            met += 1;
        }
    }
    println!("{} rays, {met} meet a voxel, none differs", rays.len());
    assert!(met * 10 > rays.len(), "hardly a ray met anything");
}

#[test]
fn level_sets_are_hit_where_the_reference_tracer_hits_them() {
    let Some(gpu) = Gpu::find() else { return };
    for (i, tree) in [
        level_set::sphere(DVec3::new(3.3, -200.7, 40.1), 30.3),
        level_set::torus(DVec3::splat(1_000_000.0), 40.0, 12.5),
        level_set::cuboid(DVec3::splat(-20.5), DVec3::new(30.0, 7.0, 15.0)),
        level_set::gyroid(DVec3::ZERO, 40.0, 18.0),
    ]
    .iter()
    .enumerate()
    {
        let grid = PackedGrid::new(tree, PackKind::Surface { iso: 0.0 }).unwrap();
        check(&gpu, tree, &random_rays(&grid, 11 + i as u64, ray_count(20_000)), &grid);
        check(&gpu, tree, &hard_rays(&grid, 21 + i as u64, ray_count(20_000)), &grid);
    }
}

#[test]
fn rays_along_axes_and_diagonals_end() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = level_set::sphere(DVec3::ZERO, 20.0);
    let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
    let mut along = Vec::new();
    for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE, Vec3::new(1.0, -1.0, 0.0)] {
        for dir in [axis, -axis] {
            for x in -6..6 {
                for y in -6..6 {
                    let across = dir.as_dvec3().any_orthonormal_pair();
                    let at = across.0 * f64::from(x) * 4.3 + across.1 * f64::from(y) * 4.3;
                    let local = -grid.base.as_dvec3();
                    along.push(exact_ray(grid.base, local + at - dir.as_dvec3() * 50.0, dir));
                }
            }
        }
    }
    check(&gpu, &tree, &along, &grid);
}

#[test]
fn the_crown_skips_two_million_voxels_in_a_few_steps() {
    let Some(gpu) = Gpu::find() else { return };
    let far = IVec3::new(2_000_000, 2_000_000, 2_000_000);
    let mut tree = Vdb543::new(1.0);
    tree.set(IVec3::ZERO, -1.0);
    tree.set(far, -1.0);
    let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
    let from = far.as_dvec3() - grid.base.as_dvec3() + DVec3::new(0.5, 0.5, -900.0);
    let (forward, _) = exact_ray(grid.base, from, Vec3::Z);
    let back = from + DVec3::new(0.0, 0.0, 2000.0);
    let (reverse, _) = exact_ray(grid.base, back, Vec3::new(-1.0, -1.0, -1.0));
    let hits = probe(&gpu, ProbeKind::Voxels, &grid, &[forward, reverse]);
    assert_eq!(IVec3::from_array(hits[0].cell) + grid.base, far);
    assert_eq!(hits[0].hit, 1);
    for hit in hits {
        assert!(hit.steps < 200, "{} steps", hit.steps);
    }
}

#[test]
fn sparse_voxels_are_found() {
    let Some(gpu) = Gpu::find() else { return };
    // Occupied below zero: the voxels of the synthetic grids are above, so they are turned over.
    let positive =
        sparse::random(CoordBox { min: IVec3::splat(-40), max: IVec3::splat(40) }, 0.01, 5);
    let mut tree = Vdb543::new(1.0);
    positive.active_values().for_each(|voxel| tree.set(voxel.origin, -1.0));
    let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
    check(&gpu, &tree, &random_rays(&grid, 3, ray_count(20_000)), &grid);
    check(&gpu, &tree, &hard_rays(&grid, 4, ray_count(20_000)), &grid);
}
