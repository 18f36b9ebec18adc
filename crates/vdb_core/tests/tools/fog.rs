use glam::{DVec3, IVec3};
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tools::{Composition, FogFromLevelSet, ToolError, compose, fog_from_level_set};
use vdb_core::tree::{Found, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass, Transform};

use crate::shapes::{floats, voxels};

fn grid(tree: Vdb543<f32>, class: GridClass) -> Grid {
    let mut grid = Grid::new("volume", AnyTree::Float(tree.into()));
    grid.class = class;
    grid
}

#[test]
fn density_rises_below_the_surface() {
    let center = DVec3::new(0.3, 0.1, 0.2);
    let ball = grid(level_set::sphere(center, 70.0), GridClass::LevelSet);
    for (ramp, depth) in [(None, 3.0), (Some(2.0), 2.0), (Some(9.0), 3.0)] {
        let made =
            fog_from_level_set(&ball, &FogFromLevelSet { ramp, ..Default::default() }).unwrap();
        let tree = floats(&made);
        assert_eq!((made.class, tree.background()), (GridClass::FogVolume, 0.0));
        for ijk in voxels(-75, 75, 3) {
            let distance = floats(&ball).get(ijk);
            let (density, active) = tree.probe(ijk);
            let expected = (-distance / depth).clamp(0.0, 1.0);
            assert!((density - expected).abs() < 1e-6, "{ijk}: {density}, should be {expected}");
            assert_eq!(active, distance < 0.0, "{ijk}");
        }
        let Found::Tile(tile) = tree.find(IVec3::ZERO) else { panic!("a leaf in the middle") };
        assert_eq!((tile.value, tile.active), (1.0, true));
    }
    // A ball that is not as deep as the band: its middle is as dense as fog gets.
    let small = grid(level_set::sphere(DVec3::ZERO, 2.0), GridClass::LevelSet);
    let made = fog_from_level_set(&small, &FogFromLevelSet::default()).unwrap();
    assert_eq!(floats(&made).get(IVec3::ZERO), 1.0);
    assert_eq!(floats(&made).get(IVec3::X), 0.5);
    let none = grid(Vdb543::new(3.0), GridClass::LevelSet);
    let made = fog_from_level_set(&none, &FogFromLevelSet::default()).unwrap();
    assert_eq!(made.tree.active_voxel_count(), 0);
}

/// The fog of a level set, made one voxel or tile at a time.
fn one_by_one(tree: &Vdb543<f32>, ramp: f32) -> Vdb543<f32> {
    let mut fog = Vdb543::new(0.0);
    for own in tree.values().filter(|own| own.value < 0.0) {
        let density = (own.value * (-1.0 / ramp)).min(1.0);
        match own.log2_dim {
            _ if density <= 0.0 => {}
            0 => fog.set(own.origin, density),
            12 => fog.insert_tile(own.origin, density, true),
            log2_dim => {
                for offset in voxels(0, (1 << log2_dim) - 1, 8) {
                    fog.fill_leaf(own.origin + offset, density, true);
                }
            }
        }
    }
    fog.prune();
    fog
}

