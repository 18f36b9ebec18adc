//! Files as assets, in an app without a renderer: labels, settings, errors, reloading.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bevy::asset::{AssetPlugin, LoadState, LoadedUntypedAsset, UnapprovedPathMode};
use bevy::camera::primitives::Aabb;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbEmission, VdbFile, VdbFileProgress, VdbGrid, VdbLoadProgress, VdbLoaderSettings,
    VdbRenderAs, VdbRenderPlugin, VdbVectorGrid, VdbVolume, VdbVolumeState,
};
use vdb_core::pack::PackKind;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, WriteOptions};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/vdb_core/tests/data").join(name)
}

pub(super) fn app() -> App {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin { unapproved_path_mode: UnapprovedPathMode::Allow, ..default() },
        VdbRenderPlugin,
    ));
    app
}

/// A folder for the files of a test, and a file of grids of floats in it: level sets, or fog.
fn file_of(test: &str, grids: &[(&str, GridClass)]) -> (PathBuf, PathBuf) {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_{test}_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let grid = |(name, class): &(&str, GridClass)| {
        let mut tree = Vdb543::new(if *class == GridClass::LevelSet { 1.0 } else { 0.0 });
        tree.set(IVec3::ZERO, if *class == GridClass::LevelSet { -1.0 } else { 2.0 });
        let mut grid = Grid::new(*name, AnyTree::Float(tree.into()));
        grid.class = *class;
        grid
    };
    let path = folder.join("grids.vdb");
    let file = vdb_core::VdbFile::new(grids.iter().map(grid).collect());
    file.save(&path, &WriteOptions::default()).unwrap();
    (folder, path)
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

pub(super) fn load<A: Asset>(app: &App, path: impl Into<PathBuf>) -> Handle<A> {
    app.world().resource::<AssetServer>().load(path.into())
}

pub(super) fn loaded<A: Asset + Clone>(app: &mut App, handle: &Handle<A>) -> A {
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
    assert_eq!(labels, ["density", "flag", "surface"]);
    assert_eq!(file.grids.len(), 3, "booleans become floats");

    let label = format!("{}#density", data("kinds.vdb").display());
    let density: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(label);
    let density = loaded(&mut app, &density);
    assert_eq!((density.name(), density.kind()), ("density", PackKind::Fog));
    assert!(density.tree().unwrap().active_voxel_count() > 0);
    assert!(density.world_bounds().is_some());
    let surface = loaded(&mut app, &file.named_grids["surface"]);
    assert_eq!(surface.kind(), PackKind::Smooth { iso: 0.0 });
}

#[test]
fn grids_of_other_types_become_floats() {
    let mut doubles = Vdb543::new(0.0_f64);
    for (x, value) in (0..).zip([1e300, -1e300, 1e-300, 0.1]) {
        doubles.set(IVec3::new(x, 0, 0), value);
    }
    let mut integers = Vdb543::new(0_i64);
    integers.set(IVec3::ZERO, i64::MAX);
    let tree = AnyTree::Int64(integers.into());
    let grids = [
        ("doubles", AnyTree::Double(doubles.into())),
        ("integers", tree.clone()),
        ("instance", tree),
        ("vectors", AnyTree::Vec3i(Vdb543::new([1, 2, 3]).into())),
    ];
    let grids = grids.map(|(name, tree)| Grid::new(name, tree)).into();
    let folder = std::env::temp_dir().join(format!("vdb-floats-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("types.vdb");
    vdb_core::VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, path);
    let file = loaded(&mut app, &file);
    assert_eq!((file.grids.len(), file.vector_grids.len()), (3, 1));
    let grid = |app: &mut App, name: &str| loaded(app, &file.named_grids[name]);
    let doubles = grid(&mut app, "doubles");
    let values = [0, 1, 2, 3].map(|x| doubles.tree().unwrap().get(IVec3::new(x, 0, 0)));
    assert_eq!(values, [f32::MAX, f32::MIN, 0.0, 0.1]);
    let integers = grid(&mut app, "integers");
    assert_eq!(integers.tree().unwrap().get(IVec3::ZERO), 2_f32.powi(63));
    // Instances are packed once.
    let instance = grid(&mut app, "instance");
    assert!(Arc::ptr_eq(integers.packed(), instance.packed()));
    std::fs::remove_dir_all(folder).unwrap();
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
    let voxels = |grid: &VdbGrid| grid.tree().unwrap().active_voxel_count();
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
    assert!(
        message.contains("'strewn'") && message.contains("`Limits::packed_growth`"),
        "{message}"
    );
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

/// A file that says to be so long and has no blocks on the disk.
fn sparse(path: &Path, start: &[u8], length: u64) {
    std::fs::write(path, start).unwrap();
    std::fs::OpenOptions::new().write(true).open(path).unwrap().set_len(length).unwrap();
}

#[test]
fn what_is_no_file_of_ours_is_refused_at_once() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_refused_{}", std::process::id()));
    std::fs::create_dir_all(folder.join("folder.vdb")).unwrap();
    let whole = std::fs::read(data("kinds.vdb")).unwrap();
    sparse(&folder.join("zeros.vdb"), b"", 3 << 30);
    sparse(&folder.join("long.vdb"), &whole, 3 << 30);
    let mut cases = vec![
        ("zeros.vdb", "this is not a VDB file"),
        (
            "long.vdb",
            "3221225472 bytes of file exceed the limit of 2147483648 (`Limits::file_bytes`)",
        ),
        ("folder.vdb", "folder.vdb"),
    ];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("/dev/zero", folder.join("device.vdb")).unwrap();
        cases.push(("device.vdb", "this is not a VDB file"));
    }
    for (name, said) in cases {
        let mut app = app();
        let start = Instant::now();
        let file: Handle<VdbFile> = load(&app, folder.join(name));
        let message = failure(&mut app, &file);
        assert!(message.contains(said) && message.contains(name), "{name}: {message}");
        assert!(start.elapsed() < Duration::from_secs(5), "{name} took {:?}", start.elapsed());
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn limits_are_settings() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_limits_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let whole = std::fs::read(data("kinds.vdb")).unwrap();
    // By code.
    let mut app = app();
    let few = |settings: &mut VdbLoaderSettings| settings.limits.nodes = 10;
    let server = app.world().resource::<AssetServer>();
    let file: Handle<VdbFile> = server.load_builder().with_settings(few).load(data("kinds.vdb"));
    let message = failure(&mut app, &file);
    assert!(message.contains("exceed the limit of 10 (`Limits::nodes`)"), "{message}");
    // By a file of settings, in which all others keep their defaults.
    let meta = |limits: &str| {
        format!(
            "(meta_format_version: \"1.0\", asset: Load(loader: \"bevy_vdb::VdbLoader\", \
             settings: (limits: ({limits}))))"
        )
    };
    sparse(&folder.join("long.vdb"), &whole, 3 << 30);
    for (name, limits, said) in [
        ("small.vdb", "file_bytes: 1_000", Some("exceed the limit of 1000 (`Limits::file_bytes`)")),
        ("long.vdb", "file_bytes: 4_000_000_000", None),
    ] {
        let path = folder.join(name);
        if !path.exists() {
            std::fs::write(&path, &whole).unwrap();
        }
        std::fs::write(folder.join(format!("{name}.meta")), meta(limits)).unwrap();
        let mut app = self::app();
        let file: Handle<VdbFile> = load(&app, path);
        match said {
            Some(said) => {
                let message = failure(&mut app, &file);
                assert!(message.contains(said), "{message}");
            }
            None => assert_eq!(loaded(&mut app, &file).grids.len(), 3),
        }
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// Names with escapes that a terminal obeys, and such as Bevy's paths have no place for.
#[test]
fn labels_can_be_shown_and_loaded() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_labels_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("names.vdb");
    let names =
        ["\u{1b}[2J\u{202e}", "a#b", "http://x", "density", "fire/core", "Dichte für Rauch"];
    let grid = |name: &str| Grid::new(name, AnyTree::Float(Vdb543::new(0.0_f32).into()));
    let grids = names.map(grid).into();
    vdb_core::VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, &path);
    let file = loaded(&mut app, &file);
    let labels = [
        r"\u{1b}[2J\u{202e}",
        r"a\u{23}b",
        r"http:/\u{2f}x",
        "density",
        "fire/core",
        "Dichte für Rauch",
    ];
    for (label, name) in labels.into_iter().zip(names) {
        let grid = loaded(&mut app, &file.named_grids[label]);
        assert_eq!(grid.name(), name);
        let asked = format!("{}#{label}", path.display());
        let found: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(asked);
        assert_eq!(found, file.named_grids[label]);
    }
    // Bevy lists them where one is asked for that is not there.
    let asked = format!("{}#smoke", path.display());
    let wrong: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(asked);
    let message = failure(&mut app, &wrong);
    assert!(message.contains(r"\u{1b}") && message.contains("density"), "{message}");
    assert!(!message.contains(['\u{1b}', '\u{202e}']), "{message:?}");
    // And what the loader itself says of such a file.
    let hostile: Handle<VdbFile> = load(&app, data("hostile/ansi.vdb"));
    let hostile = until(&mut app, "the file or an error", |world| {
        match world.resource::<AssetServer>().load_state(&hostile) {
            LoadState::Failed(error) => Some(error.to_string()),
            LoadState::Loaded => Some(String::new()),
            _ => None,
        }
    });
    assert!(!hostile.contains('\u{1b}'), "{hostile:?}");
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
    assert_eq!(loaded(&mut app, &file).grids.len(), 3);
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
    let is_sound = |file: &VdbFileProgress| file.bytes_decoded <= file.bytes && file.bytes == all;
    assert!(seen.iter().all(is_sound), "{seen:?}");
    assert!(seen.is_sorted_by_key(|file| file.fraction()), "progress went back");
    assert!(seen.iter().any(|file| file.packed > 0.0), "packing is progress, too");
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

/// The likeliest beginner's mistake is none: a file without a label is the grid that it is about.
#[test]
fn a_grid_without_a_label_is_the_one_that_the_file_is_about() {
    let (set, fog) = (GridClass::LevelSet, GridClass::FogVolume);
    let mut app = app();
    for (test, grids, name) in [
        ("one", &[("ls_teapot", set)][..], "ls_teapot"),
        ("smoke", &[("temperature", fog), ("density", fog), ("flame", fog)], "density"),
        ("unnamed", &[("", fog)], ""),
    ] {
        let (folder, path) = file_of(test, grids);
        let grid: Handle<VdbGrid> = load(&app, &path);
        let grid = loaded(&mut app, &grid);
        assert_eq!(
            (grid.name(), grid.class()),
            (name, grids.iter().find(|of| of.0 == name).unwrap().1)
        );
        // As a file, by type or by none, it is still all of it.
        let file: Handle<VdbFile> = load(&app, &path);
        assert_eq!(loaded(&mut app, &file).grids.len(), grids.len());
        let untyped =
            app.world().resource::<AssetServer>().load_builder().load_untyped(path.clone());
        let untyped = until(&mut app, "the asset", |world| {
            Some(world.resource::<Assets<LoadedUntypedAsset>>().get(&untyped)?.handle.clone())
        });
        assert!(untyped.try_typed::<VdbFile>().is_ok(), "what has no type is a file");
        std::fs::remove_dir_all(folder).unwrap();
    }
    // Settings go for it as well.
    let (folder, path) = file_of("settings", &[("left", set), ("right", set)]);
    let server = app.world().resource::<AssetServer>();
    let right = server
        .load_builder()
        .with_settings(|settings: &mut VdbLoaderSettings| {
            settings.grids = Some(vec!["right".into()]);
            settings.smooth = false;
        })
        .load(path);
    let right: VdbGrid = loaded(&mut app, &right);
    assert_eq!((right.name(), right.kind()), ("right", PackKind::Surface { iso: 0.0 }));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn where_a_grid_could_be_several_the_message_has_their_labels() {
    let (set, fog) = (GridClass::LevelSet, GridClass::FogVolume);
    let mut app = app();
    for (test, grids) in
        [("two", [("left", set), ("right", set)]), ("both", [("surface", set), ("density", fog)])]
    {
        let (folder, path) = file_of(test, &grids);
        let grid: Handle<VdbGrid> = load(&app, &path);
        let message = failure(&mut app, &grid);
        println!("{message}");
        let labels = grids.map(|(name, _)| format!("`#{name}`"));
        assert!(message.contains("append the label of one to the path"), "{message}");
        assert!(labels.iter().all(|label| message.contains(label)), "{message}");
        // A volume says that nothing will come, and why, in the words of the message.
        let volume = app.world_mut().spawn(VdbVolume(grid)).id();
        app.update();
        let state = app.world().get::<VdbVolumeState>(volume).unwrap();
        let VdbVolumeState::Failed(why) = state else { panic!("{state:?}") };
        assert!(why.starts_with("the file has several grids"), "{why}");
        assert!(message.contains(why) && state.is_settled(), "{why}");
        std::fs::remove_dir_all(folder).unwrap();
    }
    let (folder, path) = file_of("none", &[("density", fog)]);
    let vectors: Handle<VdbVectorGrid> = load(&app, &path);
    let message = failure(&mut app, &vectors);
    println!("{message}");
    assert!(message.contains("no grid of vectors") && message.contains("density"), "{message}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// A loading screen would wait for it in vain.
#[test]
fn a_volume_whose_path_is_refused_has_failed() {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, AssetPlugin::default(), VdbRenderPlugin));
    // Absolute paths have to be allowed.
    let refused: Handle<VdbGrid> = load(&app, data("kinds.vdb"));
    let volume = app.world_mut().spawn(VdbVolume(refused)).id();
    app.update();
    let state = app.world().get::<VdbVolumeState>(volume).unwrap();
    assert!(matches!(state, VdbVolumeState::Failed(_)) && state.is_settled(), "{state:?}");
    assert!(state.reason().is_some_and(|why| why.contains("path that it refuses")), "{state:?}");
}

/// The `.meta` file of the guide, as it stands there, beside a file.
#[test]
fn the_guides_meta_file_has_settings() {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide/assets.md");
    let guide = std::fs::read_to_string(guide).unwrap();
    let (_, rest) = guide.split_once("```ron\n").expect("a .meta file in the guide");
    let (meta, _) = rest.split_once("```").unwrap();
    let (folder, path) = file_of("meta", &[("density", GridClass::FogVolume)]);
    std::fs::write(folder.join("grids.vdb.meta"), meta).unwrap();
    let mut app = app();
    let label = format!("{}#density", path.display());
    let density: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(label);
    let density = loaded(&mut app, &density);
    // What the guide sets: 16 bits, of which 2 is the code of bytes and 1 that of halves.
    assert_eq!(density.packed().sample_format(), Some(1));
    assert!(meta.contains("values: Half"), "{meta}");
    // And what it does without is as it is without.
    let all: Handle<VdbFile> = load(&app, &path);
    assert_eq!(loaded(&mut app, &all).grids.len(), 1);
    std::fs::remove_dir_all(folder).unwrap();
}

/// What has been edited is in the file, and in the grid that `vdb_core` gets.
#[test]
fn grids_are_saved_as_they_are_now() {
    let (folder, path) = file_of("save", &[("surface", GridClass::LevelSet)]);
    let mut app = app();
    let grid: Handle<VdbGrid> = load(&app, &path);
    let mut grid = loaded(&mut app, &grid);
    let at = IVec3::new(40, -3, 7);
    grid.edit(|voxels| voxels.set(at, -0.25)).unwrap();
    let core = grid.to_grid().unwrap();
    assert_eq!((core.name.as_str(), core.class), ("surface", GridClass::LevelSet));
    let AnyTree::Float(tree) = &core.tree else { panic!("{}", core.type_name) };
    assert!(std::sync::Arc::ptr_eq(tree, grid.tree().unwrap()), "nothing is copied");
    drop(core);
    // Over the file that it came from, and once more.
    for _ in 0..2 {
        grid.save(&path).unwrap();
    }
    let again = vdb_core::VdbFile::open(&path).unwrap();
    let own = &again.grids[0];
    let AnyTree::Float(tree) = &own.tree else { panic!("{}", own.type_name) };
    assert_eq!((tree.get(at), tree.get(IVec3::ZERO), tree.get(IVec3::ONE)), (-0.25, -1.0, 1.0));
    assert_eq!(tree.active_voxel_count(), grid.tree().unwrap().active_voxel_count());
    assert_eq!(own.transform.linear(), Some(grid.world_from_index()));

    let turned =
        DAffine3::from_rotation_y(0.3) * DAffine3::from_translation(DVec3::new(1.0, 2.0, 3.0));
    let made = VdbGrid::new("", Vdb543::new(0.0), turned, PackKind::Fog).unwrap();
    made.save(&path).unwrap();
    let again = vdb_core::VdbFile::open(&path).unwrap();
    assert_eq!(again.grids[0].transform.linear(), Some(turned));
    let wrong = made.save(folder.join("no_such_folder/file.vdb")).unwrap_err().to_string();
    assert!(wrong.contains("no_such_folder"), "{wrong}");
    std::fs::remove_dir_all(folder).unwrap();
}
