//! Frames in between, against blobs whose motion is known.

use std::f64::consts::TAU;

use glam::{DAffine3, DVec3};
use vdb_core::between::{BetweenOptions, Frame, Method, compare, fit_velocity_scale, in_between};
use vdb_core::tree::{IVec3, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass, Transform};

/// The radius of a blob.
const RADIUS: f64 = 10.0;

/// A grid of fog whose density at a world position is given, in a cube of voxels.
fn fog(transform: DAffine3, reach: i32, density: impl Fn(DVec3) -> f64) -> Grid {
    let mut tree = Vdb543::new(0.0_f32);
    for ijk in cube(reach) {
        let value = density(transform.transform_point3(ijk.as_dvec3())) as f32;
        if value > 0.0 {
            tree.set(ijk, value);
        }
    }
    tree.prune();
    let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
    grid.class = GridClass::FogVolume;
    grid.transform = Transform::affine(transform).unwrap();
    grid
}

fn cube(reach: i32) -> impl Iterator<Item = IVec3> {
    let range = move || -reach..=reach;
    range().flat_map(move |x| range().flat_map(move |y| range().map(move |z| IVec3::new(x, y, z))))
}

/// A smooth blob around the origin: 1 in the middle, with a slope of zero at its border.
fn blob(p: DVec3) -> f64 {
    (1.0 - p.length_squared() / (RADIUS * RADIUS)).max(0.0).powi(2)
}

/// A blob at a place, in voxels of one world unit.
fn blob_at(place: DVec3) -> Grid {
    fog(DAffine3::IDENTITY, 40, |p| blob(p - place))
}

/// Velocities in voxels of `size` world units. Of staggered ones, each component is where it
/// belongs.
fn velocities(size: f64, staggered: bool, velocity: impl Fn(DVec3) -> DVec3) -> Grid {
    let mut tree = Vdb543::new([0.0_f32; 3]);
    for ijk in cube((44.0 / size) as i32) {
        let value = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
            let face = if staggered { 0.5 * axis } else { DVec3::ZERO };
            velocity((ijk.as_dvec3() - face) * size).dot(axis) as f32
        });
        tree.set(ijk, value);
    }
    let mut grid = Grid::new("velocity", AnyTree::Vec3s(tree.into()));
    grid.class = if staggered { GridClass::Staggered } else { GridClass::Unknown };
    grid.transform = Transform::uniform(size, DVec3::ZERO).unwrap();
    grid
}

fn frame<'a>(grid: &'a Grid, velocity: &'a Grid) -> Frame<'a> {
    Frame { grid, velocity: Some(velocity) }
}

fn alone(grid: &Grid) -> Frame<'_> {
    Frame { grid, velocity: None }
}

fn options(method: Method) -> BetweenOptions {
    BetweenOptions { method, velocity_scale: Some(1.0), ..BetweenOptions::default() }
}

fn float(grid: &Grid) -> &Vdb543<f32> {
    let AnyTree::Float(tree) = &grid.tree else { panic!("not floats") };
    tree
}

/// The sum of absolute differences, relative to the true values.
fn error(made: &Grid, truth: &Grid) -> f64 {
    compare(made, truth, None).unwrap().l1
}

fn made(from: Frame, to: Frame, t: f64, method: Method) -> Grid {
    in_between(from, to, t, &options(method)).unwrap()
}

/// All voxels of two trees that are not background, with their values.
fn same(a: &Grid, b: &Grid) -> bool {
    let voxels = |grid: &Grid| {
        let mut voxels = Vec::new();
        for tile in float(grid).active_values() {
            let bbox = tile.bbox();
            let [x, y, z] = [0, 1, 2].map(|axis: usize| bbox.min[axis]..=bbox.max[axis]);
            for i in x {
                for j in y.clone() {
                    voxels.extend(z.clone().map(|k| ([i, j, k], tile.value.to_bits())));
                }
            }
        }
        voxels.sort_unstable();
        voxels
    };
    voxels(a) == voxels(b)
}

