//! The grids of the matrix.

use glam::{DVec3, IVec3};
use vdb_core::synth::{Random, Uniform, build, fog, level_set, sparse};
use vdb_core::tree::{CoordBox, Node, RootEntry, Vdb543};

pub type Tree = Vdb543<f32>;

/// A grid by its name, made when it is its turn.
pub struct Named {
    pub name: String,
    pub make: Box<dyn Fn() -> Tree>,
}

fn named(name: impl Into<String>, make: impl Fn() -> Tree + 'static) -> Named {
    Named { name: name.into(), make: Box::new(make) }
}

pub fn cube(min: i32, max: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) }
}

/// The lowest and the highest place of index space that a grid can touch: OpenVDB's leaves end
/// there, and rays must have room around it.
pub const LIMIT: i32 = i32::MAX - 9;

/// Places in index space.
pub const OFFSETS: [(&str, i32); 9] = [
    ("0", 0),
    ("1e4", 10_000),
    ("-1e4", -10_000),
    ("2^24", 1 << 24),
    ("-2^24", -(1 << 24)),
    ("2^30", 1 << 30),
    ("-2^30", -(1 << 30)),
    ("2^31-9", LIMIT),
    ("-(2^31-9)", -LIMIT),
];

/// Voxels of a level set's value -1 where a grid is active, in a background of 1.
pub fn solid(positive: &Tree) -> Tree {
    let mut tree = Vdb543::new(1.0);
    for value in positive.active_values() {
        let edge = 1 << value.log2_dim;
        for x in 0..edge {
            for y in 0..edge {
                (0..edge).for_each(|z| tree.set(value.origin + IVec3::new(x, y, z), -1.0));
            }
        }
    }
    tree
}

/// Noise of both signs in a box: every cell crosses zero.
pub fn noise(bbox: CoordBox, background: f32, seed: u64) -> Tree {
    let value = move |ijk: IVec3| {
        let at = (ijk - bbox.min).as_uvec3();
        let key = u64::from(at.x) | u64::from(at.y) << 21 | u64::from(at.z) << 42;
        let mut random = Random::new(seed ^ key.wrapping_mul(0xa24b_aed4_963e_e407));
        (random.range(-1.0, 1.0) as f32, true)
    };
    build(background, bbox, |_| Uniform::No, value)
}

/// A ball of nothing in a background below the iso-value.
fn hollow() -> Tree {
    let ball = level_set::sphere(DVec3::new(5.3, -3.7, 40.1), 20.3);
    let mut tree = Vdb543::new(-ball.background());
    for voxel in ball.active_values() {
        tree.set(voxel.origin, -voxel.value);
    }
    // What is inactive within, too.
    for x in -16..=26 {
        for y in -24..=17 {
            for z in 19..=61 {
                let voxel = IVec3::new(x, y, z);
                tree.set(voxel, -ball.get(voxel));
            }
        }
    }
    tree
}

/// A tile of each level, leaves beside them, and a tile of the root, of a value.
pub fn tiles(value: f32, background: f32) -> Tree {
    let mut tree = Vdb543::new(background);
    // 4096³ voxels.
    tree.insert_tile(IVec3::new(-4096, 0, 0), value, true);
    // 128³ and 8³, and leaves.
    for (_, entry) in blocks(value, background).entries() {
        if let RootEntry::Child(child) = entry
            && child.origin() != IVec3::new(-4096, 0, 0)
        {
            tree.insert_child(child.clone());
        }
    }
    tree
}

/// What is hard on a traversal, solid below zero.
pub fn solids() -> Vec<Named> {
    let far = IVec3::splat(2_000_000);
    let mut grids = vec![
        named("one voxel", || solid(&sparse::voxels(&[IVec3::new(7, 8, -9)]))),
        named("two voxels two million apart", move || solid(&sparse::voxels(&[IVec3::ZERO, far]))),
        named("checkerboard", || solid(&sparse::checkerboard(cube(-9, 10)))),
        named("solid block", || fog::block(cube(-70, 80), -1.0)),
        named("tiles of every level", || tiles(-1.0, 1.0)),
        named("box one voxel thick", || solid(&sparse::box_shell(cube(-20, 13)))),
        named("sphere one voxel thick", || {
            solid(&sparse::sphere_shell(DVec3::new(0.3, 5.2, -7.1), 24.0))
        }),
        named("truss", || solid(&sparse::truss(cube(-30, 33), 9, 2))),
        named("random voxels, 1 %", || solid(&sparse::random(cube(-40, 40), 0.01, 5))),
        named("random voxels, 30 %", || solid(&sparse::random(cube(-12, 13), 0.3, 6))),
        named("hollow in a solid background", hollow),
    ];
    grids.extend(level_sets());
    grids
}

