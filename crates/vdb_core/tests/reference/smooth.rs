//! The first root of the interpolant: against closed forms and dense sampling.

use glam::{DVec3, Vec3};
use vdb_core::{
    reference::{Ray, Smooth, first_root, trace_surface},
    synth::{self, Random},
    tree::{CoordBox, IVec3, Tree, Vdb543},
};

fn cube(min: i32, max: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) }
}

fn direction(random: &mut Random) -> DVec3 {
    loop {
        let v = DVec3::from_array([0; 3].map(|_| random.range(-1.0, 1.0)));
        if v.length() > 0.1 && v.length() <= 1.0 {
            return v.normalize();
        }
    }
}

/// The point of a ray in f64 from the ray's own f32 numbers.
fn origin(ray: &Ray) -> DVec3 {
    ray.cell.as_dvec3() + ray.frac.as_dvec3()
}

#[test]
fn a_linear_ramp_is_met_where_it_says() {
    // Dyadic, so that the samples are exact as f32 and the interpolant is the ramp.
    let (gradient, offset) = (DVec3::new(0.25, -0.5, 0.125), 0.375);
    let tree = synth::fog::ramp(cube(-30, 30), gradient, offset);
    let (mut random, mut hits) = (Random::new(1), 0);
    for _ in 0..2000 {
        let from = DVec3::from_array([0; 3].map(|_| random.range(-14.0, 14.0)));
        let ray = Ray::from_f64(from, direction(&mut random)).with_span(0.0, 14.0);
        let d = ray.dir.as_dvec3();
        let slope = gradient.dot(d);
        let t = -(offset + gradient.dot(origin(&ray))) / slope;
        let hit = first_root(&tree, 0.0, &ray);
        // Values are below 32 and M 2⁻⁴⁶ < 5e-13; a few roundings of the formula itself.
        let bound = 1e-12 / slope.abs();
        if t < -bound || t > 14.0 + bound {
            assert_eq!(hit, None, "{t}: {ray:?}");
        } else if t > bound && t < 14.0 - bound {
            let hit = hit.unwrap_or_else(|| panic!("missed at {t}: {ray:?}"));
            assert!((hit.t - t).abs() <= bound, "{} for {t}: {ray:?}", hit.t);
            assert!(hit.gradient.distance(gradient) < 1e-12);
            assert_eq!(hit.entering, slope < 0.0);
            hits += 1;
        }
    }
    assert!(hits > 300, "{hits}");
}

/// The second derivatives of a distance to a point at distance `r` are 0, 1/r and 1/r, so linear
/// interpolation along the three axes is off by at most a sum of eighths of them, `1 / (4 r)`
/// (P. Davis, "Interpolation and Approximation", section 3.1), and a partial derivative by half of
/// one, plus the change of slope in the other two axes, under `1/r²`.
#[test]
fn a_sphere_is_hit_within_the_error_of_interpolation() {
    let (center, radius) = (DVec3::new(0.3, -0.2, 0.45), 50.0);
    let tree = synth::level_set::sphere(center, radius);
    let smooth = Smooth::new(&tree, 0.0);
    // A cell at the surface reaches √3 inside; samples are rounded to f32.
    let near = radius - 2.0;
    let off = 0.25 / near + 2.0_f64.powi(-22);
    let tilt = 0.5 * 2.0_f64.sqrt() / near + 1.0 / (near * near);
    let (mut random, mut hits, mut misses) = (Random::new(2), 0, 0);
    for _ in 0..4000 {
        let from = center + direction(&mut random) * random.range(60.0, 200.0);
        let at = center + direction(&mut random) * random.range(0.0, 60.0);
        let ray = Ray::from_f64(from, (at - from).normalize());
        let to_center = center - origin(&ray);
        let d = ray.dir.as_dvec3().normalize();
        let closest = (to_center - d * to_center.dot(d)).length();
        match smooth.first_root(&ray) {
            Some(hit) => {
                let out = (hit.position - center).length();
                assert!((out - radius).abs() <= off, "{out}: {ray:?}");
                assert!(closest < radius + off);
                let normal = hit.normal().expect("a slope of about 1");
                let angle = normal.angle_between(hit.position - center);
                assert!(angle <= tilt, "{angle} > {tilt}: {ray:?}");
                // The near side of the sphere, unless the ray all but grazes.
                assert!(hit.entering);
                let before = (to_center.dot(d) - hit.t * ray.dir.as_dvec3().length()) / radius;
                assert!(before > 0.0 || closest > radius - 2.0 * off, "the far side: {ray:?}");
                hits += 1;
            }
            None => {
                assert!(closest > radius - off, "missed by {closest}: {ray:?}");
                misses += 1;
            }
        }
    }
    assert!(hits > 1000 && misses > 200, "{hits} {misses}");
}