#[test]
fn every_voxel_and_every_tile_is_converted_bit_for_bit() {
    let mut tree = level_set::sphere(DVec3::new(0.3, 0.1, 0.2), 70.0);
    let mut random = Random::new(11);
    let odd = [f32::NAN, -0.0, f32::INFINITY, f32::NEG_INFINITY, -1e-45, -1e30, -1.0, 2.5];
    for _ in 0..2_000 {
        let mut axis = || random.below(160) as i32 - 80;
        let at = IVec3::new(axis(), axis(), axis());
        tree.set(at, odd[random.below(8) as usize]);
    }
    // A leaf with nothing inside, one that is all inside, and one of which nothing is left.
    for (x, value) in [(200, 1.0), (300, -2.0), (400, -1e-45)] {
        tree.touch_leaf(IVec3::new(x, 0, 0)).values_slice_mut().fill(value);
    }
    // Tiles of 128³ inside, and of 4096³ inside and outside.
    for (x, value) in [(512, -3.0), (1024, -0.5)] {
        for offset in voxels(0, 127, 8) {
            tree.fill_leaf(IVec3::new(x, 0, 0) + offset, value, false);
        }
    }
    tree.prune();
    for (y, value) in [(4096, -3.0), (8192, 3.0), (12288, 1.0)] {
        tree.insert_tile(IVec3::new(0, y, 0), value, false);
    }
    let level_set = grid(tree, GridClass::LevelSet);
    for (ramp, depth) in [(None, 3.0), (Some(0.7), 0.7), (Some(1e-30), 1e-30)] {
        let made = fog_from_level_set(&level_set, &FogFromLevelSet { ramp, ..Default::default() });
        let (made, expected) = (made.unwrap(), one_by_one(floats(&level_set), depth));
        let bits = |tree: &Vdb543<f32>| -> Vec<_> {
            let values = tree.values();
            values.map(|v| (v.origin, v.log2_dim, v.value.to_bits(), v.active)).collect()
        };
        assert!(bits(floats(&made)) == bits(&expected), "a ramp of {ramp:?}");
    }
}

#[test]
fn every_voxel_is_composed() {
    let mut random = Random::new(7);
    let mut patches = || {
        let mut tree = fog::sphere(DVec3::new(random.range(-9.0, 9.0), 1.0, 2.0), 30.0, 9.0);
        for _ in 0..500 {
            let mut axis = || random.below(80) as i32 - 40;
            let at = IVec3::new(axis(), axis(), axis());
            tree.set(at, random.unit() as f32);
            tree.set_inactive(at + 1, random.unit() as f32);
        }
        tree.insert_tile(IVec3::new(0, 4096, 0), 0.5, true);
        grid(tree, GridClass::FogVolume)
    };
    let (a, mut b) = (patches(), patches());
    let AnyTree::Float(tree) = &mut b.tree else { panic!("floats") };
    std::sync::Arc::make_mut(tree).insert_tile(IVec3::new(0, 0, 4096), 0.25, true);
    for composition in [Composition::Sum, Composition::Max, Composition::Multiply] {
        let made = compose(&a, &b, composition).unwrap();
        let far = [[5, 4100, 5], [5, 5, 4100]].map(IVec3::from_array);
        for ijk in voxels(-45, 45, 1).chain(far) {
            let [x, y] = [&a, &b].map(|grid| floats(grid).probe(ijk));
            let expected = match composition {
                Composition::Sum => (x.0 + y.0, x.1 || y.1),
                Composition::Max => (x.0.max(y.0), x.1 || y.1),
                Composition::Multiply => (x.0 * y.0, x.1 && y.1),
            };
            assert_eq!(floats(&made).probe(ijk), expected, "{composition:?} at {ijk}");
        }
    }
}

#[test]
fn what_is_no_level_set_or_elsewhere_is_refused() {
    let cloud = grid(fog::sphere(DVec3::ZERO, 9.0, 2.0), GridClass::FogVolume);
    let fog = |grid: &Grid, ramp: f32| {
        let options = FogFromLevelSet { ramp: Some(ramp), ..Default::default() };
        fog_from_level_set(grid, &options).unwrap_err()
    };
    assert_eq!(fog(&cloud, 1.0), ToolError::NotLevelSet { class: "fog volume" });
    let ball = grid(level_set::sphere(DVec3::ZERO, 9.0), GridClass::LevelSet);
    for ramp in [0.0, -1.0, f32::NAN] {
        let said = fog(&ball, ramp).to_string();
        assert!(said.starts_with(&format!("the ramp of the fog is {ramp}; ")), "{said}");
    }
    let mut other = cloud.clone();
    other.transform = Transform::uniform(0.5, DVec3::ZERO).unwrap();
    let error = compose(&cloud, &other, Composition::Sum).unwrap_err();
    assert_eq!(error, ToolError::TransformsDiffer);
}