#[test]
fn a_cross_fade_is_the_linear_blend_of_both_frames_to_the_last_bit() {
    let (a, b) = (blob_at(DVec3::new(-7.0, 0.0, 0.5)), blob_at(DVec3::new(6.0, 3.0, 0.0)));
    for t in [0.0, 0.125, 0.3, 1.0] {
        let made = made(alone(&a), alone(&b), t, Method::CrossFade);
        for ijk in cube(20) {
            let [from, to] = [&a, &b].map(|grid| f64::from(float(grid).get(ijk)));
            assert_eq!(float(&made).get(ijk), ((1.0 - t) * from + t * to) as f32, "{ijk}");
        }
        let nearer = if t < 0.5 { &a } else { &b };
        assert_eq!((&made.name, made.class), (&nearer.name, nearer.class));
    }
}

#[test]
fn at_its_own_time_a_frame_is_made_of_itself_by_every_method() {
    let way = DVec3::new(9.0, -3.0, 2.0);
    let (a, b) = (blob_at(DVec3::ZERO), blob_at(way));
    let still = velocities(4.0, false, |_| way);
    for method in [Method::CrossFade, Method::Advect, Method::Register] {
        for (t, itself) in [(0.0, &a), (1.0, &b)] {
            let made = made(frame(&a, &still), frame(&b, &still), t, method);
            assert!(same(&made, itself), "{method:?} at {t}");
        }
    }
}

/// A blob in uniform motion is carried to the right place, so that only interpolation errs. Within
/// a cell, the interpolated value is at most what the blob rises to between samples too small: an
/// eighth of its second derivative, 4 / RADIUS² at the most, along each of three axes, or 0.015 of
/// a mean value of 8/35. At most a few samples around the maximum lose that much, as elsewhere the
/// cubic follows the slope: 1 % on the whole is generous.
#[test]
fn a_blob_in_uniform_motion_is_followed() {
    let way = DVec3::new(21.0, 7.0, -10.0);
    let (a, b) = (blob_at(-0.5 * way), blob_at(0.5 * way));
    for staggered in [false, true] {
        let wind = velocities(2.0, staggered, |_| way);
        for t in [0.25, 0.5, 0.75] {
            let truth = blob_at((t - 0.5) * way);
            let fade = made(alone(&a), alone(&b), t, Method::CrossFade);
            let advected = made(frame(&a, &wind), frame(&b, &wind), t, Method::Advect);
            // Farther than the blob is wide: the fade shows two, and most of both is wrong.
            assert!(error(&fade, &truth) > 1.0);
            assert!(error(&advected, &truth) < 0.01, "{}", error(&advected, &truth));
        }
    }
    // Other paths keep a little weight at the border, where there is little smoke to agree on.
    let wind = velocities(2.0, false, |_| way);
    let registered = made(frame(&a, &wind), frame(&b, &wind), 0.5, Method::Register);
    let error = error(&registered, &blob_at(DVec3::ZERO));
    assert!(error < 0.05, "{error}");
}

/// In the strain flow `(x, -y) · rate`, a point moves to `(x · exp(rate t), y · exp(-rate t))`. The
/// voxels of the velocities are four times as large as those of the blob, so reading a staggered
/// grid as a centred one, or the reverse, shifts the flow by two voxels, and the blob by
/// `2 · (exp(0.4 · 0.5) - 1)`, or 0.44.
#[test]
fn staggered_velocities_are_half_a_voxel_below() {
    let rate = 0.8;
    let strained = |t: f64| {
        let by = DVec3::new((-rate * t).exp(), (rate * t).exp(), 1.0);
        fog(DAffine3::IDENTITY, 40, |p| blob(p * by - DVec3::new(8.0, 4.0, 0.0)))
    };
    let (a, b, truth) = (strained(0.0), strained(1.0), strained(0.5));
    let flow = |p: DVec3| rate * DVec3::new(p.x, -p.y, 0.0);
    for staggered in [false, true] {
        let right = velocities(4.0, staggered, flow);
        let mut wrong = right.clone();
        wrong.class = if staggered { GridClass::Unknown } else { GridClass::Staggered };
        let error = |flow: &Grid| {
            error(&made(frame(&a, flow), frame(&b, flow), 0.5, Method::Advect), &truth)
        };
        assert!(error(&right) < 0.015, "{}", error(&right));
        assert!(error(&wrong) > 3.0 * error(&right), "{}", error(&wrong));
    }
}