/// Level sets, and noise of both signs.
pub fn level_sets() -> Vec<Named> {
    let slab = CoordBox { min: IVec3::splat(-40), max: IVec3::splat(40) };
    vec![
        named("sphere", || level_set::sphere(DVec3::new(3.3, -200.7, 40.1), 30.3)),
        named("torus a million voxels out", || level_set::torus(DVec3::splat(1e6), 40.0, 12.5)),
        named("cuboid", || level_set::cuboid(DVec3::splat(-20.5), DVec3::new(30.2, 7.7, 15.1))),
        named("gyroid", || level_set::gyroid(DVec3::ZERO, 40.0, 18.0)),
        named("slab of one voxel", move || level_set::slab_x(3.2, 4.1, slab)),
        named("noise of both signs", || noise(cube(-20, 20), 1.0, 9)),
    ]
}

/// Where values change their sign.
pub fn crossings() -> Vec<Named> {
    let far = IVec3::splat(2_000_000);
    let mut grids = level_sets();
    grids.extend([
        named("one voxel", || solid(&sparse::voxels(&[IVec3::new(7, 8, -9)]))),
        named("two voxels two million apart", move || solid(&sparse::voxels(&[IVec3::ZERO, far]))),
        named("checkerboard", || solid(&sparse::checkerboard(cube(-9, 10)))),
        named("box one voxel thick", || solid(&sparse::box_shell(cube(-20, 13)))),
        named("truss", || solid(&sparse::truss(cube(-30, 33), 9, 2))),
        named("tiles of two levels", || blocks(-1.0, 1.0)),
        named("hollow in a solid background", hollow),
    ]);
    grids
}

/// Densities.
pub fn fogs() -> Vec<Named> {
    let far = IVec3::splat(2_000_000);
    let mut grids = vec![
        named("homogeneous block", || fog::block(cube(-16, 31), 0.25)),
        named("ball", || fog::sphere(DVec3::new(10.0, -30.0, 4090.0), 25.0, 6.0)),
        named("ramp", || fog::ramp(cube(-20, 37), DVec3::new(0.01, 0.02, 0.005), 1.0)),
        named("one voxel", || sparse::voxels(&[IVec3::new(7, 8, -9)])),
        named("two voxels two million apart", move || sparse::voxels(&[IVec3::ZERO, far])),
        named("checkerboard", || sparse::checkerboard(cube(-9, 10))),
        named("random voxels, 5 %", || sparse::random(cube(-20, 20), 0.05, 9)),
        named("noise of both signs", || noise(cube(-20, 20), 0.0, 9)),
        named("tiles of two levels", || blocks(0.01, 0.0)),
        named("densities of every kind", densities),
    ];
    grids.extend(OFFSETS.into_iter().map(|(name, at)| {
        named(format!("offset {name}"), move || fog::sphere(at_offset(at), BALL, 5.0))
    }));
    grids
}

/// Tiles of 8³ and of 128³, and the leaves of what does not fit.
pub fn blocks(value: f32, background: f32) -> Tree {
    let bbox = CoordBox { min: IVec3::new(-3, 0, -130), max: IVec3::new(161, 143, 141) };
    let blocks = build(background, bbox, |_| Uniform::Yes(value, true), |_| (value, true));
    let has = |level| blocks.active_values().any(|found| found.log2_dim == level);
    assert!(has(0) && has(3) && has(7));
    blocks
}

/// Voxels whose densities are zero, denormal, small, huge, infinite, negative or no number.
fn densities() -> Tree {
    let kinds = [0.0, 1e-45, 1e-40, 1e-30, 0.5, 1.0, 1e30, f32::MAX, f32::INFINITY, f32::NAN, -1.0];
    let value = move |ijk: IVec3| {
        let at = (ijk + 64).as_uvec3();
        let mut random =
            Random::new(u64::from(at.x) | u64::from(at.y) << 21 | u64::from(at.z) << 42);
        // Mostly nothing, so that light comes through somewhere.
        let kind = if random.below(8) == 0 { random.below(kinds.len() as u64) } else { 0 };
        (kinds[kind as usize], true)
    };
    build(0.0, cube(-20, 20), |_| Uniform::No, value)
}

/// A ball at an offset on all three axes, within the index space.
pub fn at_offset(offset: i32) -> DVec3 {
    /// Voxels from the centre of the ball to the end of its narrow band.
    const ROOM: f64 = 20.75;
    let limit = f64::from(LIMIT) - ROOM;
    DVec3::splat(f64::from(offset).clamp(-limit, limit)) + DVec3::new(0.375, -0.25, 0.125)
}

/// Radius of the ball at an offset.
pub const BALL: f64 = 17.3;

/// The same ball at every offset.
pub fn offsets() -> impl Iterator<Item = (&'static str, Tree)> {
    OFFSETS.into_iter().map(|(name, at)| (name, ball(at)))
}

/// The ball at one offset.
pub fn ball(offset: i32) -> Tree {
    level_set::sphere(at_offset(offset), BALL)
}
