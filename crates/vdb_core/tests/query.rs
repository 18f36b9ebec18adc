//! Rays and points as games ask about them, against the exact reference tracer.

use std::ops::ControlFlow;

use glam::DVec3;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::query::{GridQuery, IndexHit, IndexRay};
use vdb_core::reference::{Blocky, Fog, Occupied, Ray, Smooth, SurfaceVerdict};
use vdb_core::synth::{Random, fog, level_set, sparse};
use vdb_core::tree::{CoordBox, IVec3, Vdb543};

const SURFACE: PackKind = PackKind::Surface { iso: 0.0 };
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

fn bounds(grid: &PackedGrid) -> CoordBox {
    let cells = grid.occupied.unwrap();
    CoordBox { min: cells.min + grid.base, max: cells.max + grid.base }
}

/// The very ray of the reference tracer.
fn index_ray(ray: &Ray) -> IndexRay {
    IndexRay { origin: ray.at(0.0), dir: ray.dir.as_dvec3(), t_max: ray.t_max.into() }
}

/// A ray from around a box through a point in it. Of numbers that both tracers have without rounding:
/// an origin in units of 2⁻²⁰ of a voxel, and a direction whose largest component is 1.
fn aimed(random: &mut Random, bbox: CoordBox, away: f64) -> Ray {
    let (low, size) = (bbox.min.as_dvec3(), (bbox.max - bbox.min).as_dvec3());
    let mut point = |size: DVec3| DVec3::new(random.unit(), random.unit(), random.unit()) * size;
    let target = low + point(size);
    let side = (point(DVec3::splat(2.0)) - 1.0).normalize();
    let origin = target + side * away;
    let origin = (origin * f64::from(1 << 20)).round() / f64::from(1 << 20);
    let dir = ((target - origin) / (target - origin).abs().max_element()).as_vec3();
    Ray::from_f64(origin, dir.as_dvec3())
}

fn check_voxels(tree: &Vdb543<f32>, seed: u64) {
    let grid = PackedGrid::new(tree, SURFACE).unwrap();
    let (query, oracle) = (GridQuery::new(tree, &grid), Blocky::new(tree, Occupied::BelowIso(0.0)));
    let mut random = Random::new(seed);
    let (mut met, mut inside) = (0, 0);
    for _ in 0..20_000 {
        // In the box and close to it rays are not rounded.
        let ray = aimed(&mut random, bounds(&grid), 0.9);
        let found = query.first_hit(&index_ray(&ray), 0.0);
        let Some(expected) = oracle.first_voxel(&ray) else {
            assert_eq!(found, None, "{ray:?}");
            continue;
        };
        met += 1;
        inside += usize::from(expected.face.is_none());
        let hit = found.unwrap_or_else(|| panic!("{ray:?} misses {expected:?}"));
        assert_eq!(hit.ijk, expected.ijk, "{ray:?}");
        assert_eq!(hit.begins_inside, expected.face.is_none(), "{ray:?}");
        assert!((hit.t - expected.t).abs() < 1e-9, "{} for {}: {ray:?}", hit.t, expected.t);
        if let Some(face) = expected.face {
            let axis = usize::from(face.axis);
            let mut normal = DVec3::ZERO;
            normal[axis] = -f64::from(ray.dir[axis].signum());
            assert_eq!(hit.normal, normal, "{ray:?}");
        }
    }
    println!("{met} of 20,000 rays meet a voxel, {inside} begin in one, none differs");
    assert!(met > 1000, "{met}");
}

#[test]
fn voxels_and_faces_are_those_of_the_reference_tracer() {
    check_voxels(&level_set::torus(DVec3::splat(0.4), 22.0, 8.5), 1);
    check_voxels(&level_set::gyroid(DVec3::new(-4e5, 7.0, 3e4), 30.0, 14.0), 2);
    let mut dots = Vdb543::new(1.0);
    let cube = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) };
    sparse::random(cube, 0.05, 5).active_values().for_each(|at| dots.set(at.origin, -1.0));
    check_voxels(&dots, 3);
}

