//! `vdb_bench --report`, as users run it: on the adapter of this machine, with a small model.

use std::path::PathBuf;
use std::process::{Command, Output};

use glam::DVec3;
use vdb_core::synth::level_set;
use vdb_core::{AnyTree, Grid, GridClass, VdbFile};
use vdb_probe::Gpu;

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb_bench")).args(arguments).output().expect("it starts")
}

/// A folder that vanishes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let path = std::env::temp_dir().join(format!("vdb_report_{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder for the report");
        Self(path)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_report_chooses_its_own_views() {
    let output = bench(&["--report", "nowhere", "--sizes", "8x8", "gyroid:256"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert_eq!(message, "vdb_bench: --sizes: --report itself chooses what to measure\n");
}

#[test]
#[ignore = "slow: thirty images and more of each kind"]
fn a_report_has_every_row_and_no_wrong_ray() {
    if Gpu::find().is_none() {
        return;
    }
    let folder = Folder::new();
    let tree = level_set::sphere(DVec3::ZERO, 20.0);
    let mut grid = Grid::new("ball", AnyTree::Float(tree.into()));
    grid.class = GridClass::LevelSet;
    let file = VdbFile::new(vec![grid]);
    file.save(folder.path("ball.vdb"), &Default::default()).expect("a file is written");
    // What is missing is reported, and hinders nothing else.
    let output = bench(&[
        "--runs",
        "30",
        "--report",
        &folder.path("out"),
        &folder.path("missing.vdb"),
        &folder.path("ball.vdb"),
    ]);
    let messages = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{messages}");
    let report = std::fs::read_to_string(folder.path("out/report.md"));
    let report = report.unwrap_or_else(|error| panic!("{error}: {messages}"));
    assert!(report.contains("\n**0 of "), "{report}");
    assert!(report.contains("\n**Not measured:** ") && report.contains("missing.vdb"), "{report}");
    for row in ["voxels | primary", "voxels | shuffled", "smooth | primary", "smooth | shuffled"] {
        assert!(report.contains(&format!("\n| ball | {row} | ")), "no row {row} in\n{report}");
    }
    let plot = std::fs::read_to_string(folder.path("out/bench.svg")).expect("a plot");
    assert!(plot.contains("ball smooth shuffled"), "{plot}");
}
