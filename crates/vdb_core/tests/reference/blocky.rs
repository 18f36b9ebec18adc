//! The first voxel: exact on every ray.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use vdb_core::{
    reference::{Blocky, Face, Occupied, Ray, VoxelHit, first_voxel},
    synth::{self, Random, rays},
    tree::{CoordBox, IVec3, Vdb543},
};

use crate::brute;

fn cube(min: IVec3, edge: i32) -> CoordBox {
    CoordBox { min, max: min + (edge - 1) }
}

/// Places in index space: at the middle, astride node borders, and touching both ends.
fn places() -> Vec<IVec3> {
    let end = i32::MAX - 15;
    [0, -8, 10_000, -4104, 1 << 24, -(1 << 30), end, i32::MIN]
        .map(|c| IVec3::new(c, c, c))
        .into_iter()
        .chain([IVec3::new(i32::MIN, end, -8), IVec3::new(1 << 30, 0, -(1 << 24))])
        .collect()
}

/// Small grids of every kind, by place.
fn grids(at: IVec3) -> Vec<(&'static str, Vdb543<f32>, Occupied, CoordBox)> {
    let bbox = cube(at, 16);
    let voxel = at + IVec3::new(3, 9, 5);
    vec![
        ("sparse", synth::sparse::random(bbox, 0.02, 7), Occupied::Active, bbox),
        ("half full", synth::sparse::random(bbox, 0.4, 8), Occupied::Above(0.5), bbox),
        ("checkerboard", synth::sparse::checkerboard(bbox), Occupied::Active, bbox),
        ("shell", synth::sparse::box_shell(bbox), Occupied::Active, bbox),
        ("solid", synth::fog::block(bbox, 1.0), Occupied::Active, bbox),
        ("one voxel", synth::sparse::voxels(&[voxel]), Occupied::Active, CoordBox::voxel(voxel)),
        ("truss", synth::sparse::truss(bbox, 5, 1), Occupied::Active, bbox),
    ]
}

fn flat(hit: Option<VoxelHit>) -> Option<(IVec3, Option<(u8, i8)>)> {
    hit.map(|hit| (hit.ijk, hit.face.map(|face| (face.axis, face.sign))))
}

/// Rays per grid; more of them by `VDB_REFERENCE_RAYS`.
fn rays_per_case() -> usize {
    let asked = std::env::var("VDB_REFERENCE_RAYS").ok();
    asked.map_or(400, |rays| rays.parse().expect("VDB_REFERENCE_RAYS is a number"))
}

#[test]
fn agrees_with_brute_force_in_rationals() {
    let cases: Vec<_> = places().into_iter().flat_map(grids).collect();
    let hits: usize = cases
        .par_iter()
        .enumerate()
        .map(|(i, (name, tree, occupied, bbox))| {
            let blocky = Blocky::new(tree, *occupied);
            let mut random = Random::new(i as u64);
            let rays = (0..rays_per_case()).map(|_| rays::adversarial(&mut random, *bbox));
            rays.filter(|ray| {
                let expected = brute::first_voxel(tree, *occupied, ray, *bbox);
                assert_eq!(flat(blocky.first_voxel(ray)), expected, "{name} case {i}: {ray:?}");
                expected.is_some()
            })
            .count()
        })
        .sum();
    // The rays are worth something: plenty hit and plenty miss.
    let rays = rays_per_case() * cases.len();
    println!("{rays} adversarial rays, {hits} hits, no difference");
    assert!(hits > rays / 4 && hits < rays * 3 / 4, "{hits} of {rays} hit");
}

/// From so far away that f64 does not see which side of a corner the ray passes. The brute force
/// begins 40 voxels before the middle of it all, outside of the box; the tracer at the ray's origin.
#[test]
fn agrees_with_brute_force_from_afar() {
    let cases: Vec<_> = places().into_iter().flat_map(grids).collect();
    let (rays, hits) = cases
        .par_iter()
        .enumerate()
        .map(|(i, (name, tree, occupied, bbox))| {
            let blocky = Blocky::new(tree, *occupied);
            let mut random = Random::new(i as u64);
            let (mut rays, mut hits) = (0, 0);
            for _ in 0..rays_per_case() {
                let Some((ray, n)) = rays::far(&mut random, *bbox) else { continue };
                let fastest = ray.dir.abs().max_element();
                if fastest > 0.0 {
                    let near = ray.with_span(n - (40.0 / fastest).ceil(), f32::INFINITY);
                    let expected = brute::first_voxel(tree, *occupied, &near, *bbox);
                    assert_eq!(
                        flat(blocky.first_voxel(&ray)),
                        expected,
                        "{name} case {i}: {ray:?}"
                    );
                    (rays, hits) = (rays + 1, hits + usize::from(expected.is_some()));
                }
            }
            (rays, hits)
        })
        .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    println!("{rays} rays from afar, {hits} hits, no difference");
    // At the ends of index space many would begin beyond it and are not made.
    assert!(rays > rays_per_case() * cases.len() / 2, "{rays}");
    assert!(hits > rays / 4 && hits < rays * 3 / 4, "{hits} of {rays} hit");
}