/// From far away a ray is rounded where it comes into the box: it still meets a face of a solid voxel,
/// where that is, and hardly ever another voxel than the ray without rounding.
#[test]
fn rays_from_a_hundred_million_voxels_away() {
    let tree = level_set::torus(DVec3::new(1e6, 0.3, -2e6), 30.0, 11.0);
    let grid = PackedGrid::new(&tree, SURFACE).unwrap();
    let (query, oracle) =
        (GridQuery::new(&tree, &grid), Blocky::new(&tree, Occupied::BelowIso(0.0)));
    let mut random = Random::new(4);
    let (mut met, mut differ, mut worst) = (0, 0, 0.0_f64);
    for _ in 0..20_000 {
        let ray = aimed(&mut random, bounds(&grid), 1e8);
        let (found, expected) = (query.first_hit(&index_ray(&ray), 0.0), oracle.first_voxel(&ray));
        if let Some(hit) = found {
            met += 1;
            assert!(tree.get(hit.ijk) < 0.0);
            // f64 has 2⁻²⁷ of a voxel left there, and the walk rounds to 2⁻²⁴ of its way, of 90.
            let off = (index_ray(&ray).at(hit.t) - hit.ijk.as_dvec3()).abs();
            let axis = hit.normal.abs().max_position();
            assert!((off[axis] - 0.5).abs() < 1e-6, "{off} from {}", hit.ijk);
            worst = worst.max(off.max_element() - 0.5);
        }
        differ += usize::from(found.map(|hit| hit.ijk) != expected.map(|hit| hit.ijk));
    }
    println!("{met} of 20,000 rays meet a voxel, {differ} another one, {worst:.1e} beside its box");
    assert!(met > 5000, "{met}");
    assert!(worst < 1e-5, "{worst} beside the voxel");
    assert!(differ * 10_000 < met, "{differ} of {met}");
}

#[test]
fn smooth_surfaces_are_where_the_reference_tracer_sees_them() {
    let mut random = Random::new(5);
    for (tree, away) in [
        (level_set::torus(DVec3::splat(0.4), 22.0, 8.5), 0.9),
        (level_set::gyroid(DVec3::new(-4e5, 7.0, 3e4), 30.0, 14.0), 100.0),
        (level_set::gyroid(DVec3::ZERO, 30.0, 14.0), 1e7),
    ] {
        let grid = PackedGrid::new(&tree, SMOOTH).unwrap();
        let (query, oracle) = (GridQuery::new(&tree, &grid), Smooth::new(&tree, 0.0));
        let (mut met, mut near, mut worst, mut turned) = (0, 0, 0.0_f64, 0.0_f64);
        for _ in 0..10_000 {
            let ray = aimed(&mut random, bounds(&grid), away);
            let found = query.first_hit(&index_ray(&ray), 0.0);
            // Rounded to 2⁻²⁴ of the way through the box, the ray sees values that differ by as much.
            let noise = 90.0 / f64::from(1 << 24);
            let (verdict, truth) = oracle.judge_within(&ray, found.map(|hit| hit.t), noise, 0.5);
            match verdict {
                SurfaceVerdict::Off(off) => {
                    met += 1;
                    worst = worst.max(off);
                    let (hit, truth) = (found.unwrap(), truth.unwrap());
                    let (a, b) = (hit.normal.normalize(), truth.normal().unwrap());
                    // Of the next cell, where the root is in the face between two.
                    let inner =
                        (truth.position - truth.position.round()).abs().min_element() > 1e-4;
                    turned = if inner { turned.max((a - b).length()) } else { turned };
                    let voxel = (truth.position - hit.ijk.as_dvec3()).abs().max_element();
                    assert!(voxel < 0.5 + 1e-3, "{} is not around {}", hit.ijk, truth.position);
                }
                SurfaceVerdict::NearDouble => near += 1,
                SurfaceVerdict::BothMiss => {}
                wrong => panic!("{wrong:?}: {ray:?}"),
            }
        }
        println!(
            "from {away}: {met} of 10,000 rays meet a surface, off by {worst:.1e} voxels, normals by \
             {turned:.1e}; {near} graze one"
        );
        assert!(met > 3000, "{met}");
        assert!(near * 500 < met, "{near} of {met} graze");
        assert!(worst < 1e-3, "{worst} voxels");
        assert!(turned < 1e-3, "normals off by {turned}");
    }
}

