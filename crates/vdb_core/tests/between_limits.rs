//! Frames in between that cannot be made, and values at the ends of their range.

use glam::{DAffine3, DVec3};
use vdb_core::between::{BetweenOptions, Frame, Method, compare, in_between};
use vdb_core::tree::{IVec3, Vdb543};
use vdb_core::{AnyTree, Error, Grid, GridClass, Limits, Transform};

const ALL: [Method; 3] = [Method::CrossFade, Method::Advect, Method::Register];

fn grid(tree: Vdb543<f32>) -> Grid {
    let mut grid = Grid::new("smoke", AnyTree::Float(tree.into()));
    grid.class = GridClass::FogVolume;
    grid
}

/// Two voxels.
fn smoke(values: [(IVec3, f32); 2]) -> Grid {
    let mut tree = Vdb543::new(0.0);
    values.into_iter().for_each(|(ijk, value)| tree.set(ijk, value));
    grid(tree)
}

fn small() -> Grid {
    smoke([(IVec3::ZERO, 1.0), (IVec3::ONE, 0.5)])
}

/// A velocity in a cube of 64 voxels around the origin.
fn wind(velocity: [f32; 3]) -> Grid {
    let mut tree = Vdb543::new([0.0; 3]);
    for corner in 0..512 {
        let leaf = IVec3::new(corner >> 6, corner >> 3 & 7, corner & 7) - 4;
        tree.fill_leaf(leaf * 8, velocity, true);
    }
    Grid::new("wind", AnyTree::Vec3s(tree.into()))
}

fn alone(grid: &Grid) -> Frame<'_> {
    Frame { grid, velocity: None }
}

fn options(method: Method) -> BetweenOptions {
    BetweenOptions { method, velocity_scale: Some(1.0), ..BetweenOptions::default() }
}

#[test]
fn every_refusal_says_what_is_wrong_and_what_to_do() {
    let (smoke, wind) = (small(), wind([1.0; 3]));
    let with = |velocity| Frame { grid: &smoke, velocity: Some(velocity) };
    let fade = options(Method::CrossFade);
    let mut surface = small();
    surface.class = GridClass::LevelSet;
    let doubles = Grid::new("heat", AnyTree::Double(Vdb543::new(0.0).into()));
    let mut far = small();
    far.transform = Transform::uniform(1e-150, DVec3::ZERO).unwrap();
    let said = |from, to, t, options: &BetweenOptions| {
        in_between(from, to, t, options).unwrap_err().to_string()
    };
    let small = alone(&smoke);
    let scale = BetweenOptions { velocity_scale: Some(f64::NAN), ..BetweenOptions::default() };
    let cases = [
        (
            said(small, small, 1.5, &fade),
            "a frame at time 1.5; the time between two frames is from 0 to 1",
        ),
        (
            said(small, small, f64::NAN, &fade),
            "a frame at time NaN; the time between two frames is from 0 to 1",
        ),
        (
            said(alone(&surface), small, 0.5, &fade),
            "grid \"smoke\": a level set, of which no frames in between are made: its values would no longer be distances; use densities",
        ),
        (
            said(small, alone(&doubles), 0.5, &fade),
            "grid \"heat\": values of type double, of which no frames in between are made; use a grid of floats",
        ),
        (
            said(small, alone(&far), 0.5, &fade),
            "grid \"smoke\": voxels of a size so unlike that of the other frame that positions overflow; write both frames with one transform",
        ),
        (
            said(small, with(&wind), 0.5, &options(Method::Advect)),
            "grid \"smoke\": no velocities in both frames to carry this grid along; name their grid, or use another method",
        ),
        (
            said(with(&wind), with(&doubles), 0.5, &options(Method::Register)),
            "grid \"heat\": values of type double, which are no velocities; name a grid of vectors",
        ),
        (
            said(with(&wind), with(&wind), 0.5, &scale),
            "a velocity scale of NaN; give a finite number",
        ),
        (
            compare(&far, &smoke, None).unwrap_err().to_string(),
            "grid \"smoke\": voxels of a size so unlike that of the other frame that positions overflow; write both frames with one transform",
        ),
    ];
    for (said, expected) in cases {
        assert_eq!(said, expected);
    }
}