/// A blob that turns by 60° around an axis moves along an arc. Halfway, the chord is
/// `24 · (1 - cos 30°)`, or 3.2 voxels inside it: a third of the radius, and an error of half of
/// the blob. The midpoint rule with eight steps per frame errs by less than a hundredth of a voxel.
#[test]
fn a_rotating_blob_stays_on_its_circle() {
    let turn = TAU / 6.0;
    let at = |t: f64| 24.0 * DVec3::new((turn * t).cos(), (turn * t).sin(), 0.0);
    let (a, b) = (blob_at(at(0.0)), blob_at(at(1.0)));
    let flow = velocities(1.0, false, |p| turn * DVec3::Z.cross(p));
    for t in [0.25, 0.5] {
        let truth = blob_at(at(t));
        let made = made(frame(&a, &flow), frame(&b, &flow), t, Method::Advect);
        assert!(error(&made, &truth) < 0.01, "{}", error(&made, &truth));
    }
    let chord = blob_at(0.5 * (at(0.0) + at(1.0)));
    assert!(error(&chord, &blob_at(at(0.5))) > 0.3);
}

/// Velocities that grow from zero to 24 voxels per frame: the blob has come a quarter of its way at
/// half of the time.
#[test]
fn velocities_change_linearly_from_frame_to_frame() {
    let (a, b) = (blob_at(DVec3::ZERO), blob_at(DVec3::X * 12.0));
    let slow = velocities(4.0, false, |_| DVec3::ZERO);
    let fast = velocities(4.0, false, |_| DVec3::X * 24.0);
    let made = made(frame(&a, &slow), frame(&b, &fast), 0.5, Method::Advect);
    let error = error(&made, &blob_at(DVec3::X * 3.0));
    assert!(error < 0.01, "{error}");
}

/// A blob that moves by less than its radius is found without velocities. Where it is flat, nothing
/// shows the motion, which is then that of the surroundings.
#[test]
fn registration_finds_the_motion_of_a_blob() {
    let way = DVec3::new(6.0, -4.0, 2.0);
    let (a, b) = (blob_at(-0.5 * way), blob_at(0.5 * way));
    for t in [0.25, 0.5] {
        let truth = blob_at((t - 0.5) * way);
        let fade = error(&made(alone(&a), alone(&b), t, Method::CrossFade), &truth);
        let found = error(&made(alone(&a), alone(&b), t, Method::Register), &truth);
        assert!(found < 0.25 * fade, "{found} and {fade}");
    }
}

#[test]
fn what_stands_still_stays_as_it_is_even_if_velocities_say_otherwise() {
    // The source of a simulation: smoke flows out of it.
    let source = blob_at(DVec3::ZERO);
    let wind = velocities(4.0, false, |_| DVec3::Z * 12.0);
    let made = made(frame(&source, &wind), frame(&source, &wind), 0.5, Method::Register);
    let error = error(&made, &source);
    assert!(error < 0.01, "{error}");
}

