use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::sync::Arc;

use glam::{DVec3, IVec3};
use vdb_core::synth::Random;
use vdb_core::tools::{
    PointNumber, PointsToFog, PointsToLevelSet, ToolError, points_to_fog, points_to_level_set,
};
use vdb_core::tree::{Found, Vdb543};
use vdb_core::{Grid, GridClass, PointGrid, Points, Transform};

use crate::shapes::{floats, voxels};

const SIZE: f64 = 0.25;

/// Points in a cube around the origin, in world space, with radii from `low` to `high` and
/// densities from 0 to 1.
fn scattered(count: usize, extent: f64, [low, high]: [f64; 2], seed: u64) -> PointGrid {
    let mut random = Random::new(seed);
    let mut axis = || random.range(-extent, extent);
    let positions: Vec<DVec3> = (0..count).map(|_| DVec3::new(axis(), axis(), axis())).collect();
    let radii = (0..count).map(|_| random.range(low, high) as f32).collect();
    let densities = (0..count).map(|_| random.unit() as f32).collect();
    let points = Points::new(positions).with_floats("pscale", radii).unwrap();
    PointGrid::new("points", points.with_floats("rho", densities).unwrap())
}

fn attribute(name: &str, scale: f64) -> PointNumber {
    PointNumber::Attribute { name: name.to_owned(), scale }
}

/// The centres and the numbers of all points.
fn numbered(points: &PointGrid, name: &str) -> Vec<(DVec3, f64)> {
    let values = points.points.floats(name).unwrap();
    points.world_positions().zip(values.iter().map(|value| f64::from(*value))).collect()
}

#[test]
fn distances_are_those_of_brute_force() {
    // Balls of less than a voxel up to several nodes of 8³, with gaps and overlaps.
    for (count, extent, radii, half_width, seed) in [
        (40, 4.0, [0.2, 1.0], 3.0, 1),
        (6, 3.0, [2.0, 4.5], 2.0, 2),
        (300, 5.0, [0.1, 0.4], 4.5, 3),
    ] {
        let points = scattered(count, extent, radii, seed);
        let scale = 1.25;
        let options = PointsToLevelSet {
            half_width,
            ..PointsToLevelSet::new(SIZE, attribute("pscale", scale))
        };
        let made = points_to_level_set(&points, &options).unwrap();
        assert_eq!(made.class, GridClass::LevelSet);
        let tree = floats(&made);
        let background = f64::from(tree.background());
        assert!((background - f64::from(half_width) * SIZE).abs() < 1e-6);
        let balls = numbered(&points, "pscale");
        let mut active_found = 0;
        for ijk in voxels(-45, 45, 1) {
            let p = ijk.as_dvec3() * SIZE;
            let distance = balls.iter().map(|(center, r)| (p - *center).length() - r * scale);
            let nearest = distance.fold(f64::INFINITY, f64::min);
            let (value, active) = tree.probe(ijk);
            let expected = nearest.clamp(-background, background);
            // Rounding to f32 at distances below 2.
            assert!((f64::from(value) - expected).abs() < 2e-7, "{ijk}: {value}, not {expected}");
            if (nearest.abs() - background).abs() > 2e-7 {
                assert_eq!(active, nearest.abs() < background, "{ijk}, at {nearest}");
            }
            active_found += u64::from(active);
        }
        assert_eq!(active_found, made.tree.active_voxel_count(), "more outside of the box");
    }
}

#[test]
fn the_middle_of_a_large_ball_is_tiles() {
    let points = PointGrid::new("one", Points::new(vec![DVec3::new(0.3, 0.2, 0.1)]));
    let options = PointsToLevelSet::new(1.0, PointNumber::Constant(300.0));
    let made = points_to_level_set(&points, &options).unwrap();
    let tree = floats(&made);
    let Found::Tile(tile) = tree.find(IVec3::splat(5)) else { panic!("a leaf in the middle") };
    assert_eq!((tile.value, tile.active), (-3.0, false));
    let area = 4.0 * PI * 300.0_f64.powi(2);
    let active = made.tree.active_voxel_count() as f64;
    assert!((active / (6.0 * area) - 1.0).abs() < 1e-3, "{active} active voxels");
}

/// The density of a voxel, by the definition of the kernel.
fn density(points: &PointGrid, scale: f64, weights: &[f64], ijk: IVec3) -> f64 {
    let (radii, densities) = (numbered(points, "pscale"), numbered(points, "rho"));
    let terms = radii.iter().zip(densities).zip(weights);
    terms
        .map(|((&(center, radius), (_, density)), total)| {
            let radius = radius * scale / SIZE;
            let mass = density * 4.0 / 3.0 * PI * radius.powi(3);
            mass * kernel(center / SIZE, radius, ijk) / total
        })
        .sum()
}

