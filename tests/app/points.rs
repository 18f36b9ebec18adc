//! Files of points.

use std::io::Read;
use std::path::{Path, PathBuf};

use bevy::prelude::*;
use bevy_vdb::{VdbFile, VdbGrid, VdbLoaderSettings, VdbPoints};
use flate2::read::GzDecoder;
use vdb_core::pack::PackKind;

use super::assets::{app, failure, loaded};

/// A file of points that OpenVDB has written.
pub(super) fn bytes() -> Vec<u8> {
    let packed = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("crates/vdb_core/tests/data/points/shared.vdb.gz");
    let mut bytes = Vec::new();
    GzDecoder::new(std::fs::File::open(packed).unwrap()).read_to_end(&mut bytes).unwrap();
    bytes
}

/// The same, in a folder of its own.
fn file(test: &str) -> (PathBuf, PathBuf) {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_{test}_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("points.vdb");
    std::fs::write(&path, bytes()).unwrap();
    (folder, path)
}

fn load(app: &App, path: &Path, settings: VdbLoaderSettings) -> Handle<VdbFile> {
    let server = app.world().resource::<AssetServer>();
    let set = move |own: &mut VdbLoaderSettings| *own = settings.clone();
    server.load_builder().with_settings(set).load(path.to_owned())
}

#[test]
fn points_are_left_out_with_a_message() {
    let (folder, path) = file("points_left_out");
    let mut app = app();
    let points = load(&app, &path, VdbLoaderSettings::default());
    let message = failure(&mut app, &points);
    assert!(message.contains("points, which `VdbLoaderSettings::points` can display"), "{message}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn points_become_balls_or_fog() {
    let (folder, path) = file("points_shown");
    for (points, is_fog) in [(VdbPoints::Balls, false), (VdbPoints::Fog, true)] {
        let mut app = app();
        let settings = VdbLoaderSettings {
            points,
            point_voxel_size: Some(0.05),
            point_radius: Some(0.2),
            ..default()
        };
        let file = load(&app, &path, settings);
        let file = loaded(&mut app, &file);
        let grids = app.world().resource::<Assets<VdbGrid>>();
        assert!(!file.grids.is_empty());
        for handle in &file.grids {
            let grid = grids.get(handle).unwrap();
            assert_eq!(grid.kind() == PackKind::Fog, is_fog, "{points:?}");
            let (low, high) = grid.world_bounds().unwrap();
            // At least a ball.
            assert!((high - low).min_element() > 0.35, "{points:?}: {low} to {high}");
            let tree = grid.tree().unwrap();
            assert!(tree.active_voxel_count() > 200, "{points:?}");
        }
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_bad_radius_is_one_error() {
    let (folder, path) = file("points_bad");
    let mut app = app();
    let settings =
        VdbLoaderSettings { points: VdbPoints::Balls, point_radius: Some(f32::NAN), ..default() };
    let points = load(&app, &path, settings);
    let message = failure(&mut app, &points);
    assert!(message.contains("was skipped") && message.contains("radius"), "{message}");
    std::fs::remove_dir_all(folder).unwrap();
}