/// A ball, a block of tiles of several levels, and voxels of all kinds of neighbours.
fn fogs() -> [Vdb543<f32>; 3] {
    let cube = |min, max| CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) };
    [
        fog::sphere(DVec3::new(0.3, 0.1, -5.0), 40.0, 12.0),
        fog::block(cube(-128, 255), 0.25),
        fog::from_values(cube(-20, 20), |at| ((at.x * 7 + at.y * 3 + at.z) % 5 - 1) as f32),
    ]
}

#[test]
fn fog_is_met_where_the_optical_depth_is_reached() {
    let mut random = Random::new(6);
    for tree in fogs() {
        let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let (query, oracle) = (GridQuery::new(&tree, &grid), Fog::new(&tree));
        let (mut met, mut through) = (0, 0);
        for i in 0..3_000 {
            let away = if i % 2 == 0 { 0.9 } else { 300.0 };
            let ray = aimed(&mut random, bounds(&grid), away);
            let enough = 60.0 * random.unit();
            let depth = |t: f64| oracle.optical_depth(&ray.with_span(0.0, t as f32)).value;
            match query.first_hit(&index_ray(&ray), enough) {
                Some(hit) => {
                    met += 1;
                    let found = depth(hit.t);
                    // The span of the reference's ray ends at an f32.
                    assert!((found - enough).abs() < 1e-3, "{found}, not {enough}: {ray:?}");
                }
                None => {
                    through += 1;
                    let all = depth(f64::INFINITY);
                    assert!(all < enough * (1.0 + 1e-5), "{all} of {enough}: {ray:?}");
                }
            }
        }
        println!("{met} rays meet the fog, {through} pass through");
        assert!(met > 300 && through > 300, "{met} and {through}");
    }
}

#[test]
fn the_parts_of_a_ray_in_fog_add_up_to_its_depth() {
    let mut random = Random::new(9);
    for tree in fogs() {
        let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let oracle = Fog::new(&tree);
        for i in 0..1_000 {
            let ray = aimed(&mut random, bounds(&grid), if i % 2 == 0 { 0.9 } else { 300.0 });
            let end =
                if i % 3 == 0 { f64::INFINITY } else { f64::from(310.0 * random.unit() as f32) };
            let expected = oracle.optical_depth(&ray.with_span(0.0, end as f32)).value;
            for query in [GridQuery::new(&tree, &grid), GridQuery::of_packed(&grid)] {
                let (mut sum, mut before) = (0.0, 0.0);
                query.visit_fog(&IndexRay { t_max: end, ..index_ray(&ray) }, |[from, to], mean| {
                    assert!(from >= before - 1e-9 && to > from && to <= end && mean > 0.0);
                    before = to;
                    sum += (to - from) * mean;
                    ControlFlow::Continue(())
                });
                // The direction of the traversal has 24 bits.
                assert!((sum - expected).abs() < 1e-3, "{sum}, not {expected}: {ray:?}, {end}");
            }
        }
    }
    let ball = level_set::sphere(DVec3::ZERO, 10.0);
    let grid = PackedGrid::new(&ball, SMOOTH).unwrap();
    let ray = IndexRay { origin: DVec3::X * -50.0, dir: DVec3::X, t_max: f64::INFINITY };
    GridQuery::new(&ball, &grid).visit_fog(&ray, |_, _| panic!("a surface has no fog"));
}

#[test]
fn smooth_gradients_have_no_jumps_and_are_those_of_a_ball() {
    let (center, radius) = (DVec3::new(0.3, -7.1, 2.0), 21.4);
    let tree = level_set::sphere(center, radius);
    let grid = PackedGrid::new(&tree, SMOOTH).unwrap();
    let query = GridQuery::new(&tree, &grid);
    let mut random = Random::new(4);
    for _ in 0..1_000 {
        let normal = DVec3::new(random.unit(), random.unit(), random.unit()) - 0.5;
        let normal = normal.normalize();
        let point = center + radius * normal;
        let gradient = query.smooth_gradient(point).unwrap();
        // The mean over a voxel of a slope whose second derivative is of the order of 1/r²; samples are
        // interpolated to within 1/8r on either side.
        let angle = gradient.normalize().dot(normal).min(1.0).acos();
        assert!(angle < 0.25 / radius, "{angle} at {point}");
        // On either side of the nearest plane between two cells.
        let plane = DVec3::new(point.x.round(), point.y, point.z);
        let [a, b] = [-1e-9, 1e-9].map(|x| query.smooth_gradient(plane + x * DVec3::X).unwrap());
        assert!(a.distance(b) < 1e-7, "{a} and {b} at {plane}");
    }
    assert_eq!(GridQuery::of_packed(&grid).smooth_gradient(center), None);
}

