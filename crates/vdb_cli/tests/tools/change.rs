//! `vdb resample`, `crop`, `offset` and `smooth`.

use std::path::Path;
use std::sync::Arc;

use glam::{DVec3, IVec3};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{Vdb543, map_values};
use vdb_core::{AnyTree, Grid, GridClass, Transform, VdbFile, WriteOptions};

use crate::{done, fails, folder, path, vdb};

/// A fog, a level set of the same ball, and a grid of whole numbers.
fn three_grids(path: &str) {
    let center = DVec3::new(0.5, 0.0, 0.0);
    let ball = level_set::sphere(center, 20.0);
    let cloud = fog::sphere(center, 20.0, 4.0);
    let numbers = map_values(&cloud, |value: f32| (9.0 * value) as i32);
    let grid = |name: &str, tree: AnyTree, class: GridClass| {
        let mut grid = Grid::new(name, tree);
        grid.class = class;
        grid
    };
    VdbFile::new(vec![
        grid("density", AnyTree::Float(cloud.into()), GridClass::FogVolume),
        grid("surface", AnyTree::Float(ball.into()), GridClass::LevelSet),
        grid("id", AnyTree::Int32(numbers.into()), GridClass::Unknown),
    ])
    .save(path, &WriteOptions::default())
    .unwrap();
}

fn floats(path: &str, name: &str) -> (Transform, Arc<Vdb543<f32>>) {
    let file = VdbFile::open(path).unwrap();
    let grid = file.grid(name).unwrap();
    let AnyTree::Float(tree) = &grid.tree else { panic!("not floats") };
    (grid.transform.clone(), tree.clone())
}