#[test]
fn the_unit_of_velocities_is_found_within_five_percent() {
    // Voxels of 0.1, and velocities per second at 24 frames per second.
    let size = 0.1;
    let per_second = DVec3::new(9.0, 0.0, 12.0);
    let way = per_second / 24.0 / size;
    let place = DAffine3::from_scale(DVec3::splat(size));
    let at = |t: f64| fog(place, 30, |p| blob(p / size - (t - 0.5) * way));
    let (a, b) = (at(0.0), at(1.0));
    let wind = velocities(0.5, true, |_| per_second);
    let found = fit_velocity_scale(frame(&a, &wind), frame(&b, &wind)).unwrap().unwrap();
    assert!((found * 24.0 - 1.0).abs() < 0.05, "{found}");

    // Without a scale in the options, the same one is used.
    let auto = BetweenOptions { velocity_scale: None, ..options(Method::Advect) };
    let made = in_between(frame(&a, &wind), frame(&b, &wind), 0.5, &auto).unwrap();
    assert!(error(&made, &at(0.5)) < 0.03, "{}", error(&made, &at(0.5)));

    // Velocities that explain nothing have no unit, and those of one frame are not enough.
    assert_eq!(fit_velocity_scale(frame(&a, &wind), frame(&a, &wind)).unwrap(), None);
    assert_eq!(fit_velocity_scale(frame(&a, &wind), alone(&b)).unwrap(), None);
    let none = fog(place, 0, |_| 0.0);
    assert_eq!(fit_velocity_scale(frame(&none, &wind), frame(&none, &wind)).unwrap(), None);
}

#[test]
fn smoke_comes_out_of_an_empty_frame_and_goes_back_into_one() {
    let (smoke, none) = (blob_at(DVec3::ZERO), blob_at(DVec3::splat(1000.0)));
    assert_eq!(none.tree.active_voxel_count(), 0);
    let wind = velocities(4.0, false, |_| DVec3::ZERO);
    for method in [Method::CrossFade, Method::Advect, Method::Register] {
        for (from, to, t) in [(&none, &smoke, 0.25), (&smoke, &none, 0.75)] {
            let made = made(frame(from, &wind), frame(to, &wind), t, method);
            let quarter = fog(DAffine3::IDENTITY, 12, |p| 0.25 * blob(p));
            assert!(error(&made, &quarter) < 1e-6, "{method:?}: {}", error(&made, &quarter));
        }
        let made = made(frame(&none, &wind), frame(&none, &wind), 0.5, method);
        assert_eq!(made.tree.active_voxel_count(), 0);
    }
}

/// The second frame has voxels of another size and is turned. A cell of its lattice is up to 0.8
/// units wide, so its interpolation is as good as that of the first.
#[test]
fn frames_may_differ_in_their_transforms() {
    let way = DVec3::new(12.0, 5.0, -4.0);
    let other = DAffine3::from_translation(DVec3::new(3.3, -2.1, 0.7))
        * DAffine3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7)
        * DAffine3::from_scale(DVec3::new(0.8, 0.6, 0.7));
    let a = blob_at(DVec3::ZERO);
    let b = fog(other, 60, |p| blob(p - way));
    let wind = velocities(3.0, true, |_| way);
    for t in [0.5, 1.0] {
        let truth = blob_at(t * way);
        let made = made(frame(&a, &wind), frame(&b, &wind), t, Method::Advect);
        assert_eq!(made.transform, a.transform);
        assert!(error(&made, &truth) < 0.015, "{t}: {}", error(&made, &truth));
    }
    // And the other way round.
    let made = made(frame(&b, &wind), frame(&a, &wind), 1.0, Method::CrossFade);
    let truth = fog(other, 60, blob);
    assert!(error(&made, &truth) < 0.015, "{}", error(&made, &truth));
}

#[test]
fn frames_are_the_same_on_one_core_and_on_many() {
    let way = DVec3::new(6.0, -4.0, 2.0);
    let (a, b) = (blob_at(-0.5 * way), blob_at(0.5 * way));
    let wind = velocities(4.0, false, |_| 0.7 * way);
    let auto = BetweenOptions { velocity_scale: None, ..BetweenOptions::default() };
    let make = || in_between(frame(&a, &wind), frame(&b, &wind), 0.4, &auto).unwrap();
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    assert!(same(&pool(1).install(make), &pool(3).install(make)));
}
