//! A sequence of small files.

use std::path::Path;

use bevy::math::DVec3;
use vdb_core::synth::fog;
use vdb_core::{AnyTree, Grid, GridClass, WriteOptions};

/// Writes the frames `smoke_0001.vdb` and so on: each a ball of fog called `density`, whose radius
/// is the number of the frame and 2.
pub fn save(folder: &Path, numbers: impl IntoIterator<Item = u64>) {
    std::fs::create_dir_all(folder).expect("a folder");
    for number in numbers {
        let tree = fog::sphere(DVec3::ZERO, 2.0 + number as f64, 1.0);
        let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
        grid.class = GridClass::FogVolume;
        let file = vdb_core::VdbFile::new(vec![grid]);
        let path = folder.join(format!("smoke_{number:04}.vdb"));
        file.save(&path, &WriteOptions::default()).expect("it is written");
    }
}
