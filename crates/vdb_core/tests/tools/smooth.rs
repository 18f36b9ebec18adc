use glam::{DVec3, IVec3};
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tools::{Filter, Smooth, ToolError, smooth};
use vdb_core::tree::{CoordBox, Found, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass};

use crate::shapes::{floats, voxels};

fn grid(tree: Vdb543<f32>, class: GridClass) -> Grid {
    let mut grid = Grid::new("volume", AnyTree::Float(tree.into()));
    grid.class = class;
    grid
}

/// The mean over all voxels in a cube around one, several times in a row.
fn mean(at: &dyn Fn(IVec3) -> f64, ijk: IVec3, width: i32) -> f64 {
    let mut sum = 0.0;
    for offset in voxels(-width, width, 1) {
        sum += at(ijk + offset);
    }
    sum / f64::from((2 * width + 1).pow(3))
}

#[test]
fn fog_has_the_means_of_brute_force() {
    let mut random = Random::new(5);
    let mut tree = Vdb543::new(0.0);
    for ijk in voxels(-9, 9, 1) {
        if random.below(3) == 0 {
            tree.set(ijk, random.unit() as f32);
        }
    }
    tree.fill_leaf(IVec3::ZERO, 0.5, true);
    tree.set(IVec3::new(3, -3, 3), f32::NAN);
    tree.set(IVec3::new(-3, -3, 3), f32::INFINITY);
    let finite = |ijk: IVec3| f64::from(tree.get(ijk)).min(1e30);
    let at = |ijk: IVec3| if finite(ijk) < 2.0 { finite(ijk) } else { 0.0 };
    for width in [1, 2] {
        let filter = Filter::Mean { width: width as u32 };
        let made = smooth(&grid(tree.clone(), GridClass::FogVolume), &Smooth::new(filter)).unwrap();
        for ijk in voxels(-13, 13, 1) {
            let expected = mean(&at, ijk, width);
            let (value, active) = floats(&made).probe(ijk);
            assert!((f64::from(value) - expected).abs() < 1e-6, "{ijk}: {value}, {expected}");
            assert_eq!(active, expected > 0.0 || tree.probe(ijk).1, "{ijk}");
        }
    }
    // A Gaussian is four means, and two iterations are two of what one does.
    let own = grid(tree.clone(), GridClass::FogVolume);
    let four = Smooth { iterations: 4, ..Smooth::new(Filter::Mean { width: 1 }) };
    let [one, other] =
        [smooth(&own, &four), smooth(&own, &Smooth::new(Filter::Gaussian { width: 1 }))];
    let (one, other) = (one.unwrap(), other.unwrap());
    for ijk in voxels(-15, 15, 1) {
        let [a, b] = [&one, &other].map(|grid| floats(grid).get(ijk));
        assert!((a - b).abs() < 1e-6, "{ijk}: {a} and {b}");
    }
}

#[test]
fn fog_spreads_into_nodes_that_had_none() {
    let mut tree = Vdb543::new(0.0);
    tree.set(IVec3::ZERO, 1.0);
    let own = grid(tree, GridClass::FogVolume);
    let made = smooth(&own, &Smooth::new(Filter::Mean { width: 1 })).unwrap();
    assert_eq!(made.tree.active_voxel_count(), 27);
    assert!((floats(&made).get(IVec3::splat(-1)) - 1.0 / 27.0).abs() < 1e-8);
}

#[test]
fn the_integral_of_fog_stays() {
    let ball = fog::sphere(DVec3::new(0.2, 0.1, 125.0), 40.0, 1.0);
    let sum = |tree: &Vdb543<f32>| -> f64 {
        tree.active_values().map(|own| f64::from(own.value) * own.voxels() as f64).sum()
    };
    let made = smooth(
        &grid(ball.clone(), GridClass::FogVolume),
        &Smooth::new(Filter::Gaussian { width: 3 }),
    );
    let made = made.unwrap();
    let [before, after] = [sum(&ball), sum(floats(&made))];
    assert!((after / before - 1.0).abs() < 1e-5, "{before} became {after}");
    let Found::Tile(tile) = floats(&made).find(IVec3::new(0, 0, 125)) else { panic!("a leaf") };
    assert!((tile.value, tile.active) == (1.0, true));
    // Linear fields are their own means.
    let bbox = CoordBox { min: IVec3::splat(-16), max: IVec3::splat(16) };
    let ramp = fog::ramp(bbox, DVec3::new(0.5, 0.25, -1.0), 30.0);
    let made = smooth(
        &grid(ramp.clone(), GridClass::Unknown),
        &Smooth::new(Filter::Gaussian { width: 1 }),
    );
    for ijk in voxels(-12, 12, 1) {
        let [a, b] = [floats(made.as_ref().unwrap()), &ramp].map(|tree| tree.get(ijk));
        assert!((a - b).abs() < 2e-5, "{ijk}: {a}, should be {b}");
    }
}

/// The radius of a ball around the origin along some directions: its least and its greatest.
fn radii(tree: &Vdb543<f32>) -> [f64; 2] {
    let mut random = Random::new(9);
    let mut found = [f64::INFINITY, 0.0_f64];
    for _ in 0..200 {
        let mut axis = || random.range(-1.0, 1.0);
        let way = DVec3::new(axis(), axis(), axis()).normalize();
        let value = |r: f64| {
            let p = way * r;
            let mut sum = 0.0;
            for corner in 0..8 {
                let at =
                    p.floor().as_ivec3() + IVec3::new(corner >> 2, corner >> 1 & 1, corner & 1);
                let weight = (1.0 - (p - at.as_dvec3()).abs()).max(DVec3::ZERO).element_product();
                sum += weight * f64::from(tree.get(at));
            }
            sum
        };
        let (mut low, mut high) = (2.0, 40.0);
        for _ in 0..50 {
            let middle = (low + high) / 2.0;
            if value(middle) < 0.0 { low = middle } else { high = middle }
        }
        found = [found[0].min(low), found[1].max(low)];
    }
    found
}

