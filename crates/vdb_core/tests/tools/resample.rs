use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::{DAffine3, DMat3, DQuat, DVec3, IVec3};
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tools::{Interpolation, Resample, ToolError, resample};
use vdb_core::tree::{CoordBox, Found, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass, Transform};

use crate::shapes::{floats, voxels};
use crate::trees::same_any;

fn fog_grid(tree: Vdb543<f32>, transform: Transform) -> Grid {
    let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
    (grid.class, grid.transform) = (GridClass::FogVolume, transform);
    grid
}

/// A map that turns, shears and mirrors.
fn skewed(size: f64) -> Transform {
    let turn =
        DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7));
    let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.2, 1.1, 0.0), DVec3::new(0.0, 0.1, -0.9));
    let translation = DVec3::new(0.3, -1.7, 2.2);
    Transform::affine(DAffine3 { matrix3: turn * shear * size, translation }).unwrap()
}

/// Noise with tiles, holes, and values in voxels that are not active.
fn patchy() -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.25);
    let mut random = Random::new(3);
    for _ in 0..4000 {
        let mut axis = || random.below(48) as i32 - 24;
        tree.set(IVec3::new(axis(), axis(), axis()), 0.0);
    }
    for ijk in voxels(-24, 23, 1) {
        match random.below(4) {
            0 => tree.set(ijk, random.unit() as f32),
            1 => tree.set_inactive(ijk, random.unit() as f32),
            _ => {}
        }
    }
    tree.fill_leaf(IVec3::new(8, 0, -8), 0.75, true);
    tree.fill_leaf(IVec3::new(-32, 0, 0), 0.5, false);
    tree
}

/// The value of a tree at a point, and whether a voxel that it is made of is active.
fn expected(tree: &Vdb543<f32>, p: DVec3, interpolation: Interpolation) -> (f64, bool) {
    if interpolation == Interpolation::Nearest {
        let (value, active) = tree.probe((p + 0.5).floor().as_ivec3());
        return (value.into(), active);
    }
    let (mut sum, mut any) = (0.0, false);
    for corner in 0..8 {
        let offset = IVec3::new(corner >> 2, corner >> 1 & 1, corner & 1);
        let at = p.floor().as_ivec3() + offset;
        let weight = (1.0 - (p - at.as_dvec3()).abs()).max(DVec3::ZERO).element_product();
        let (value, active) = tree.probe(at);
        sum += weight * f64::from(value);
        any |= active && weight > 0.0;
    }
    (sum, any)
}

#[test]
fn every_voxel_is_that_of_brute_force() {
    let tree = patchy();
    let from = skewed(0.25);
    let grid = fog_grid(tree.clone(), from.clone());
    for interpolation in [Interpolation::Nearest, Interpolation::Trilinear] {
        // Smaller voxels, of about the same size, and so large that boxes are not read at once.
        for size in [0.1, 0.27, 1.9] {
            let to = Transform::uniform(size, DVec3::new(0.03, 0.02, -0.01)).unwrap();
            let options = Resample { interpolation, ..Resample::new(to.clone()) };
            let made = resample(&grid, &options).unwrap();
            assert_eq!((made.transform.clone(), made.class), (to.clone(), GridClass::FogVolume));
            let reach = (16.0 / size) as i32;
            let (mut active, mut rest) = (0, 0);
            for ijk in voxels(-reach, reach, if size < 0.2 { 3 } else { 1 }) {
                let p = from.index_from_world(to.world_from_index(ijk.as_dvec3()));
                let (value, on) = expected(&tree, p, interpolation);
                let own = floats(&made).probe(ijk);
                let off = f64::from(own.0) - value;
                assert!(off.abs() < 1e-6 && own.1 == on, "{ijk} at {p}: {own:?}, {value} {on}");
                active += u64::from(on);
                rest += u64::from(!on && value != 0.25);
            }
            assert!(active > 50 && rest > 50, "{active}, {rest}");
        }
    }
}

#[test]
fn the_same_voxels_are_the_same_tree() {
    let mut tree = patchy();
    tree.insert_tile(IVec3::new(4096, 0, 0), 2.0, true);
    tree.prune();
    for transform in [skewed(0.31), Transform::uniform(0.3, DVec3::new(0.1, 7.0, -3.3)).unwrap()] {
        let made = resample(&fog_grid(tree.clone(), transform.clone()), &Resample::new(transform));
        assert!(same_any(&made.unwrap().tree, &AnyTree::Float(tree.clone().into())));
    }
}

