use std::ops::ControlFlow;
use std::sync::Arc;

use glam::DVec3;
use vdb_core::synth::level_set;
use vdb_core::tools::{Offset, ToolError, offset};
use vdb_core::tree::{Vdb543, map_values};
use vdb_core::{AnyTree, Grid, GridClass, Transform};

use crate::shapes::{floats, voxels};

/// A level set in voxels of this size.
fn solid(tree: &Vdb543<f32>, size: f64) -> Grid {
    let tree = map_values(tree, |value: f32| value * size as f32);
    let mut grid = Grid::new("solid", AnyTree::Float(tree.into()));
    grid.class = GridClass::LevelSet;
    grid.transform = Transform::uniform(size, DVec3::ZERO).unwrap();
    grid
}

#[test]
fn spheres_stay_spheres() {
    let (center, size) = (DVec3::new(0.3, -0.2, 0.4), 0.25);
    let ball = solid(&level_set::sphere(center, 25.0), size);
    for voxels_moved in [0.0, 0.7, -0.7, 3.0, -9.0, 13.0] {
        let made = offset(&ball, &Offset::new(voxels_moved * size)).unwrap();
        let tree = floats(&made);
        assert_eq!((made.class, tree.background()), (GridClass::LevelSet, 0.75));
        let radius = 25.0 + voxels_moved;
        // Each step has roots that are off by 1 / 8r, and chords by 3 / 8r: inwards, so that they add.
        let steps = (voxels_moved.abs() / 2.0).ceil().max(1.0);
        let bound = steps / (2.0 * (radius.min(25.0) - 4.0));
        let reach = radius as i32 + 6;
        for ijk in voxels(-reach, reach, 1) {
            let expected = (ijk.as_dvec3().distance(center) - radius).clamp(-3.0, 3.0);
            let (value, active) = tree.probe(ijk);
            let value = f64::from(value) / size;
            assert!((value - expected).abs() < bound, "{ijk}: {value}, should be {expected}");
            assert_eq!(active, value.abs() < 3.0, "{ijk}");
        }
    }
}

#[test]
fn a_cube_gets_round_edges_outwards_and_keeps_sharp_ones_inwards() {
    let cube = solid(&level_set::cuboid(DVec3::splat(-20.3), DVec3::splat(20.3)), 1.0);
    let grown = offset(&cube, &Offset::new(5.0)).unwrap();
    let shrunk = offset(&cube, &Offset::new(-5.0)).unwrap();
    for ijk in voxels(-28, 28, 1) {
        let q = ijk.as_dvec3().abs() - 20.3;
        let distance = q.max(DVec3::ZERO).length() + q.max_element().min(0.0);
        let value = f64::from(floats(&grown).get(ijk));
        // Edges are cut off within a cell: once here, by less than half of its diagonal.
        let expected = (distance - 5.0).clamp(-3.0, 3.0);
        assert!((value - expected).abs() < 0.5, "{ijk}: {value}, should be {expected}");
        let q = ijk.as_dvec3().abs() - 15.3;
        let expected = q.max(DVec3::ZERO).length() + q.max_element().min(0.0);
        let value = f64::from(floats(&shrunk).get(ijk));
        let off = (value - expected.clamp(-3.0, 3.0)).abs();
        assert!(off < 0.87, "{ijk}: {value}, should be {expected}");
    }
}

#[test]
fn what_cannot_be_moved_is_refused() {
    let ball = solid(&level_set::sphere(DVec3::ZERO, 10.0), 0.5);
    let error = |grid: &Grid, options: &Offset| offset(grid, options).unwrap_err();
    let said = error(&ball, &Offset::new(-6.0)).to_string();
    // In steps of two voxels, and its radius is ten.
    assert_eq!(said, "Moved by -10.00 voxels, the level set has no surface any more; do less");
    let said = error(&ball, &Offset::new(1e9)).to_string();
    assert_eq!(said, "the offset in voxels is 2000000000; it must be from -1000 to 1000");
    assert!(error(&ball, &Offset::new(f64::NAN)).to_string().contains("is NaN; "));
    let mut fog = ball.clone();
    fog.class = GridClass::FogVolume;
    assert_eq!(error(&fog, &Offset::new(1.0)), ToolError::NotLevelSet { class: "fog volume" });
    let mut flat = ball.clone();
    flat.transform = Transform::uniform(100.0, DVec3::ZERO).unwrap();
    let said = error(&flat, &Offset::new(1.0)).to_string();
    assert!(
        said.starts_with("the background of the level set is 1.5, with voxels of 100"),
        "{said}"
    );
    let mut tight = Offset::new(1.0);
    tight.limits.tree_bytes = 300_000;
    assert!(matches!(error(&ball, &tight), ToolError::TooManyVoxels { .. }));
    let progress: Arc<vdb_core::ProgressFn> = Arc::new(|_, _| ControlFlow::Break(()));
    let cancelled = Offset { progress: Some(progress), ..Offset::new(1.0) };
    assert_eq!(error(&ball, &cancelled), ToolError::Cancelled);
}