/// Independent of any order of stepping: no occupied voxel whose inside the ray passes comes
/// before the hit, and the ray does touch the voxel that it is said to hit.
#[test]
fn skips_nothing_and_invents_nothing() {
    let bbox = cube(IVec3::new(-5, -8, 1 << 24), 12);
    let tree = synth::sparse::random(bbox, 0.05, 3);
    let voxels: Vec<IVec3> = tree.active_values().map(|value| value.origin).collect();
    (0..8_u64).into_par_iter().for_each(|seed| {
        let mut random = Random::new(100 + seed);
        for _ in 0..250 {
            let ray = rays::adversarial(&mut random, bbox);
            if !ray.is_valid() {
                continue;
            }
            let exact = brute::Exact::new(&ray);
            let hit = first_voxel(&tree, Occupied::Active, &ray);
            let entry = hit.map(|hit| {
                let [enter, _] = exact.interval(hit.ijk).expect("the ray touches what it hits");
                enter
            });
            for voxel in &voxels {
                if let Some([enter, leave]) = exact.interval(*voxel)
                    && brute::less(&enter, &leave)
                    && passes_inside(&ray, *voxel)
                {
                    let entry = entry.as_ref().unwrap_or_else(|| panic!("{voxel} missed: {ray:?}"));
                    assert!(!brute::less(&enter, entry), "{voxel} before {hit:?}: {ray:?}");
                }
            }
        }
    });
}

/// Whether a ray that overlaps a voxel's closed box is not one that runs in a face of it.
fn passes_inside(ray: &Ray, voxel: IVec3) -> bool {
    (0..3).all(|a| {
        let in_face = |half: f32| ray.frac[a] == half + (voxel[a] - ray.cell[a]) as f32;
        ray.dir[a] != 0.0 || !(in_face(0.5) || in_face(-0.5))
    })
}

#[test]
fn ties_are_crossed_in_the_order_of_the_axes() {
    let dir = Vec3::ONE;
    let from_origin = |voxels: &[IVec3], dir: Vec3| {
        let tree = synth::sparse::voxels(voxels);
        flat(first_voxel(&tree, Occupied::Active, &Ray::new(IVec3::ZERO, Vec3::ZERO, dir)))
    };
    // Through the corner (1/2, 1/2, 1/2): x first, then y, then z.
    let path = [IVec3::new(1, 0, 0), IVec3::new(1, 1, 0), IVec3::new(1, 1, 1)];
    for (i, voxel) in path.into_iter().enumerate() {
        let face = Some((i as u8, -1));
        assert_eq!(from_origin(&path[i..], dir), Some((voxel, face)));
        assert_eq!(
            from_origin(&path[i..].iter().map(|v| -v).collect::<Vec<_>>(), -dir),
            Some((-voxel, Some((i as u8, 1))))
        );
    }
    // The other voxels around the corner are not on the way.
    let beside =
        [IVec3::new(0, 1, 0), IVec3::new(0, 0, 1), IVec3::new(0, 1, 1), IVec3::new(1, 0, 1)];
    assert_eq!(from_origin(&beside, dir), None);
}

#[test]
fn a_face_belongs_to_the_voxel_above() {
    let tree = synth::sparse::voxels(&[IVec3::ZERO]);
    let along_x = |y: f32| {
        let ray = Ray::new(IVec3::new(-5, 0, 0), Vec3::new(0.0, y, 0.0), Vec3::X);
        first_voxel(&tree, Occupied::Active, &ray).is_some()
    };
    assert!(along_x(-0.5), "in the lower face");
    assert!(!along_x(0.5), "in the upper face");
    assert!(along_x(0.5_f32.next_down()));
    assert!(!along_x((-0.5_f32).next_down()));
}

#[test]
fn far_apart_and_at_the_ends_of_index_space() {
    let (low, high) = (IVec3::splat(i32::MIN), IVec3::splat(i32::MAX));
    let near = IVec3::new(-1_000_000, 3, 5);
    let tree = synth::sparse::voxels(&[near, IVec3::new(1_000_000, 3, 5), low, high]);
    let hit = |cell: IVec3, dir: Vec3| {
        flat(first_voxel(&tree, Occupied::Active, &Ray::new(cell, Vec3::ZERO, dir)))
    };
    let x = |x: i32| IVec3::new(x, 3, 5);
    assert_eq!(hit(x(-999_999), Vec3::X), Some((x(1_000_000), Some((0, -1)))));
    assert_eq!(hit(x(999_999), Vec3::NEG_X), Some((near, Some((0, 1)))));
    assert_eq!(hit(x(1_000_001), Vec3::X), None);
    assert_eq!(hit(x(i32::MAX), Vec3::NEG_X), Some((x(1_000_000), Some((0, 1)))));
    assert_eq!(hit(high - 1, Vec3::ONE), Some((high, Some((2, -1)))));
    assert_eq!(hit(low + 1, Vec3::NEG_ONE), Some((low, Some((2, 1)))));
    // From one end to the other, along the diagonal of everything.
    assert_eq!(hit(low + 1, Vec3::ONE), Some((high, Some((2, -1)))));
    assert_eq!(hit(high, Vec3::ONE), Some((high, None)));
    // The slightest tilt: 2⁻³⁰ over two million voxels is 0.002 voxels, over 2³¹ two voxels.
    let tilt = Vec3::new(1.0, 2.0_f32.powi(-30), 0.0);
    assert_eq!(hit(x(-999_999), tilt), Some((x(1_000_000), Some((0, -1)))));
    assert_eq!(hit(x(i32::MIN), Vec3::new(1.0, 2.0_f32.powi(-30), 0.0)), None);
}

