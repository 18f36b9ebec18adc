//! Optical depth and transmittance: against closed forms, and within their own bounds.

use glam::{DVec3, Vec3};
use vdb_core::{
    reference::{Estimate, Ray, density, optical_depth, optical_depth_nearest, transmittance},
    synth::{self, Random},
    tree::{CoordBox, IVec3, Tree, Vdb543},
};

fn cube(min: i32, max: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) }
}

fn random_ray(random: &mut Random, reach: f64) -> Ray {
    let mut point = || DVec3::from_array([0; 3].map(|_| random.range(-reach, reach)));
    let (from, at) = (point(), point());
    Ray::from_f64(from, (at - from) / 8.0)
}

fn origin(ray: &Ray) -> DVec3 {
    ray.cell.as_dvec3() + ray.frac.as_dvec3()
}

/// The estimate is right within its own bound and `formula` (the rounding of the closed form), and
/// the bound is worth something.
#[track_caller]
fn agrees(estimate: Estimate, exact: f64, formula: f64) {
    let off = (estimate.value - exact).abs();
    assert!(off <= estimate.error + formula, "{estimate:?} for {exact}: off by {off:e}");
    assert!(estimate.error <= 1e-9 * exact.abs().max(1e-9), "a bound of nothing: {estimate:?}");
}

#[test]
fn along_an_axis_a_block_is_as_long_as_its_voxels() {
    // Tiles of two levels and voxels; the ramps of half a voxel on both ends add up to one.
    let tree = synth::fog::block(cube(-9, 128), 0.75);
    for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X] {
        let from = IVec3::splat(20) - 1000 * axis.as_ivec3();
        let ray = Ray::new(from, Vec3::splat(0.25), axis).with_span(0.0, 1e4);
        agrees(optical_depth(&tree, &ray), 0.75 * 138.0, 0.0);
        agrees(optical_depth_nearest(&tree, &ray), 0.75 * 138.0, 0.0);
        let twice = Ray { dir: 2.0 * axis, ..ray };
        agrees(optical_depth(&tree, &twice), 0.75 * 69.0, 0.0);
        agrees(transmittance(&tree, &ray, 0.01), (-0.01 * 0.75 * 138.0_f64).exp(), 1e-16);
    }
}

/// A block of density 1 from `a` to `b` interpolates to a product of three trapezoids: 1 between
/// the outermost samples, 0 a voxel beyond. On each piece of the ray between their bends the product
/// is a cubic, which Gauss's rule with two points integrates exactly.
#[test]
fn across_a_block_in_any_direction() {
    let (a, b) = (-9.0, 20.0);
    let tree = synth::fog::block(cube(-9, 20), 1.0);
    let mut random = Random::new(1);
    for _ in 0..500 {
        let ray = random_ray(&mut random, 40.0).with_span(0.0, 20.0);
        let (o, d) = (origin(&ray), ray.dir.as_dvec3());
        let density = |t: f64| {
            let p = o + t * d;
            p.to_array().map(|c| (c - a + 1.0).min(b + 1.0 - c).clamp(0.0, 1.0)).iter().product()
        };
        let mut bends = vec![0.0, 20.0];
        for axis in 0..3 {
            bends.extend(
                [a - 1.0, a, b, b + 1.0].map(|c| ((c - o[axis]) / d[axis]).clamp(0.0, 20.0)),
            );
        }
        bends.sort_by(f64::total_cmp);
        let exact: f64 = bends
            .windows(2)
            .map(|t| {
                let (mid, half) = (0.5 * (t[0] + t[1]), 0.5 * (t[1] - t[0]));
                let at = |x: f64| -> f64 { density(mid + x * half) };
                half * (at(-1.0 / 3.0_f64.sqrt()) + at(1.0 / 3.0_f64.sqrt()))
            })
            .sum();
        agrees(optical_depth(&tree, &ray), exact, 1e-12);
    }
}

#[test]
fn a_linear_ramp_integrates_to_its_mean() {
    // Dyadic and positive, so that samples are exact.
    let (gradient, offset) = (DVec3::new(0.25, -0.5, 0.125), 64.0);
    let tree = synth::fog::ramp(cube(-30, 30), gradient, offset);
    let mut random = Random::new(2);
    for _ in 0..500 {
        let ray = random_ray(&mut random, 14.0).with_span(0.0, 8.0);
        let mid = origin(&ray) + 4.0 * ray.dir.as_dvec3();
        agrees(optical_depth(&tree, &ray), 8.0 * (offset + gradient.dot(mid)), 1e-12);
    }
}