#[test]
fn a_slab_in_both_directions() {
    // Faces between samples: distances beside a plane are linear, and dyadic here.
    let tree = synth::level_set::slab_x(-3.25, 8.5, cube(-20, 20));
    let check = |x: i32, dir: Vec3, expected: Option<(f64, DVec3, bool)>| {
        let ray = Ray::new(IVec3::new(x, 1, 2), Vec3::new(0.5, 0.25, 0.125), dir);
        let hit = first_root(&tree, 0.0, &ray);
        assert_eq!(hit.map(|hit| (hit.gradient, hit.entering)), expected.map(|e| (e.1, e.2)));
        if let (Some(hit), Some((x, ..))) = (hit, expected) {
            // The stated bound: 2⁻⁴⁶ of the largest sample, 3 at most, over a slope of 1.
            assert!((hit.position.x - x).abs() <= 3.0 * 2.0_f64.powi(-46), "{hit:?}");
        }
    };
    check(-10, Vec3::X, Some((-3.25, DVec3::NEG_X, true)));
    check(18, Vec3::NEG_X, Some((8.5, DVec3::X, true)));
    // From inside, out.
    check(0, Vec3::X, Some((8.5, DVec3::X, false)));
    check(18, Vec3::X, None);
}

/// The interpolant, written once more for the test, from `Tree::get` and nothing else.
fn interpolant(tree: &Vdb543<f32>, p: DVec3) -> f64 {
    let (cell, u) = (p.floor(), p - p.floor());
    (0..8).fold(0.0, |sum, corner| {
        let o = DVec3::new((corner >> 2) as f64, (corner >> 1 & 1) as f64, (corner & 1) as f64);
        let weight = (DVec3::ONE - o - u).abs();
        let value = tree.get((cell + o).as_ivec3());
        sum + weight.element_product() * f64::from(value)
    })
}

#[test]
fn no_root_is_missed_or_invented_in_noise() {
    // Random values of both signs: three roots in many cells.
    let noise = |ijk: IVec3| {
        let seed = (ijk.x * 7919 + ijk.y * 104_729 + ijk.z * 1_299_709) as u64;
        Random::new(seed).range(-1.0, 1.0) as f32
    };
    let tree = synth::fog::from_values(cube(-12, 12), noise);
    let (mut random, mut roots) = (Random::new(3), 0);
    for _ in 0..400 {
        let from = DVec3::from_array([0; 3].map(|_| random.range(-5.0, 5.0)));
        let ray = Ray::from_f64(from, direction(&mut random)).with_span(0.0, 6.0);
        let value = |t: f64| interpolant(&tree, origin(&ray) + t * ray.dir.as_dvec3());
        let trace = trace_surface(&tree, 0.0, &ray);
        let step = 1.0 / 2048.0;
        let sampled = (0..(6.0 / step) as u32)
            .map(|i| f64::from(i) * step)
            .find(|t| value(*t) * value(t + step) < 0.0);
        if let Some(sampled) = sampled {
            let hit = trace.hit.unwrap_or_else(|| panic!("missed at {sampled}: {ray:?}"));
            assert!(hit.t <= sampled + step, "{} after {sampled}: {ray:?}", hit.t);
        }
        if let Some(hit) = trace.hit {
            roots += 1;
            // A root it is: the signs differ on both sides, as entering says.
            let slope = hit.gradient.dot(ray.dir.as_dvec3());
            let beside = 1e-12 / slope.abs();
            assert!(value(hit.t - beside) * value(hit.t + beside) < 0.0, "{hit:?}: {ray:?}");
            assert_eq!(hit.entering, value(hit.t + beside) < 0.0);
            let missed = sampled.is_none_or(|sampled| hit.t < sampled);
            assert!(!missed || hit.depth < 1e-5, "sampling missed a deep root {hit:?}");
        }
    }
    assert!(roots > 350, "{roots}");
}

/// Samples of `x y - (x + y)/2 + 1/4 + lift`, which along `x = y` is `(x - 1/2)² + lift`.
fn parabola(lift: f64) -> Vdb543<f32> {
    synth::fog::from_values(cube(0, 1), |ijk| {
        let (x, y) = (f64::from(ijk.x), f64::from(ijk.y));
        (x * y - (x + y) / 2.0 + 0.25 + lift) as f32
    })
}

#[test]
fn near_double_roots_are_reported_as_such() {
    let lift = 2.0_f64.powi(-14);
    let ray =
        Ray::new(IVec3::ZERO, Vec3::splat(0.125), Vec3::new(1.0, 1.0, 0.0)).with_span(0.0, 0.75);
    let trace = |lift| trace_surface(&parabola(lift), 0.0, &ray);
    // Above: no root, a graze. Below: a root as deep as the parabola dips. A touch is no root.
    let above = trace(lift);
    assert_eq!(above.hit, None);
    let graze = above.graze.expect("it came close");
    assert!((graze.value - lift).abs() < 1e-15 && (graze.t - 0.375).abs() < 1e-12, "{graze:?}");
    let below = trace(-lift).hit.expect("it dips");
    assert!((below.t - (0.375 - lift.sqrt())).abs() < 1e-10, "{below:?}");
    assert!((below.depth - lift).abs() < 1e-15 && below.entering, "{below:?}");
    let touch = trace(0.0);
    assert_eq!(touch.hit, None);
    assert!(touch.graze.expect("it touched").value < 1e-15);
}

