//! Files as assets, in an app without a renderer: labels, settings, errors, reloading.

mod failures;
mod labels;

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

use crate::log::{listen, said};

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

pub(super) fn failure<A: Asset>(app: &mut App, handle: &Handle<A>) -> String {
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
fn conversions_are_told_of_with_and_without_a_label() {
    listen();
    let mut doubles = Vdb543::new(0.0_f64);
    doubles.set(IVec3::ZERO, 0.1);
    let mut floats = Vdb543::new([0.0_f32; 3]);
    floats.set(IVec3::ZERO, [1.0; 3]);
    let mut integers = Vdb543::new([0; 3]);
    integers.set(IVec3::ZERO, [i32::MAX; 3]);
    let files = [
        ("doubles", AnyTree::Double(doubles.into())),
        ("vectors", AnyTree::Vec3s(floats.into())),
        ("integers", AnyTree::Vec3i(integers.into())),
    ];
    let folder = std::env::temp_dir().join(format!("vdb-told-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut app = app();
    for (name, tree) in files {
        let told = || said(&format!("told_{name}.vdb: grid \"{name}\"")).len();
        let path = folder.join(format!("told_{name}.vdb"));
        let is_vectors = !matches!(tree, AnyTree::Double(_));
        let grids = vec![Grid::new(name, tree)];
        vdb_core::VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
        let file: Handle<VdbFile> = load(&app, path.clone());
        loaded(&mut app, &file);
        let with_label = told();
        if is_vectors {
            let grid: Handle<VdbVectorGrid> = load(&app, path);
            loaded(&mut app, &grid);
        } else {
            let grid: Handle<VdbGrid> = load(&app, path);
            loaded(&mut app, &grid);
        }
        let expected = if name == "vectors" { [0, 0] } else { [1, 2] };
        assert_eq!([with_label, told()], expected, "{name}");
    }
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