#[test]
fn every_voxel_counts_once() {
    let noise = |ijk: IVec3| {
        let seed = (ijk.x * 7919 + ijk.y * 104_729 + ijk.z * 1_299_709) as u64;
        Random::new(seed).unit() as f32
    };
    let bbox = cube(-6, 9);
    let tree = synth::fog::from_values(bbox, noise);
    let mut random = Random::new(3);
    for _ in 0..200 {
        let ray = random_ray(&mut random, 14.0).with_span(0.0, 8.0);
        let (o, d) = (origin(&ray), ray.dir.as_dvec3());
        // Voxel after voxel: density times length inside, by slabs.
        let exact: f64 = tree
            .active_values()
            .map(|voxel| {
                let (mut from, mut to) = (0.0_f64, 8.0_f64);
                for axis in 0..3 {
                    let middle = f64::from(voxel.origin[axis]) - o[axis];
                    let (a, b) = ((middle - 0.5) / d[axis], (middle + 0.5) / d[axis]);
                    (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
                }
                f64::from(voxel.value) * (to - from).max(0.0)
            })
            .sum();
        agrees(optical_depth_nearest(&tree, &ray), exact, 1e-12);
    }
}

/// The interpolant, written once more for the test, over midpoints of a fine subdivision.
#[test]
fn a_soft_ball_agrees_with_many_samples() {
    let tree = synth::fog::sphere(DVec3::new(0.2, 0.3, -0.1), 12.0, 5.0);
    let interpolant = |p: DVec3| {
        (0..8).fold(0.0, |sum, corner| {
            let o = DVec3::new((corner >> 2) as f64, (corner >> 1 & 1) as f64, (corner & 1) as f64);
            let weight = (DVec3::ONE - o - (p - p.floor())).abs().element_product();
            sum + weight * f64::from(tree.get((p.floor() + o).as_ivec3()))
        })
    };
    let mut random = Random::new(4);
    for _ in 0..20 {
        let ray = random_ray(&mut random, 14.0).with_span(0.0, 8.0);
        let n = 20_000;
        let step = 8.0 / f64::from(n);
        let at =
            |i: i32| interpolant(origin(&ray) + (f64::from(i) + 0.5) * step * ray.dir.as_dvec3());
        let sampled: f64 = (0..n).map(at).sum::<f64>() * step;
        // The midpoint rule: a slope below 2 |dir| that jumps at each of under 200 faces.
        let bound = 200.0 * 2.0 * ray.dir.as_dvec3().length() * step * step;
        let depth = optical_depth(&tree, &ray);
        assert!((depth.value - sampled).abs() <= bound, "{depth:?} {sampled} {bound}");
    }
}

fn homogeneous(value: f32) -> Vdb543<f32> {
    synth::fog::block(cube(-64, 63), value)
}

#[test]
fn densities_at_the_extremes() {
    let ray = Ray::new(IVec3::new(-80, 1, 2), Vec3::splat(0.5), Vec3::X);
    for value in [1e-45, 1e-30, 1.0, 1e20, 1e30] {
        let exact = 128.0 * f64::from(value);
        let depth = optical_depth(&homogeneous(value), &ray);
        assert!((depth.value - exact).abs() <= depth.error, "{value}: {depth:?}");
        assert!(depth.error <= 1e-12 * exact);
    }
    // No density at all: negative and NaN. All that is above 10³⁰ is 10³⁰.
    for value in [0.0, -0.0, -1.0, f32::NAN, f32::NEG_INFINITY] {
        assert_eq!(optical_depth(&homogeneous(value), &ray), Estimate::default(), "{value}");
        assert_eq!(density(value), 0.0);
    }
    let greatest = optical_depth(&homogeneous(1e30), &ray);
    for value in [f32::MAX, f32::INFINITY] {
        assert_eq!(optical_depth(&homogeneous(value), &ray), greatest, "{value}");
    }
}

#[test]
fn optical_depths_from_1e_minus_9_to_1e9() {
    let tree = homogeneous(1.0);
    let ray = Ray::new(IVec3::new(-80, 1, 2), Vec3::splat(0.5), Vec3::X);
    for power in -9..=9 {
        let depth = 10.0_f64.powi(power);
        let passed = transmittance(&tree, &ray, depth / 128.0);
        let exact = (-depth).exp();
        assert!((passed.value - exact).abs() <= passed.error, "{depth}: {passed:?} {exact}");
        assert!(passed.error < 1e-12, "{depth}: {passed:?}");
    }
    // An extinction of nothing, and a ray without end in a background that absorbs.
    assert_eq!(transmittance(&tree, &ray, 0.0).value, 1.0);
    let everywhere: Vdb543<f32> = Tree::new(1e-9);
    assert_eq!(transmittance(&everywhere, &ray, 1.0), Estimate { value: 0.0, error: 0.0 });
    assert_eq!(transmittance(&everywhere, &ray, 0.0).value, 1.0);
}

#[test]
fn shifting_grid_and_ray_changes_nothing() {
    let center = IVec3::new(1, -2, 3);
    let tree = synth::fog::sphere(center.as_dvec3(), 20.0, 8.0);
    let ray = Ray::new(IVec3::new(-30, 3, 1), Vec3::new(0.3, 0.6, 0.9), Vec3::new(1.0, -0.1, 0.02));
    for shift in [IVec3::splat(1 << 30), IVec3::new(-(1 << 30), 4097, -(1 << 24))] {
        let moved = synth::build(
            0.0,
            CoordBox { min: center + shift - 32, max: center + shift + 32 },
            |_| synth::Uniform::No,
            |ijk| tree.probe(ijk - shift),
        );
        let there = Ray { cell: ray.cell + shift, ..ray };
        assert_eq!(
            optical_depth_nearest(&moved, &there).value,
            optical_depth_nearest(&tree, &ray).value
        );
        // Cells in a tile here may be cells of a leaf there, so sums may round in another order.
        let (here, there) = (optical_depth(&tree, &ray), optical_depth(&moved, &there));
        assert!((here.value - there.value).abs() <= here.error + there.error);
        assert!(here.error < 1e-12);
    }
}
