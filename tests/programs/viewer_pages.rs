//! The viewer with surfaces in pages.

use std::fs;
use std::path::{Path, PathBuf};

use bevy::math::{DAffine3, DVec3};
use vdb_core::pages::{FunctionSource, PageOptions};
use vdb_core::synth::level_set;
use vdb_core::{AnyTree, Grid, GridClass, VdbFile, WriteOptions};

use crate::viewer::{drawn, fails, picture, refused};
use crate::{files, has_gpu, pages_folder};

const RADIUS: f64 = 100.0;

fn temporary(name: &str) -> PathBuf {
    files::temporary("viewer_pages", name)
}

/// Writes a ball around the origin in eight pages. Returns the path of their index.
fn ball_in_pages(name: &str) -> PathBuf {
    let (folder, half) = (temporary(name), DVec3::splat(RADIUS + 10.0));
    let distance = |at: DVec3| at.length() - RADIUS;
    let source = FunctionSource::new("ball", DAffine3::IDENTITY, [-half, half], distance);
    let options = PageOptions { edge: 128, smooth: true, ..PageOptions::default() };
    pages_folder::cook(&folder, &source, &options)
}

/// The options of a camera that the ball fills half of.
fn in_view(command: &mut std::process::Command, path: &Path) {
    command.arg(path).args(["--eye", "0,0,400", "--target", "0,0,0", "--fov", "40"]);
}

#[test]
fn a_ball_in_pages_is_that_of_a_whole_file() {
    if !has_gpu() {
        return;
    }
    let (in_pages, _) = picture("pages.png", |c| in_view(c, &ball_in_pages("ball")));
    let mut grid = Grid::new("ball", AnyTree::Float(level_set::sphere(DVec3::ZERO, RADIUS).into()));
    grid.class = GridClass::LevelSet;
    let path = temporary("ball.vdb");
    VdbFile::new(vec![grid]).save(&path, &WriteOptions::default()).unwrap();
    let (whole, _) = picture("whole.png", |c| in_view(c, &path));
    assert!((3_000..12_000).contains(&drawn(&whole)), "{} pixels", drawn(&whole));
    let pairs = in_pages.iter().zip(&whole);
    let differ = pairs.filter(|(a, b)| (0..3).any(|i| a[i].abs_diff(b[i]) > 8)).count();
    assert!(differ < 100, "{differ} pixels differ");
}

#[test]
fn pages_that_cannot_be_shown_are_one_clear_error() {
    let index = ball_in_pages("broken");
    let said = refused(|c| _ = c.arg(&index).arg("--cpu"));
    assert!(said.contains("on the CPU") && said.contains("pages"), "{said}");
    if !has_gpu() {
        return;
    }

    let pages = index.with_file_name("0");
    let first = fs::read_dir(&pages).unwrap().next().unwrap().unwrap().path();
    let whole = fs::read(&first).unwrap();
    fs::write(&first, &whole[..whole.len() / 2]).unwrap();
    let said = fails(|c| in_view(c, &index));
    let name = first.file_name().unwrap().to_string_lossy();
    assert!(said.contains(&format!("page 0/{name} of 'ball' cannot be loaded")), "{said}");
    assert!(said.contains("damaged") && said.contains("viewer: 1 of the pages"), "{said}");

    let whole = fs::read(&index).unwrap();
    fs::write(&index, &whole[..whole.len() / 2]).unwrap();
    let said = refused(|c| in_view(c, &index));
    assert!(said.contains("index.vdbpages") && said.contains("damaged"), "{said}");
}