fn kernel(center: DVec3, radius: f64, ijk: IVec3) -> f64 {
    let offset = ijk.as_dvec3() - center;
    if radius >= 1.0 {
        return (1.0 - offset.length_squared() / radius.powi(2)).max(0.0).powi(3);
    }
    offset.to_array().iter().map(|c| (1.0 - c.abs()).max(0.0)).product()
}

/// The sum of the kernel of each point over the voxels around it.
fn totals(points: &PointGrid, scale: f64) -> Vec<f64> {
    let total = |(center, radius): (DVec3, f64)| -> f64 {
        let (center, radius) = (center / SIZE, radius * scale / SIZE);
        let around = voxels(-(radius as i32 + 3), radius as i32 + 3, 1);
        around.map(|d| kernel(center, radius, center.as_ivec3() + d)).sum()
    };
    numbered(points, "pscale").into_iter().map(total).collect()
}

fn sum(tree: &Vdb543<f32>) -> f64 {
    let leaves = tree.leaves().flat_map(|leaf| leaf.values_slice().iter().copied());
    leaves.map(f64::from).sum()
}

#[test]
fn densities_are_those_of_brute_force() {
    // Radii from half a voxel to four voxels: trilinear weights and kernels.
    let points = scattered(60, 4.0, [0.125, 1.0], 4);
    let options = PointsToFog {
        radius: attribute("pscale", 1.0),
        density: attribute("rho", 2.0),
        ..PointsToFog::new(SIZE)
    };
    let made = points_to_fog(&points, &options).unwrap();
    assert_eq!((made.class, floats(&made).background()), (GridClass::FogVolume, 0.0));
    let tree = floats(&made);
    let weights = totals(&points, 1.0);
    let mut active_found = 0;
    for ijk in voxels(-24, 24, 1) {
        let expected = 2.0 * density(&points, 1.0, &weights, ijk);
        let (value, active) = tree.probe(ijk);
        let error = (f64::from(value) - expected).abs();
        // f32 has 24 bits.
        assert!(error <= 1e-7 * expected.max(1e-3), "{ijk}: {value}, not {expected}");
        assert_eq!(active, value > 0.0, "{ijk}");
        active_found += u64::from(active);
    }
    assert_eq!(active_found, made.tree.active_voxel_count(), "more outside of the box");
    // Nothing is lost, whatever the voxels are.
    let mass: f64 = numbered(&points, "pscale")
        .iter()
        .zip(numbered(&points, "rho"))
        .map(|((_, radius), (_, rho))| 2.0 * rho * 4.0 / 3.0 * PI * radius.powi(3))
        .sum();
    for size in [0.1, 0.25, 1.7] {
        let made = points_to_fog(&points, &PointsToFog { voxel_size: size, ..options.clone() });
        let total = sum(floats(&made.unwrap())) * size.powi(3);
        assert!((total / mass - 1.0).abs() < 1e-6, "voxels of {size}: {total}, not {mass}");
    }
}

#[test]
fn points_without_a_radius_are_spread_over_eight_voxels() {
    let points = Points::new(vec![DVec3::new(1.25, -2.0, 3.5), DVec3::new(-7.75, 0.0, 7.5)]);
    let mut points = PointGrid::new("points", points);
    // Positions are those of the transform.
    points.transform = Transform::uniform(0.5, DVec3::X).unwrap();
    let made = points_to_fog(&points, &PointsToFog::new(0.5)).unwrap();
    let tree = floats(&made);
    let at = |x, y, z| tree.get(IVec3::new(x, y, z));
    assert_eq!(
        [at(3, -2, 3), at(4, -2, 3), at(3, -2, 4), at(3, -1, 3)],
        [0.375, 0.125, 0.375, 0.0]
    );
    // Across the border of two leaves.
    assert_eq!([at(-6, 0, 7), at(-5, 0, 8), at(-6, 0, 8)], [0.375, 0.125, 0.375]);
    assert_eq!((sum(tree), made.tree.active_voxel_count()), (2.0, 8));
}