#[test]
fn fog_is_met_at_once_where_nothing_is_enough() {
    let tree = fog::block(CoordBox { min: IVec3::ZERO, max: IVec3::splat(9) }, 0.5);
    let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
    let query = GridQuery::new(&tree, &grid);
    let ray = |t_max| IndexRay { origin: DVec3::new(-20.0, 4.0, 4.0), dir: DVec3::X * 2.0, t_max };
    // The density begins a voxel before the first sample, and rises to it linearly.
    let hit = query.first_hit(&ray(f64::INFINITY), 0.0).unwrap();
    assert!((hit.t - 9.5).abs() < 1e-9, "{hit:?}");
    let hit = query.first_hit(&ray(f64::INFINITY), 0.5).unwrap();
    // ∫ is 0.125 to the first sample, then 0.25 a voxel.
    assert!((hit.t - (10.0 + 0.5 * 0.375 / 0.25)).abs() < 1e-6, "{hit:?}");
    assert_eq!(hit.ijk, IVec3::new(2, 4, 4));
    let edge = query.first_hit(&ray(f64::INFINITY), 0.1).unwrap();
    assert_eq!(edge.normal.normalize(), DVec3::NEG_X);
    assert_eq!(query.first_hit(&ray(10.5), 0.5), None, "ends before");
    for never in [f64::INFINITY, f64::NAN, 1e9] {
        assert_eq!(query.first_hit(&ray(f64::INFINITY), never), None);
    }
}

#[test]
fn rays_that_are_none_meet_nothing() {
    let tree = level_set::sphere(DVec3::ZERO, 10.0);
    let sound = IndexRay { origin: DVec3::X * 50.0, dir: DVec3::NEG_X, t_max: f64::INFINITY };
    for kind in [SURFACE, SMOOTH] {
        let grid = PackedGrid::new(&tree, kind).unwrap();
        let hit = |ray: &IndexRay| GridQuery::new(&tree, &grid).first_hit(ray, 1.0);
        let t = hit(&sound).unwrap().t;
        assert!((39.0..41.0).contains(&t), "{t}");
        assert!(hit(&IndexRay { t_max: t + 1e-6, ..sound }).is_some());
        assert_eq!(hit(&IndexRay { t_max: t - 1e-6, ..sound }), None, "ends before");
        for odd in [f64::NAN, f64::INFINITY, 0.0] {
            assert_eq!(hit(&IndexRay { dir: DVec3::splat(odd), ..sound }), None);
        }
        assert_eq!(hit(&IndexRay { origin: DVec3::splat(f64::NAN), ..sound }), None);
        assert_eq!(hit(&IndexRay { t_max: f64::NAN, ..sound }), None);
        assert_eq!(hit(&IndexRay { t_max: -1.0, ..sound }), None);
        // Of any length.
        for scale in [1e-200, 1e-9, 1e9, 1e200] {
            let scaled: IndexHit = hit(&IndexRay { dir: sound.dir * scale, ..sound }).unwrap();
            assert!((scaled.t * scale / t - 1.0).abs() < 1e-9, "{} by {scale}", scaled.t);
        }
    }
    let empty = Vdb543::new(1.0);
    let grid = PackedGrid::new(&empty, SURFACE).unwrap();
    assert_eq!(GridQuery::new(&empty, &grid).first_hit(&sound, 1.0), None);
}