#[test]
fn a_deep_root_is_deep_and_has_no_graze_before_it() {
    let tree = synth::level_set::sphere(DVec3::ZERO, 30.0);
    let ray = Ray::new(IVec3::new(-60, 2, 3), Vec3::splat(0.25), Vec3::X);
    let trace = trace_surface(&tree, 0.0, &ray);
    assert!(trace.hit.is_some_and(|hit| hit.depth > 0.05), "{trace:?}");
    assert_eq!(trace.graze, None);
}

#[test]
fn samples_that_are_no_numbers_count_as_others() {
    let ray = Ray::new(IVec3::new(-8, 0, 0), Vec3::splat(0.5), Vec3::X).with_span(0.0, 15.0);
    for (odd, stands_for) in
        [(f32::NAN, 0.5), (f32::INFINITY, 1e30), (f32::NEG_INFINITY, -1e30), (f32::MAX, 1e30)]
    {
        let with = |value: f32| {
            let mut tree = synth::fog::ramp(cube(-10, 10), DVec3::X, 0.0);
            // The root at x = 1/2 lies in the cell from 0 to 1.
            tree.set(IVec3::new(1, 1, 1), value);
            first_root(&tree, 0.5, &ray).expect("a change of sign")
        };
        assert_eq!(with(odd), with(stands_for), "{odd}");
    }
}

/// Samples beside the surface so small that a cell's noise hides their sign: the change of sign is
/// found in the next cell then, though all its corners agree.
#[test]
fn a_root_within_the_noise_of_a_face_is_found() {
    let values = |x: i32| match x {
        ..=0 => 1.0,
        1 => -1e-20,
        _ => -1.0,
    };
    let tree = synth::fog::from_values(cube(-5, 5), |ijk| values(ijk.x));
    let ray = Ray::new(IVec3::new(-3, 0, 0), Vec3::splat(0.25), Vec3::X).with_span(0.0, 7.0);
    let hit = first_root(&tree, 0.0, &ray).expect("a change of sign");
    assert!((hit.position.x - 1.0).abs() <= 2.0_f64.powi(-46) && hit.entering, "{hit:?}");
}

#[test]
fn tiles_of_opposite_sign_meet_in_a_surface() {
    let mut tree: Vdb543<f32> = Tree::new(1.0);
    tree.insert_tile(IVec3::ZERO, -1.0, false);
    let ray = Ray::new(IVec3::new(-100_000, 50, 60), Vec3::splat(0.5), Vec3::X);
    let hit = first_root(&tree, 0.0, &ray).expect("the face between the tiles");
    // Between the samples -1 and 0.
    assert_eq!((hit.position.x, hit.cell.x, hit.entering), (-0.5, -1, true));
    assert_eq!(hit.gradient, DVec3::new(-2.0, 0.0, 0.0));
}

#[test]
fn far_away_and_shifted() {
    let (center, radius) = (IVec3::new(7, -3, 5), 20.0);
    let tree = synth::level_set::sphere(center.as_dvec3(), radius);
    let ray =
        Ray::new(IVec3::new(-40, 2, 0), Vec3::new(0.1, 0.7, 0.3), Vec3::new(1.0, -0.01, 0.02));
    let here = first_root(&tree, 0.0, &ray).expect("a hit");
    // From 10⁷ voxels away, along x, where t is exact: the same surface.
    let axis = Ray { dir: Vec3::X, ..ray };
    let near = first_root(&tree, 0.0, &axis).expect("a hit");
    let far = Ray { cell: ray.cell - IVec3::new(10_000_000, 0, 0), ..axis };
    let far = first_root(&tree, 0.0, &far).expect("a hit");
    assert!((far.t - 1e7 - near.t).abs() < 1e-8, "{} {}", far.t, near.t);
    assert_eq!(far.cell, near.cell);
    // Everything shifted by whole voxels: the same numbers, bit for bit.
    for shift in [IVec3::new(1 << 30, -(1 << 30), 8), IVec3::splat(-(1 << 24))] {
        let moved = synth::build(
            tree.background(),
            CoordBox { min: center + shift - 32, max: center + shift + 32 },
            |_| synth::Uniform::No,
            |ijk| tree.probe(ijk - shift),
        );
        let ray = Ray { cell: ray.cell + shift, ..ray };
        let there = first_root(&moved, 0.0, &ray).expect("a hit");
        assert_eq!((there.t, there.gradient), (here.t, here.gradient));
        assert_eq!((there.cell - shift, there.depth), (here.cell, here.depth));
    }
}