#[test]
fn linear_fields_stay_linear() {
    let slope = DVec3::new(0.5, -0.25, 0.125);
    let bbox = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) };
    let from = skewed(0.5);
    let grid = fog_grid(fog::ramp(bbox, slope, 3.0), from.clone());
    let to = Transform::uniform(0.37, DVec3::ZERO).unwrap();
    let made = resample(&grid, &Resample::new(to.clone())).unwrap();
    let mut count = 0;
    for ijk in voxels(-20, 20, 1) {
        let p = from.index_from_world(to.world_from_index(ijk.as_dvec3()));
        if p.abs().max_element() < 19.9 {
            let own = floats(&made).probe(ijk);
            let value = 3.0 + slope.dot(p);
            assert!((f64::from(own.0) - value).abs() < 2e-6 && own.1, "{ijk}: {own:?}, {value}");
            count += 1;
        }
    }
    assert!(count > 20_000, "{count}");
}

#[test]
fn tiles_stay_tiles() {
    let mut tree = Vdb543::new(0.0);
    tree.insert_tile(IVec3::ZERO, 1.0, true);
    let grid = fog_grid(tree, Transform::default());
    let to = Transform::uniform(2.0, DVec3::ZERO).unwrap();
    let made = resample(&grid, &Resample::new(to)).unwrap();
    let Found::Tile(tile) = floats(&made).find(IVec3::splat(1000)) else { panic!("a leaf") };
    assert_eq!((tile.value, tile.active, tile.log2_dim), (1.0, true, 7));
    // Every second of 0 to 4095, and the voxels beside them that are half of it.
    assert_eq!(made.tree.active_bbox().unwrap().max, IVec3::splat(2047));
    assert_eq!(made.tree.active_voxel_count(), 2048_u64.pow(3));
}

#[test]
fn level_sets_have_distances_in_the_new_voxels() {
    let (center, radius, size) = (DVec3::new(1.3, 0.2, -0.4), 20.0, 0.5);
    let mut grid = Grid::new(
        "ball",
        AnyTree::Float(
            vdb_core::tree::map_values(
                &level_set::sphere(center / size, radius / size),
                |v: f32| v * size as f32,
            )
            .into(),
        ),
    );
    grid.class = GridClass::LevelSet;
    grid.transform = Transform::uniform(size, DVec3::ZERO).unwrap();
    let turned = DMat3::from_quat(DQuat::from_axis_angle(DVec3::Z, 0.4));
    for (new, turn) in [(0.2, DMat3::IDENTITY), (0.5, turned), (1.7, turned), (5.0, turned)] {
        let translation = DVec3::new(0.11, 0.07, 0.0);
        let to = Transform::affine(DAffine3 { matrix3: turn * new, translation }).unwrap();
        let made = resample(&grid, &Resample::new(to.clone())).unwrap();
        let tree = floats(&made);
        assert_eq!(made.class, GridClass::LevelSet);
        assert_eq!(tree.background(), (3.0 * new) as f32);
        let reach = (26.0 / new) as i32;
        let mut signs = 0;
        for ijk in voxels(-reach, reach, if new < 0.3 { 3 } else { 1 }) {
            let distance = to.world_from_index(ijk.as_dvec3()).distance(center) - radius;
            let (value, active) = tree.probe(ijk);
            let expected = distance.clamp(-3.0 * new, 3.0 * new);
            // The roots of the old voxels, and the chords between them: `size²/8r + 3/8 size²/r`.
            let bound = 1.1 * size * size / (2.0 * radius);
            assert!((f64::from(value) - expected).abs() < bound, "{ijk}: {value}, {expected}");
            assert!(active == (value.abs() < tree.background()), "{ijk}");
            signs += u64::from(value < 0.0);
        }
        assert!(signs > 100, "{signs}");
    }
}

#[test]
fn level_sets_of_stretched_voxels_become_cubes() {
    // A ball of radius 20 in the world, with voxels of 1 x 1 x 2: its distances are those of the world.
    let bbox = CoordBox { min: IVec3::splat(-25), max: IVec3::splat(25) };
    let size = DVec3::new(1.0, 1.0, 2.0);
    let tree = fog::from_values(bbox, |ijk| {
        ((ijk.as_dvec3() * size).length() as f32 - 20.0).clamp(-6.0, 6.0)
    });
    let mut own = Vdb543::new(6.0);
    tree.active_values().for_each(|value| own.set(value.origin, value.value));
    let mut grid = fog_grid(own, Transform::affine(DAffine3::from_scale(size)).unwrap());
    grid.class = GridClass::LevelSet;
    let options = Resample::with_voxel_size(&grid, 1.0).unwrap();
    let made = resample(&grid, &options).unwrap();
    assert_eq!(floats(&made).background(), 6.0);
    for ijk in voxels(-26, 26, 1) {
        let expected = (ijk.as_dvec3().length() - 20.0).clamp(-6.0, 6.0);
        let value = f64::from(floats(&made).get(ijk));
        // Chords and roots of voxels that are up to 2 long.
        assert!((value - expected).abs() < 4.0 / 40.0, "{ijk}: {value}, should be {expected}");
    }
}