#[test]
fn values_at_points() {
    // A ramp, which trilinear interpolation repeats.
    let bbox = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) };
    let gradient = DVec3::new(0.5, -0.25, 2.0);
    let tree = fog::ramp(bbox, gradient, 3.0);
    let smooth = PackedGrid::new(&tree, PackKind::Smooth { iso: 3.0 }).unwrap();
    let fog = PackedGrid::new(&tree, PackKind::Fog).unwrap();
    let surface = PackedGrid::new(&tree, PackKind::Surface { iso: 3.0 }).unwrap();
    let mut random = Random::new(7);
    let ask = |grid| GridQuery::new(&tree, grid);
    for _ in 0..2000 {
        let point = DVec3::new(random.unit(), random.unit(), random.unit()) * 38.0 - 19.0;
        let exact = gradient.dot(point) + 3.0;
        let value = f64::from(ask(&smooth).trilinear(point).unwrap());
        assert!((value - exact).abs() < 1e-5, "{value}, not {exact}");
        assert_eq!(ask(&smooth).contains(point), exact < 3.0, "{point}");
        let voxel = gradient.dot((point + 0.5).floor()) + 3.0;
        assert_eq!(f64::from(ask(&surface).nearest(point).unwrap()), voxel);
        assert_eq!(ask(&surface).contains(point), voxel < 3.0, "{point}");
        let density = f64::from(ask(&fog).nearest(point).unwrap());
        assert_eq!(density, voxel.max(0.0), "no density is negative");
        assert_eq!(ask(&fog).contains(point), ask(&fog).trilinear(point) > Some(0.0));
    }
    let far = DVec3::splat(1e300);
    assert_eq!((ask(&fog).nearest(far), ask(&fog).trilinear(-far)), (Some(0.0), Some(0.0)));
    assert!(!ask(&fog).contains(DVec3::splat(f64::NAN)));
}

/// Points in a grid's box, those at its samples among them.
fn points(random: &mut Random, grid: &PackedGrid, count: usize) -> Vec<DVec3> {
    let bbox = bounds(grid);
    let size = (bbox.max - bbox.min).as_dvec3() + 4.0;
    let mut point = || {
        let unit = DVec3::new(random.unit(), random.unit(), random.unit());
        let point = bbox.min.as_dvec3() - 2.0 + unit * size;
        if random.unit() < 0.3 { point.round() } else { point }
    };
    (0..count).map(|_| point()).collect()
}

#[test]
fn without_a_tree_rays_and_points_find_the_same() {
    let trees = [
        level_set::sphere(DVec3::new(0.3, -7.1, 2.0), 21.4),
        fog::cloud(30.0, 3),
        // Tiles, and tiles beside each other.
        fog::block(CoordBox { min: IVec3::splat(-40), max: IVec3::new(300, 40, 41) }, 0.4),
    ];
    let mut random = Random::new(11);
    for (number, tree) in trees.iter().enumerate() {
        let kinds = if number == 0 { vec![SURFACE, SMOOTH] } else { vec![PackKind::Fog] };
        for kind in kinds {
            let grid = PackedGrid::new(tree, kind).unwrap();
            let (known, packed) = (GridQuery::new(tree, &grid), GridQuery::of_packed(&grid));
            let (mut hits, mut inside, mut values) = (0, 0, 0);
            for _ in 0..3_000 {
                let ray = index_ray(&aimed(&mut random, bounds(&grid), 30.0));
                let hit = known.first_hit(&ray, 2.0);
                assert_eq!(packed.first_hit(&ray, 2.0), hit, "{kind:?} {ray:?}");
                hits += usize::from(hit.is_some());
            }
            for point in points(&mut random, &grid, 3_000) {
                let is_inside = known.contains(point);
                assert_eq!(packed.contains(point), is_inside, "{kind:?} {point}");
                inside += usize::from(is_inside);
                for (own, other) in [
                    (packed.nearest(point), known.nearest(point)),
                    (packed.trilinear(point), known.trilinear(point)),
                ] {
                    assert!(own.is_none_or(|own| Some(own) == other), "{own:?} for {other:?}");
                    values += usize::from(own.is_some());
                }
            }
            let expected = match kind {
                PackKind::Fog => 6_000..=6_000,
                PackKind::Smooth { .. } => 100..=3_000,
                PackKind::Surface { .. } => 0..=0,
            };
            assert!(expected.contains(&values), "{values} values of {kind:?}");
            assert!(hits > 1_000 && inside > 300, "{hits} hits, {inside} inside: {kind:?}");
        }
    }
}