#[test]
fn frames_that_cannot_be_compared_are_refused() {
    let smoke = small();
    let mut moved = small();
    moved.transform = Transform::uniform(1.0, DVec3::X).unwrap();
    let mut large = Vdb543::new(0.0);
    large.insert_tile(IVec3::ZERO, 1.0, true);
    let large = grid(large);
    for (made, expected) in [
        (
            &moved,
            "grid \"smoke\": a transform unlike that of the frame to compare it with; compare grids of one resolution",
        ),
        (
            &large,
            "grid \"smoke\": active tiles of more than 128³ voxels, too many to compare one by one",
        ),
    ] {
        assert_eq!(compare(made, &smoke, None).unwrap_err().to_string(), expected);
    }
}

/// What a comparison says, worked out by hand: the true frame has values of 3 and 4 in one column
/// along z, and the made one 3 and 2.
#[test]
fn differences_are_relative_to_the_true_frame() {
    let truth = smoke([(IVec3::ZERO, 3.0), (IVec3::Z, 4.0)]);
    let made = smoke([(IVec3::ZERO, 3.0), (IVec3::Z, 2.0)]);
    let found = compare(&made, &truth, Some(0.1)).unwrap();
    assert_eq!((found.l1, found.l2), (2.0 / 7.0, 0.4));
    let transmitted = |depth: f64| (-0.1 * depth).exp();
    let [x, _, z] = found.rays;
    // Along z there is one ray, along x there are two, of which one is right.
    assert!((z.max - (transmitted(5.0) - transmitted(7.0))).abs() < 1e-12 && z.mean == z.max);
    assert!((x.max - (transmitted(2.0) - transmitted(4.0))).abs() < 1e-12);
    assert!((x.mean - 0.5 * x.max).abs() < 1e-12);
    // The densest ray lets 5 % through.
    assert!((compare(&made, &truth, None).unwrap().extinction * 7.0 - 3.0).abs() < 1e-12);
    // Nothing in the true frame: no division by a column of zero.
    let nothing = grid(Vdb543::new(0.0));
    let found = compare(&made, &nothing, None).unwrap();
    assert!(found.l1.is_infinite() && found.extinction == 0.0, "{found:?}");
}

/// Each of these would take terabytes, so the test would not live to see them allocated.
#[test]
fn memory_is_refused_before_it_is_taken() {
    let mut tile = Vdb543::new(0.0);
    tile.insert_tile(IVec3::ZERO, 1.0, true);
    let tile = grid(tile);
    let far = smoke([(IVec3::splat(i32::MIN), 1.0), (IVec3::splat(i32::MAX), 1.0)]);
    let mut coarse = small();
    coarse.transform = Transform::uniform(1e5, DVec3::ZERO).unwrap();
    let small = small();
    for (from, to, method, what) in [
        (&tile, &tile, Method::CrossFade, "for a frame in between"),
        (&small, &coarse, Method::CrossFade, "for a frame in between"),
        (&far, &far, Method::Register, "for the motion between two frames"),
    ] {
        let Err(error) = in_between(alone(from), alone(to), 0.5, &options(method)) else {
            panic!("{method:?} of a frame too large")
        };
        assert!(matches!(error, Error::LimitExceeded { name: "tree_bytes", .. }), "{error}");
        let said = error.to_string();
        assert!(said.starts_with("grid \"smoke\": ") && said.contains(what), "{said}");
    }
    // The limit is that of the options, to the byte: one leaf, in memory twice.
    let needed = 2 * size_of::<vdb_core::tree::LeafNode<f32, 3>>() as u64;
    let with = |tree_bytes| {
        let mut options = options(Method::CrossFade);
        options.limits = Limits::default();
        options.limits.tree_bytes = tree_bytes;
        in_between(alone(&small), alone(&small), 0.5, &options).is_ok()
    };
    assert!(with(needed) && !with(needed - 1));
}