#[test]
fn results_do_not_depend_on_threads() {
    let points = scattered(2000, 6.0, [0.1, 1.5], 5);
    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let radius = attribute("pscale", 1.0);
        let options = PointsToFog { radius, ..PointsToFog::new(SIZE) };
        let made: Grid = pool.install(|| points_to_fog(&points, &options).unwrap());
        let bits = |value: &f32| value.to_bits();
        let leaves = floats(&made).leaves();
        leaves.flat_map(|leaf| leaf.values_slice().iter().map(bits)).collect::<Vec<u32>>()
    };
    assert!(with_threads(1) == with_threads(4));
}

#[test]
fn what_does_not_fit_is_refused() {
    let points = scattered(5, 4.0, [0.2, 1.0], 6);
    let fog = |options: PointsToFog| points_to_fog(&points, &options).unwrap_err();
    let surface = |options: PointsToLevelSet| points_to_level_set(&points, &options).unwrap_err();
    let constant = PointNumber::Constant;
    let error = fog(PointsToFog { radius: attribute("size", 1.0), ..PointsToFog::new(0.1) });
    assert!(error.to_string().contains("no attribute \"size\" with one float"), "{error}");
    let error = fog(PointsToFog { density: constant(-1.0), ..PointsToFog::new(0.1) });
    assert!(matches!(error, ToolError::BadSetting { .. }), "{error}");
    for size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = fog(PointsToFog::new(size));
        assert!(matches!(error, ToolError::BadSetting { .. }), "{size}: {error}");
    }
    let error = fog(PointsToFog::new(1e-12));
    assert!(matches!(error, ToolError::PointTooFar { point: 0, .. }), "{error}");
    for radius in [1e5, 1e7] {
        let error = fog(PointsToFog { radius: constant(radius), ..PointsToFog::new(0.1) });
        assert!(matches!(error, ToolError::TooManyVoxels { .. }), "{error}");
        let error = surface(PointsToLevelSet::new(0.1, constant(radius)));
        assert!(matches!(error, ToolError::TooManyVoxels { .. }), "{error}");
    }
    let error = surface(PointsToLevelSet::new(0.1, constant(0.0)));
    assert_eq!(error, ToolError::NoRadii);
    let options = PointsToLevelSet::new(0.1, constant(1.0));
    let error = surface(PointsToLevelSet { half_width: 0.5, ..options.clone() });
    assert!(matches!(error, ToolError::BadSetting { .. }), "{error}");
    let stop: Arc<vdb_core::ProgressFn> = Arc::new(|_, _| ControlFlow::Break(()));
    let error = surface(PointsToLevelSet { progress: Some(stop.clone()), ..options });
    assert_eq!(error, ToolError::Cancelled);
    let error = fog(PointsToFog { progress: Some(stop), ..PointsToFog::new(0.1) });
    assert_eq!(error, ToolError::Cancelled);

    let none = PointGrid::new("none", Points::default());
    let error = points_to_fog(&none, &PointsToFog::new(0.1)).unwrap_err();
    assert_eq!(error, ToolError::NoPoints);
    let lost = Points::new(vec![DVec3::ZERO, DVec3::new(0.0, f64::NAN, 0.0)]);
    let lost = PointGrid::new("lost", lost);
    let error = points_to_fog(&lost, &PointsToFog::new(0.1)).unwrap_err();
    assert!(matches!(error, ToolError::PointNotFinite { point: 1, .. }), "{error}");
    let negative = Points::new(vec![DVec3::ZERO]).with_floats("pscale", vec![-1.0]).unwrap();
    let negative = PointGrid::new("negative", negative);
    let options = PointsToFog { radius: attribute("pscale", 1.0), ..PointsToFog::new(0.1) };
    let error = points_to_fog(&negative, &options).unwrap_err();
    assert!(matches!(error, ToolError::BadPointValue { point: 0, .. }), "{error}");
}

/// Whether its kernel is summed or integrated, a ball has its mass.
#[test]
fn large_balls_keep_their_mass() {
    for radius in [31.9, 32.1, 40.0] {
        let points = PointGrid::new("one", Points::new(vec![DVec3::new(0.31, 0.17, 0.48)]));
        let radius = PointNumber::Constant(radius);
        let options = PointsToFog { radius: radius.clone(), ..PointsToFog::new(1.0) };
        let made = points_to_fog(&points, &options).unwrap();
        let PointNumber::Constant(r) = radius else { panic!() };
        let share = sum(floats(&made)) / (4.0 / 3.0 * PI * r.powi(3));
        // Of the integral, and of the rounding of the values to f32.
        assert!((share - 1.0).abs() < 1.5e-7, "radius {r}: {share}");
    }
}
