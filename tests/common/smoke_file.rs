//! A file with several grids, as programs for fluids write them.

use std::path::Path;
use std::sync::Arc;

use bevy::math::{DVec3, IVec3};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, WriteOptions};

/// `Cd`, `density`, `flame`, which is empty, `fuel`, `phi_obstacle`, `surface`, and `temperature` from 0 to
/// 1.5.
pub fn save(path: &Path) {
    let float = |name: &str, tree: Vdb543<f32>| Grid::new(name, AnyTree::Float(Arc::new(tree)));
    let mut temperature = Vdb543::new(0.0);
    for voxel in fog::sphere(DVec3::new(0.0, -4.0, 0.0), 9.0, 6.0).active_values() {
        temperature.set(voxel.origin, 1.5 * voxel.value);
    }
    let mut colors = Vdb543::new([0.0; 3]);
    colors.set(IVec3::new(30, 0, 0), [1.0, 0.0, 0.25]);
    let grids = vec![
        Grid::new("Cd", AnyTree::Vec3s(Arc::new(colors))),
        float("phi_obstacle", level_set::sphere(DVec3::new(-30.0, 0.0, 0.0), 8.0)),
        float("flame", Vdb543::new(0.0)),
        float("fuel", fog::sphere(DVec3::ZERO, 5.0, 4.0)),
        float("density", fog::sphere(DVec3::ZERO, 14.0, 8.0)),
        float("surface", level_set::sphere(DVec3::new(30.0, 0.0, 0.0), 8.0)),
        float("temperature", temperature),
    ];
    vdb_core::VdbFile::new(grids).save(path, &WriteOptions::default()).expect("it is written");
}
