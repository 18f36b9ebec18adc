//! Files as assets, in an app without a renderer: labels, settings, errors, reloading.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bevy::asset::{AssetPlugin, LoadState, UnapprovedPathMode};
use bevy::camera::primitives::Aabb;
use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy_vdb::{
    VdbEmission, VdbFile, VdbGrid, VdbLoadProgress, VdbLoaderSettings, VdbRenderAs,
    VdbRenderPlugin, VdbVolume,
};
use vdb_core::pack::PackKind;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, WriteOptions};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/vdb_core/tests/data").join(name)
}

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin { unapproved_path_mode: UnapprovedPathMode::Allow, ..default() },
        VdbRenderPlugin,
    ));
    app
}

/// Updates the app until something is there; panics with a message after a minute.
fn until<T>(app: &mut App, what: &str, mut found: impl FnMut(&World) -> Option<T>) -> T {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(60) {
        app.update();
        if let Some(found) = found(app.world()) {
            return found;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("{what} did not come");
}

fn load<A: Asset>(app: &App, path: impl Into<PathBuf>) -> Handle<A> {
    app.world().resource::<AssetServer>().load(path.into())
}

fn loaded<A: Asset + Clone>(app: &mut App, handle: &Handle<A>) -> A {
    until(app, "the asset", |world| world.resource::<Assets<A>>().get(handle).cloned())
}

fn failure<A: Asset>(app: &mut App, handle: &Handle<A>) -> String {
    until(app, "the error", |world| match world.resource::<AssetServer>().load_state(handle) {
        LoadState::Failed(error) => Some(error.to_string()),
        LoadState::Loaded => panic!("it loaded"),
        _ => None,
    })
}

#[test]
fn grids_are_labelled_by_name() {
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, data("kinds.vdb"));
    let file = loaded(&mut app, &file);
    let mut labels: Vec<_> = file.named_grids.keys().cloned().collect();
    labels.sort();
    assert_eq!(labels, ["density", "surface"]);
    assert_eq!(file.grids.len(), 2);

    let label = format!("{}#density", data("kinds.vdb").display());
    let density: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(label);
    let density = loaded(&mut app, &density);
    assert_eq!((density.name(), density.kind()), ("density", PackKind::Fog));
    assert!(density.tree().active_voxel_count() > 0);
    assert!(density.world_bounds().is_some());
    let surface = loaded(&mut app, &file.named_grids["surface"]);
    assert_eq!(surface.kind(), PackKind::Smooth { iso: 0.0 });
}

#[test]
fn settings_choose_grids_and_how_they_are_shown() {
    let mut app = app();
    let settings =
        |settings: VdbLoaderSettings| move |own: &mut VdbLoaderSettings| *own = settings.clone();
    let load = |app: &App, chosen: VdbLoaderSettings| -> Handle<VdbFile> {
        let server = app.world().resource::<AssetServer>();
        server.load_builder().with_settings(settings(chosen)).load(data("kinds.vdb"))
    };
    let chosen = VdbLoaderSettings {
        grids: Some(vec!["surface".into()]),
        half_width: Some(2.0),
        ..default()
    };
    let file = load(&app, chosen);
    let file = loaded(&mut app, &file);
    assert_eq!(file.grids.len(), 1);
    let narrow = loaded(&mut app, &file.grids[0]);
    drop(file);

    let mut app = self::app();
    let whole = VdbLoaderSettings { grids: Some(vec!["surface".into()]), ..default() };
    let file = load(&app, whole);
    let file = loaded(&mut app, &file);
    let whole = loaded(&mut app, &file.grids[0]);
    let voxels = |grid: &VdbGrid| grid.tree().active_voxel_count();
    assert!(voxels(&narrow) * 10 < voxels(&whole) * 9, "the band was not cut");
    assert_eq!(narrow.world_bounds(), whole.world_bounds(), "the surface moved");

    let mut app = self::app();
    let fog = VdbLoaderSettings { render_as: VdbRenderAs::Fog, ..default() };
    let file = load(&app, fog);
    let file = loaded(&mut app, &file);
    let surface = loaded(&mut app, &file.named_grids["surface"]);
    assert_eq!(surface.kind(), PackKind::Fog);

    let mut app = self::app();
    let voxels = VdbLoaderSettings { smooth: false, ..default() };
    let file = load(&app, voxels);
    let file = loaded(&mut app, &file);
    let surface = loaded(&mut app, &file.named_grids["surface"]);
    assert_eq!(surface.kind(), PackKind::Surface { iso: 0.0 });
    let density = loaded(&mut app, &file.named_grids["density"]);
    assert_eq!(density.kind(), PackKind::Fog);

    for (wrong, said) in [
        (VdbLoaderSettings { half_width: Some(f32::NAN), ..default() }, "half_width"),
        (
            VdbLoaderSettings {
                render_as: VdbRenderAs::Surface { iso: f32::INFINITY },
                ..default()
            },
            "iso",
        ),
        (VdbLoaderSettings { grids: Some(vec!["smoke".into()]), ..default() }, "smoke"),
    ] {
        let mut app = self::app();
        let file = load(&app, wrong);
        let message = failure(&mut app, &file);
        assert!(message.contains(said) && message.contains("kinds.vdb"), "{message}");
    }
}

#[test]
fn grids_of_vectors_are_assets_too() {
    let mut colors = Vdb543::new([0.5_f32, 0.0, 0.25]);
    colors.set(IVec3::new(3, 4, 5), [1.0, -2.0, 0.125]);
    let density = Vdb543::new(0.0_f32);
    let grids = [
        Grid::new("density", AnyTree::Float(density.into())),
        Grid::new("Cd", AnyTree::Vec3s(colors.into())),
    ];
    let folder = std::env::temp_dir().join(format!("bevy_vdb_vectors_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("colors.vdb");
    vdb_core::VdbFile::new(grids.into()).save(&path, &WriteOptions::default()).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, &path);
    let file = loaded(&mut app, &file);
    assert_eq!((file.grids.len(), file.vector_grids.len()), (1, 1));
    let grid = loaded(&mut app, &file.vector_grids["Cd"]);
    assert_eq!((grid.name(), grid.tree().background()), ("Cd", [0.5, 0.0, 0.25]));
    assert_eq!(grid.tree().get(IVec3::new(3, 4, 5)), [1.0, -2.0, 0.125]);
    // What is negative is nothing to see; a background above zero is all around.
    let seen = grid.packed().each_ref().map(|packed| packed.occupied.is_some());
    assert_eq!(seen, [true, false, true]);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn instances_of_one_tree_are_packed_once() {
    let mut tree = Vdb543::new(0.0);
    (0..64).for_each(|i| tree.set(IVec3::splat(3 * i), 1.0));
    let tree = AnyTree::Float(Arc::new(tree));
    let grids = (0..3000).map(|i| Grid::new(format!("copy {i}"), tree.clone()));
    let bytes = vdb_core::VdbFile::new(grids.collect()).write(&WriteOptions::default()).unwrap();
    let path = std::env::temp_dir().join(format!("bevy_vdb_instances_{}.vdb", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, &path);
    let file = loaded(&mut app, &file);
    std::fs::remove_file(&path).unwrap();
    assert_eq!(file.grids.len(), 3000);
    let first = loaded(&mut app, &file.grids[0]);
    for grid in &file.grids {
        let grid = loaded(&mut app, grid);
        assert!(Arc::ptr_eq(grid.packed(), first.packed()), "{} is packed anew", grid.name());
    }
}

#[test]
fn a_file_that_takes_too_much_memory_is_one_message() {
    // Tiles of the root far apart, each with its own nodes over it and around it.
    let mut tree = Vdb543::new(0.0);
    for i in 0..50_000 {
        tree.insert_tile(IVec3::new(i % 37, i / 37 % 37, i / 1369) * 65_536, 1.0, true);
    }
    let grid = Grid::new("strewn", AnyTree::Float(Arc::new(tree)));
    let bytes = vdb_core::VdbFile::new(vec![grid]).write(&WriteOptions::default()).unwrap();
    let path = std::env::temp_dir().join(format!("bevy_vdb_strewn_{}.vdb", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, &path);
    let message = failure(&mut app, &file);
    std::fs::remove_file(&path).unwrap();
    assert!(message.contains("'strewn'") && message.contains("`Limits::packed_growth`"), "{message}");
}

#[test]
fn the_box_of_a_volume_has_what_shines_in_it() {
    let mut app = app();
    let mut add = |at: i32| {
        let mut tree = Vdb543::new(0.0);
        tree.set(IVec3::splat(at), 1.0);
        let grid = VdbGrid::new("fog", tree, DAffine3::IDENTITY, PackKind::Fog).unwrap();
        app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid)
    };
    let (smoke, near, far) = (add(0), add(20), add(-50));
    let volume = app.world_mut().spawn((VdbVolume(smoke), VdbEmission::kelvin(near))).id();
    let bounds = |app: &mut App| {
        app.update();
        let aabb = app.world().get::<Aabb>(volume).unwrap();
        (aabb.min().x, aabb.max().x)
    };
    // Trilinear: a sample reaches to the next ones.
    assert_eq!(bounds(&mut app), (-1.0, 21.0));
    app.world_mut().entity_mut(volume).insert(VdbEmission::kelvin(far));
    assert_eq!(bounds(&mut app), (-51.0, 1.0));
    app.world_mut().entity_mut(volume).remove::<VdbEmission>();
    assert_eq!(bounds(&mut app), (-1.0, 1.0));
}

#[test]
fn each_failure_is_one_clear_message() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_errors_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let whole = std::fs::read(data("kinds.vdb")).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.join(name), bytes).unwrap();
        folder.join(name)
    };
    let cases = [
        (folder.join("missing.vdb"), "missing.vdb"),
        (write("truncated.vdb", &whole[..whole.len() / 2]), "truncated.vdb"),
        (write("text.vdb", b"This is not a volume."), "text.vdb"),
        (write("empty.vdb", b""), "empty.vdb"),
    ];
    let mut app = app();
    for (path, name) in cases {
        let file: Handle<VdbFile> = load(&app, path);
        let message = failure(&mut app, &file);
        println!("{message}");
        assert!(message.contains(name), "{message}");
        // With RUST_BACKTRACE set, Bevy puts a backtrace under the error.
        let said = message.split("\n   0: ").next().unwrap_or_default();
        assert_eq!(said.lines().count(), 1, "{message}");
    }
    let label = format!("{}#smoke", data("kinds.vdb").display());
    let wrong: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(label);
    let message = failure(&mut app, &wrong);
    assert!(message.contains("smoke") && message.contains("density"), "{message}");
    // The app goes on.
    let file: Handle<VdbFile> = load(&app, data("empty_and_one.vdb"));
    loaded(&mut app, &file);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_changed_file_is_reloaded() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_reload_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("changing.vdb");
    std::fs::copy(data("kinds.vdb"), &path).unwrap();
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin {
            file_path: folder.display().to_string(),
            watch_for_changes_override: Some(true),
            ..default()
        },
        VdbRenderPlugin,
    ));
    let file: Handle<VdbFile> = app.world().resource::<AssetServer>().load("changing.vdb");
    assert_eq!(loaded(&mut app, &file).grids.len(), 2);
    std::fs::copy(data("special_floats.vdb"), &path).unwrap();
    until(&mut app, "the reloaded file", |world| {
        let file = world.resource::<Assets<VdbFile>>().get(&file)?;
        (!file.named_grids.contains_key("density")).then_some(())
    });
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn progress_is_told_and_a_dropped_handle_stops_the_load() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/models/dragon_512.vdb");
    if !path.exists() {
        eprintln!("SKIPPED: there is no {}", path.display());
        return;
    }
    let mut app = app();
    let all = std::fs::metadata(&path).unwrap().len();
    let file: Handle<VdbFile> = load(&app, &path);
    let mut seen = Vec::new();
    until(&mut app, "the file", |world| {
        seen.extend(world.resource::<VdbLoadProgress>().files());
        world.resource::<Assets<VdbFile>>().get(&file).map(drop)
    });
    assert!(!seen.is_empty(), "no progress was told");
    assert!(seen.iter().all(|(_, done, of)| done <= of && *of == all), "{seen:?}");
    assert!(seen.is_sorted_by_key(|(_, done, _)| *done), "progress went back");
    assert_eq!(app.world().resource::<VdbLoadProgress>().files(), [], "it has ended");

    let mut app = self::app();
    let file: Handle<VdbFile> = load(&app, &path);
    until(&mut app, "the start of the load", |world| {
        (!world.resource::<VdbLoadProgress>().files().is_empty()).then_some(())
    });
    drop(file);
    let start = Instant::now();
    until(&mut app, "the end of the load", |world| {
        world.resource::<VdbLoadProgress>().files().is_empty().then_some(())
    });
    assert!(start.elapsed() < Duration::from_secs(5));
    assert_eq!(app.world().resource::<Assets<VdbFile>>().len(), 0, "it was loaded all the same");
}