#[test]
fn sizes_of_voxels_keep_axes_and_origin() {
    let tree = patchy();
    for from in [skewed(0.25), Transform::uniform(0.25, DVec3::ONE).unwrap()] {
        let grid = fog_grid(tree.clone(), from.clone());
        let to = Resample::with_voxel_size(&grid, 0.125).unwrap().transform;
        assert!((to.voxel_size() - 0.125).abs().max_element() < 1e-12);
        let [own, new] = [&from, &to].map(|t| t.world_from_index(DVec3::ZERO));
        assert!((own - new).length() < 1e-12);
    }
    let matrix3 = DMat3::from_quat(DQuat::from_rotation_x(0.3))
        * DMat3::from_diagonal(DVec3::new(0.5, 1.0, 2.0));
    let from = Transform::affine(DAffine3 { matrix3, translation: DVec3::Y }).unwrap();
    let to = Resample::with_voxel_size(&fog_grid(tree, from), 0.1).unwrap().transform;
    let axis = to.world_from_index(DVec3::Z) - to.world_from_index(DVec3::ZERO);
    assert!((axis.normalize() - matrix3.z_axis.normalize()).length() < 1e-12, "{axis}");
}

#[test]
fn what_cannot_be_resampled_is_refused_before_memory_is_taken() {
    let start = Instant::now();
    let grid = fog_grid(patchy(), Transform::default());
    for size in [0.0, -1.0, f64::NAN, 1e40, 1e-300] {
        let said = Resample::with_voxel_size(&grid, size).unwrap_err().to_string();
        assert!(said.starts_with(&format!("the voxel size is {size}; it must be ")), "{said}");
    }
    let mut ball = fog_grid(level_set::sphere(DVec3::ZERO, 20.0), Transform::default());
    ball.class = GridClass::LevelSet;
    for grid in [&grid, &ball] {
        let options = Resample::with_voxel_size(grid, 1e-3).unwrap();
        match resample(grid, &options) {
            Err(ToolError::TooManyVoxels { voxels, limit }) => {
                assert!((1e10..1e14).contains(&voxels), "{voxels}");
                assert_eq!(limit, options.limits.tree_bytes);
            }
            other => panic!("{other:?}"),
        }
    }
    // Nothing is begun that surely does not fit.
    let begun: Arc<vdb_core::ProgressFn> = Arc::new(|_, _| panic!("it has begun"));
    for grid in [&grid, &ball] {
        let options = Resample::with_voxel_size(grid, 0.004).unwrap();
        let error = resample(grid, &Resample { progress: Some(begun.clone()), ..options });
        assert!(matches!(error, Err(ToolError::TooManyVoxels { .. })), "{error:?}");
    }
    // A tile has no leaves, and yet a result with too many nodes.
    let mut tile = Vdb543::new(0.0);
    tile.insert_tile(IVec3::ZERO, 1.0, true);
    let tile = fog_grid(tile, Transform::default());
    let tiny = Resample::with_voxel_size(&tile, 1e-3).unwrap();
    assert!(matches!(resample(&tile, &tiny), Err(ToolError::TooManyVoxels { .. })));

    let long = DAffine3::from_scale(DVec3::new(1.0, 1.0, 2.0));
    let long = Resample::new(Transform::affine(long).unwrap());
    assert_eq!(resample(&ball, &long).unwrap_err(), ToolError::NotCubes { size: [1.0, 1.0, 2.0] });
    let mut words = grid.clone();
    words.tree = AnyTree::Int32(Vdb543::new(1).into());
    let same = Resample::new(Transform::default());
    assert_eq!(resample(&words, &same).unwrap_err(), ToolError::NotFloats);
    let cancelled = Resample { progress: Some(Arc::new(|_, _| ControlFlow::Break(()))), ..same };
    assert_eq!(resample(&grid, &cancelled).unwrap_err(), ToolError::Cancelled);
    assert_eq!(resample(&ball, &cancelled).unwrap_err(), ToolError::Cancelled);
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
}

#[test]
fn the_ends_of_the_index_space_are_no_special_case() {
    let mut tree = Vdb543::new(0.0);
    for corner in [IVec3::splat(i32::MIN), IVec3::splat(i32::MAX)] {
        tree.set(corner, 1.0);
    }
    let grid = fog_grid(tree, Transform::default());
    // Twice as large: half as far. The whole would be 2³² voxels wide, of which most is nothing.
    let to = Transform::uniform(4096.0, DVec3::ZERO).unwrap();
    let made = resample(&grid, &Resample::new(to)).unwrap();
    assert_eq!(floats(&made).get(IVec3::splat(-(1 << 19))), 1.0);
    assert_eq!(floats(&made).probe(IVec3::splat(1 << 19)), (0.0, false));
    let small = Transform::uniform(0.5, DVec3::ZERO).unwrap();
    let error = resample(&grid, &Resample::new(small)).unwrap_err();
    assert!(error.to_string().starts_with("the result reaches 4.3e9 voxels"), "{error}");
    let same = resample(&grid, &Resample::new(Transform::default())).unwrap();
    assert!(same_any(&same.tree, &grid.tree));
}