#[test]
fn grids_are_resampled_and_what_does_not_fit_is_named() {
    let folder = folder("resample");
    let [own, out, again] = ["own.vdb", "out.vdb", "again.vdb"].map(|name| path(&folder, name));
    three_grids(&own);
    let output = vdb(&["resample", &own, "--voxel-size", "0.5", "--out", &out, "--json"]);
    assert!(output.status.success(), "{output:?}");
    let left = String::from_utf8(output.stderr).unwrap();
    let reason = "is left out: this needs grids of floats; convert the grid";
    assert_eq!(left, format!("{own}: grid \"id\" {reason}\n"));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let [density, surface] = [0, 1].map(|i| &report["grids"][i]);
    assert_eq!((&density["grid"], &surface["grid"]), (&"density".into(), &"surface".into()));
    let ratio = |of: &serde_json::Value| {
        of["voxels"].as_u64().unwrap() as f64 / of["voxels_before"].as_u64().unwrap() as f64
    };
    // Eight small voxels for each, and four where they are in a band.
    assert!((7.5..9.5).contains(&ratio(density)), "{density}");
    assert!((3.8..4.2).contains(&ratio(surface)), "{surface}");
    assert_eq!(report["left_out"][0]["grid"], "id");
    let (transform, tree) = floats(&out, "density");
    assert_eq!(transform.voxel_size().x, 0.5);
    assert_eq!(tree.get(IVec3::new(37, 0, 0)), 0.5);
    let (_, tree) = floats(&out, "surface");
    assert!((tree.get(IVec3::new(42, 0, 0)) - 0.5).abs() < 0.01);
    // Back, to the voxels of the first file.
    let said = done(&["resample", &out, "--like", &own, "--nearest", "--out", &again]);
    assert!(said.starts_with("\"density\": ") && said.lines().count() == 2, "{said}");
    let [(_, before), (transform, after)] = [&own, &again].map(|path| floats(path, "density"));
    assert_eq!(transform.voxel_size().x, 1.0);
    for x in -22..22 {
        let ijk = IVec3::new(x, 3, -5);
        assert_eq!(before.get(ijk), after.get(ijk), "{ijk}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn grids_are_cropped_moved_and_smoothed() {
    let folder = folder("change");
    let [own, out] = ["own.vdb", "out.vdb"].map(|name| path(&folder, name));
    three_grids(&own);
    let said =
        done(&["crop", &own, "--min", "-5,-inf,-100.5", "--max", "8,100,100", "--out", &out]);
    assert_eq!(said.lines().count(), 3, "{said}");
    let (_, fog) = floats(&out, "density");
    assert_eq!(fog.active_bbox().map(|bbox| (bbox.min.x, bbox.max.x)), Some((-5, 8)));
    assert_eq!(floats(&out, "surface").1.get(IVec3::new(10, 0, 0)), 2.0);
    done(&["crop", &own, "--min", "1,0,0", "--grid", "id", "--out", &out]);
    assert_eq!(VdbFile::open(&out).unwrap().grids.len(), 1);

    for (option, amount, radius) in [("--distance", "-3.5", 16.5), ("--voxels", "2", 22.0)] {
        done(&["offset", &own, option, amount, "--out", &out]);
        let value = floats(&out, "surface").1.get(IVec3::new(radius as i32, 0, 0));
        let expected = f64::from(radius as i32) - 0.5 - radius;
        assert!((f64::from(value) - expected).abs() < 0.05, "{value}, should be {expected}");
    }
    let smooth =
        |filter: &str| ["smooth", &own, "--filter", filter, "--out", &out].map(String::from);
    let smoothed = |arguments: &[String]| {
        done(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        floats(&out, "surface").1.get(IVec3::new(20, 0, 0))
    };
    let wide = ["--width", "2", "--iterations", "2"].map(String::from);
    let values = [
        smoothed(&smooth("curvature")),
        smoothed(&smooth("mean")),
        smoothed(&smooth("gaussian")),
        smoothed(&[&smooth("gaussian")[..], &wide].concat()),
    ];
    // The ball becomes smaller, the more the wider the filter is.
    assert!(values.is_sorted() && values[0] > -0.5 && values[3] < 1.0, "{values:?}");
    // Onto itself.
    done(&["offset", &own, "--voxels", "1", "--out", &own]);
    assert_eq!(VdbFile::open(&own).unwrap().grids.len(), 1);
    let left: Vec<_> =
        std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn mistakes_of_changes_are_one_line_and_leave_nothing() {
    let folder = folder("change-mistakes");
    let [own, out] = ["own.vdb", "out.vdb"].map(|name| path(&folder, name));
    three_grids(&own);
    let bad: [(&[&str], &str); 7] = [
        (&["resample", "--voxel-size", "1e-6"], "the result takes about"),
        (&["resample", "--voxel-size", "-1"], "the voxel size is -1; it must be"),
        (&["resample", "--voxel-size", "1", "--grid", "x"], "no grid is called \"x\""),
        (&["crop", "--min", "1,1,1", "--max", "0,2,2"], "the box from [1.0, 1.0, 1.0] to [0.0,"),
        (&["offset", "--distance", "-30"], "the level set has no surface any more"),
        (&["offset", "--distance", "1", "--grid", "density"], "this needs a level set"),
        (&["smooth", "--width", "9"], "the width of the filter is 9"),
    ];
    for (arguments, expected) in bad {
        let said = fails(&[&arguments[..1], &[&own, "--out", &out][..], &arguments[1..]].concat());
        assert!(said.contains(expected) && said.lines().count() == 1, "{arguments:?}: {said}");
    }
    let usage: [&[&str]; 5] = [
        &["crop", &own, "--min", "1,2", "--out", &out],
        &["crop", &own, "--out", &out],
        &["resample", &own, "--out", &out],
        &["offset", &own, "--out", &out],
        &["smooth", &own, "--out", "out.nvdb"],
    ];
    for arguments in usage {
        assert_eq!(vdb(arguments).status.code(), Some(2), "{arguments:?}");
    }
    assert!(!Path::new(&out).exists());
    std::fs::remove_dir_all(&folder).unwrap();
}
