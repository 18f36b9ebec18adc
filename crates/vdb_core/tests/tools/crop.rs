use glam::{DAffine3, DMat3, DQuat, DVec3, IVec3};
use vdb_core::synth::{fog, level_set};
use vdb_core::tools::{Crop, ToolError, crop};
use vdb_core::tree::{Found, Vdb543, map_values};
use vdb_core::{AnyTree, Grid, GridClass, Transform};

use crate::shapes::{floats, voxels};

fn grid(tree: AnyTree, class: GridClass, transform: Transform) -> Grid {
    let mut grid = Grid::new("volume", tree);
    (grid.class, grid.transform) = (class, transform);
    grid
}

fn turned(size: f64) -> Transform {
    let matrix3 = DMat3::from_quat(DQuat::from_rotation_y(0.6)) * size;
    Transform::affine(DAffine3 { matrix3, translation: DVec3::new(0.7, 0.1, -0.2) }).unwrap()
}

#[test]
fn voxels_in_the_box_stay_and_the_rest_is_background() {
    let mut tree = fog::sphere(DVec3::new(0.4, 0.2, 0.1), 40.0, 6.0);
    tree.set_inactive(IVec3::new(3, 3, 3), 0.4);
    let (low, high) = (DVec3::new(-3.0, -20.0, -0.25), DVec3::new(12.0, 4.0, 9.0));
    for transform in [Transform::uniform(0.5, DVec3::ZERO).unwrap(), turned(0.5)] {
        let own =
            grid(AnyTree::Float(tree.clone().into()), GridClass::FogVolume, transform.clone());
        let made = crop(&own, &Crop::new(low, high)).unwrap();
        let (mut kept, mut tiles) = (0, 0);
        for ijk in voxels(-45, 45, 1) {
            let p = transform.world_from_index(ijk.as_dvec3());
            let inside = low.cmple(p).all() && p.cmple(high).all();
            let expected = if inside { tree.probe(ijk) } else { (0.0, false) };
            assert_eq!(floats(&made).probe(ijk), expected, "{ijk} at {p}");
            kept += u64::from(inside);
            tiles += u64::from(matches!(floats(&made).find(ijk), Found::Tile(_)) && inside);
        }
        assert!(kept > 10_000 && tiles > 1000, "{kept}, {tiles}");
    }
}

#[test]
fn grids_of_any_type_can_be_cropped() {
    let ball = fog::sphere(DVec3::ZERO, 20.0, 6.0);
    let vectors = map_values(&ball, |value: f32| [value, 1.0, 2.0]);
    let numbers = map_values(&ball, |value: f32| (100.0 * value) as i32);
    let crop = |tree: AnyTree| {
        let own = grid(tree, GridClass::Unknown, Transform::default());
        crop(&own, &Crop::new(DVec3::ZERO, DVec3::INFINITY)).unwrap().tree
    };
    let AnyTree::Vec3s(vectors) = crop(AnyTree::Vec3s(vectors.into())) else { panic!("vec3s") };
    assert_eq!(vectors.probe(IVec3::new(0, 0, 1)), ([1.0, 1.0, 2.0], true));
    assert_eq!(vectors.probe(IVec3::new(0, 0, -1)), ([0.0, 1.0, 2.0], false));
    let AnyTree::Int32(numbers) = crop(AnyTree::Int32(numbers.into())) else { panic!("int32") };
    assert_eq!(numbers.probe(IVec3::new(17, 0, 0)), (50, true));
    assert_eq!(numbers.probe(IVec3::new(-17, 0, 0)), (0, false));
    let mut mask = vdb_core::tree::MaskTree::new(false);
    mask.set(IVec3::new(1, 2, 3), true);
    mask.set(IVec3::new(1, -2, 3), true);
    mask.insert_tile(IVec3::new(4096, -4096, 0), true, true);
    assert_eq!(crop(AnyTree::Mask(mask.into())).active_voxel_count(), 1);
}

#[test]
fn level_sets_are_cut_straight() {
    let (center, radius) = (DVec3::new(0.3, 0.2, -0.4), 25.0);
    let (low, high) = (DVec3::new(-60.0, -9.7, -60.0), DVec3::new(8.3, 60.0, 60.0));
    for transform in [Transform::default(), turned(1.0)] {
        let tree = level_set::sphere(center, radius);
        let own = grid(AnyTree::Float(tree.clone().into()), GridClass::LevelSet, transform.clone());
        let made = crop(&own, &Crop::new(low, high)).unwrap();
        let mut cut = 0;
        for ijk in voxels(-32, 32, 1) {
            let p = transform.world_from_index(ijk.as_dvec3());
            let outside = (low - p).max(p - high);
            let from_box = outside.max(DVec3::ZERO).length() + outside.max_element().min(0.0);
            let expected = f64::from(tree.get(ijk)).max(from_box).clamp(-3.0, 3.0);
            let (value, active) = floats(&made).probe(ijk);
            assert!((f64::from(value) - expected).abs() < 1e-5, "{ijk}: {value}, {expected}");
            assert_eq!(active, value.abs() < 3.0, "{ijk}: {value}");
            cut += u64::from(active && tree.get(ijk) == -3.0);
        }
        assert!(cut > 2000, "{cut}");
    }
}

#[test]
fn large_tiles_are_split_only_at_the_box() {
    let mut tree = Vdb543::new(0.0);
    tree.insert_tile(IVec3::ZERO, 1.0, true);
    let own = grid(AnyTree::Float(tree.into()), GridClass::FogVolume, Transform::default());
    let made = crop(&own, &Crop::new(DVec3::splat(100.0), DVec3::splat(300.5))).unwrap();
    assert_eq!(made.tree.active_voxel_count(), 201_u64.pow(3));
    assert!(made.tree.stats().leaf_count() < 6 * 26 * 26, "{:?}", made.tree.stats());
    // A plane through a tile of 4096³ voxels passes through 512² leaves.
    let half = Crop::new(DVec3::NEG_INFINITY, DVec3::new(1000.5, f64::INFINITY, f64::INFINITY));
    assert_eq!(crop(&own, &half).unwrap().tree.active_voxel_count(), 1001 * 4096 * 4096);
    let mut tight = half;
    tight.limits.tree_bytes = 100 << 20;
    assert!(matches!(crop(&own, &tight), Err(ToolError::TooManyVoxels { .. })));
}

#[test]
fn boxes_without_an_inside_are_refused() {
    let own =
        grid(AnyTree::Float(Vdb543::new(0.0).into()), GridClass::Unknown, Transform::default());
    for (low, high) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0)] {
        let said = crop(&own, &Crop::new(DVec3::splat(low), DVec3::splat(high))).unwrap_err();
        let said = said.to_string();
        assert!(said.starts_with(&format!("the box from [{low:?}, ")), "{said}");
    }
}