#[test]
fn rays_that_are_none_hit_nothing() {
    let tree = synth::fog::block(cube(IVec3::splat(-8), 16), 1.0);
    let ray = Ray::new(IVec3::ZERO, Vec3::ZERO, Vec3::X);
    let hit = |ray: Ray| first_voxel(&tree, Occupied::Active, &ray);
    assert!(hit(ray).is_some_and(|hit| hit.face.is_none() && hit.t == 0.0));
    assert!(hit(Ray { dir: Vec3::ZERO, ..ray }).is_none());
    for (size, meets) in [(-30, true), (30, true), (-31, false), (31, false)] {
        let dir = Vec3::new(0.0, -2.0_f32.powi(size), 2.0_f32.powi(-60));
        assert_eq!(hit(Ray { dir, ..ray }).is_some(), meets, "2^{size}");
    }
    assert!(hit(Ray { dir: Vec3::new(f32::NAN, 0.0, 0.0), ..ray }).is_none());
    assert!(hit(Ray { frac: Vec3::new(f32::INFINITY, 0.0, 0.0), ..ray }).is_none());
    assert!(hit(ray.with_span(1.0, 0.0)).is_none());
    assert!(hit(ray.with_span(f32::NAN, 1.0)).is_none());
    // There is nothing of a ray behind its origin.
    let behind =
        Ray::new(IVec3::new(-9, 0, 0), Vec3::ZERO, Vec3::X).with_span(-1e30, f32::INFINITY);
    let face = Face { axis: 0, sign: -1 };
    assert_eq!(hit(behind), Some(VoxelHit { ijk: IVec3::new(-8, 0, 0), face: Some(face), t: 0.5 }));
    assert!(hit(Ray { cell: IVec3::new(8, 0, 0), ..behind }).is_none());
    assert!(hit(ray.with_span(-2.0, -1.0)).is_none());
    assert!(hit(ray.with_span(-1.0, 0.0)).is_some());
}

#[test]
fn occupied_by_level_set_background_and_threshold() {
    let sphere = synth::level_set::sphere(DVec3::ZERO, 20.0);
    let inside = Ray::new(IVec3::ZERO, Vec3::ZERO, Vec3::X);
    // The interior is an inactive tile: solid for a level set, empty by activity.
    let hit = |rule| first_voxel(&sphere, rule, &inside).expect("something");
    assert_eq!(hit(Occupied::BelowIso(0.0)).ijk, IVec3::ZERO);
    assert_eq!(hit(Occupied::Active).ijk, IVec3::new(18, 0, 0));
    // An occupied background fills what the root has of the index space, and nothing beyond.
    let inward = Ray::new(IVec3::new(0, 0, i32::MAX), Vec3::ZERO, Vec3::NEG_Z);
    let hit = first_voxel(&sphere, Occupied::Above(1.0), &inward).expect("the last voxel");
    assert_eq!((hit.ijk.z, hit.face), (4095, Some(Face { axis: 2, sign: 1 })));
    assert!(first_voxel(&sphere, Occupied::Above(1.0), &Ray { dir: Vec3::Z, ..inward }).is_none());
}

#[test]
fn shifting_grid_and_ray_changes_nothing() {
    let bbox = cube(IVec3::splat(-9), 16);
    let tree = synth::sparse::random(bbox, 0.03, 5);
    let voxels: Vec<IVec3> = tree.active_values().map(|value| value.origin).collect();
    for shift in [IVec3::splat(1 << 30), IVec3::new(-(1 << 30), 12_345, 1 << 24)] {
        let shifted: Vec<IVec3> = voxels.iter().map(|v| v + shift).collect();
        let shifted = synth::sparse::voxels(&shifted);
        let mut random = Random::new(11);
        for _ in 0..2000 {
            let ray = rays::adversarial(&mut random, bbox);
            let here = first_voxel(&tree, Occupied::Active, &ray);
            let there = Ray { cell: ray.cell + shift, ..ray };
            let there = first_voxel(&shifted, Occupied::Active, &there);
            let back = there.map(|hit| VoxelHit { ijk: hit.ijk - shift, ..hit });
            assert_eq!(here, back, "{ray:?}");
        }
    }
}