#[test]
fn what_is_far_away_does_not_matter_to_a_cross_fade() {
    let far = smoke([(IVec3::splat(i32::MIN), 1.0), (IVec3::splat(i32::MAX), 2.0)]);
    let made = in_between(alone(&far), alone(&far), 0.5, &options(Method::CrossFade)).unwrap();
    let AnyTree::Float(tree) = &made.tree else { panic!("not floats") };
    assert_eq!(tree.get(IVec3::splat(i32::MIN)), 1.0);
    assert_eq!(tree.get(IVec3::splat(i32::MAX)), 2.0);
    assert_eq!(tree.active_voxel_count(), 2);
}

#[test]
fn no_value_and_no_velocity_makes_one_that_is_not_finite() {
    let values = [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN, f32::MIN_POSITIVE, 0.0];
    let velocities = [f32::NAN, f32::INFINITY, f32::MAX, -1.5];
    let winds = velocities.map(|velocity| wind([velocity, 0.5, velocity]));
    for (i, a) in values.into_iter().enumerate() {
        for b in values.into_iter().skip(i) {
            let from = smoke([(IVec3::ZERO, a), (IVec3::new(0, 1, 1), b)]);
            let to = smoke([(IVec3::new(1, 0, 0), b), (IVec3::new(1, 2, 1), a)]);
            for (method, wind) in [
                (Method::CrossFade, 0),
                (Method::Register, 3),
                (Method::Advect, 0),
                (Method::Advect, 1),
                (Method::Advect, 2),
            ] {
                let with = |grid| Frame { grid, velocity: Some(&winds[wind]) };
                let made = in_between(with(&from), with(&to), 0.3, &options(method)).unwrap();
                let AnyTree::Float(tree) = &made.tree else { panic!("not floats") };
                let sound = tree.active_values().all(|tile| tile.value.is_finite());
                assert!(sound, "{method:?} of {a} and {b} along {}", velocities[wind]);
            }
        }
    }
}

/// Temperatures around 300 K: only what differs is active.
#[test]
fn a_background_that_is_not_zero_stays_what_it_is() {
    let warm = |at: IVec3| {
        let mut tree = Vdb543::new(300.1_f32);
        tree.set(at, 400.0);
        grid(tree)
    };
    let (from, to) = (warm(IVec3::ZERO), warm(IVec3::new(3, 0, 0)));
    let wind = wind([3.0, 0.0, 0.0]);
    let with = |grid| Frame { grid, velocity: Some(&wind) };
    for method in ALL {
        let made = in_between(with(&from), with(&to), 1.0 / 3.0, &options(method)).unwrap();
        let AnyTree::Float(tree) = &made.tree else { panic!("not floats") };
        assert_eq!(tree.background(), 300.1);
        let count = tree.active_voxel_count();
        assert!((1..=200).contains(&count), "{method:?}: {count} active voxels");
        if method == Method::Advect {
            assert!((tree.get(IVec3::X) - 400.0).abs() < 0.1, "{}", tree.get(IVec3::X));
        }
    }
}

#[test]
fn mirrored_and_tiny_voxels_are_no_special_case() {
    let mut from = small();
    from.transform =
        Transform::affine(DAffine3::from_scale(DVec3::new(-1e-6, 1e-6, 1e-6))).unwrap();
    let mut to = from.clone();
    to.transform = Transform::affine(DAffine3::from_scale(DVec3::splat(1e-6))).unwrap();
    let made = in_between(alone(&from), alone(&to), 1.0, &options(Method::CrossFade)).unwrap();
    let AnyTree::Float(tree) = &made.tree else { panic!("not floats") };
    assert_eq!((tree.get(IVec3::ZERO), tree.get(IVec3::new(-1, 1, 1))), (1.0, 0.5));
    assert_eq!(tree.get(IVec3::ONE), 0.0);
}