#[test]
fn spheres_shrink_by_their_curvature() {
    let radius = 20.0;
    let ball = grid(level_set::sphere(DVec3::ZERO, radius), GridClass::LevelSet);
    // `dr/dt = -2/r · 1/6` per iteration. The variance of a mean of `2w + 1` is `w (w + 1) / 3`, and a
    // Gaussian moves the surface of a ball by `variance / r`.
    let flown = |iterations: f64| (radius * radius - iterations * 2.0 / 3.0).sqrt();
    let variance = |width: f64, means: f64| means * width * (width + 1.0) / 3.0;
    for (filter, iterations, expected) in [
        (Filter::MeanCurvature, 1, flown(1.0)),
        (Filter::MeanCurvature, 12, flown(12.0)),
        (Filter::Mean { width: 1 }, 1, radius - variance(1.0, 1.0) / radius),
        (Filter::Mean { width: 1 }, 6, (radius * radius - 2.0 * 6.0 * variance(1.0, 1.0)).sqrt()),
        (Filter::Gaussian { width: 1 }, 1, radius - variance(1.0, 4.0) / radius),
    ] {
        let made = smooth(&ball, &Smooth { iterations, ..Smooth::new(filter) }).unwrap();
        let [low, high] = radii(floats(&made));
        // Each time, roots are off by 1 / 8r and chords by 3 / 8r at most.
        let bound = f64::from(iterations) / (2.0 * expected);
        let range = expected - bound..expected + 0.01;
        assert!(
            range.contains(&low) && range.contains(&high),
            "{filter:?}: {low} to {high}, {range:?}"
        );
        assert_eq!((made.class, floats(&made).background()), (GridClass::LevelSet, 3.0));
    }
}

#[test]
fn bumps_go_and_planes_stay() {
    let bbox = CoordBox { min: IVec3::splat(-40), max: IVec3::splat(40) };
    let slab = level_set::slab_x(-20.25, 20.25, bbox);
    for filter in [Filter::MeanCurvature, Filter::Mean { width: 1 }, Filter::Gaussian { width: 1 }]
    {
        let made = smooth(&grid(slab.clone(), GridClass::LevelSet), &Smooth::new(filter)).unwrap();
        for x in 18..23 {
            let [a, b] = [&slab, floats(&made)].map(|tree| tree.get(IVec3::new(x, 3, 4)));
            assert!((a - b).abs() < 1e-5, "{filter:?} at {x}: {b}, should be {a}");
        }
    }
    // A gap whose middle is beyond both bands stays open, however wide the filter is.
    let gap = level_set::from_distance(bbox, |p| 4.0 - p.x.abs());
    let wide = Smooth::new(Filter::Mean { width: 8 });
    let made = smooth(&grid(gap, GridClass::LevelSet), &wide).unwrap();
    let [gap, solid] = [0, 4].map(|x| floats(&made).get(IVec3::new(x, 3, 4)));
    assert!(gap > 0.0 && solid < 0.0, "{gap}, {solid}");
    // A ball with a bump of two voxels' radius.
    let bumpy =
        level_set::from_distance(CoordBox { min: IVec3::splat(-32), max: IVec3::splat(32) }, |p| {
            (p.length() - 20.0).min(p.distance(DVec3::new(20.0, 0.0, 0.0)) - 2.0)
        });
    let many = Smooth { iterations: 8, ..Smooth::new(Filter::MeanCurvature) };
    let made = smooth(&grid(bumpy, GridClass::LevelSet), &many).unwrap();
    let [low, high] = radii(floats(&made));
    assert!(high - low < 1.0, "{low} to {high}");
    let value = floats(&made).get(IVec3::new(22, 0, 0));
    assert!(value > 1.0, "{value}");
}

#[test]
fn what_cannot_be_smoothed_is_refused() {
    let ball = grid(level_set::sphere(DVec3::ZERO, 3.0), GridClass::LevelSet);
    let error = |grid: &Grid, options: &Smooth| smooth(grid, options).unwrap_err();
    let cloud = grid(fog::sphere(DVec3::ZERO, 9.0, 2.0), GridClass::FogVolume);
    let flow = Smooth::new(Filter::MeanCurvature);
    assert_eq!(error(&cloud, &flow), ToolError::NotLevelSet { class: "fog volume" });
    for width in [0, 9, u32::MAX] {
        let said = error(&cloud, &Smooth::new(Filter::Mean { width })).to_string();
        assert_eq!(
            said,
            format!("the width of the filter is {width}; it must be from 1 to 8 voxels")
        );
    }
    let said = error(&cloud, &Smooth { iterations: 0, ..flow.clone() }).to_string();
    assert_eq!(said, "the number of iterations is 0; it must be from 1 to 1000");
    let said = error(&ball, &Smooth { iterations: 100, ..flow }).to_string();
    assert!(said.starts_with("Smoothed 1") && said.contains("no surface any more"), "{said}");
    let mut tight = Smooth::new(Filter::Gaussian { width: 8 });
    tight.limits.tree_bytes = 300_000;
    assert!(matches!(error(&cloud, &tight), ToolError::TooManyVoxels { .. }));
}
