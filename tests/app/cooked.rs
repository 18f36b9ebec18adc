//! Cooked files as assets, in an app without a renderer; and Bevy's asset processing, which makes them.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bevy::asset::processor::{AssetProcessor, FileTransactionLogFactory};
use bevy::asset::{AssetMode, AssetPlugin, LoadState, UnapprovedPathMode};
use bevy::ecs::system::RunSystemOnce;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbGridError, VdbRayVisibility};
use vdb_core::cooked::{CookOptions, CookedFile};
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat};
use vdb_core::{AnyTree, Grid, GridClass, WriteOptions, synth};

/// A folder that is removed in the end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let name = format!("bevy_vdb_cooked_{test}_{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::remove_dir_all(&folder).ok();
        fs::create_dir_all(folder.join("assets")).unwrap();
        Self(folder)
    }

    /// A copy of the folder: processors of previous apps still watch the original and process what changes in it.
    fn copy(&self, test: &str) -> Self {
        let copy = Self::new(test);
        for part in ["assets", "processed"] {
            fs::create_dir_all(copy.0.join(part)).unwrap();
            for entry in fs::read_dir(self.0.join(part)).unwrap() {
                let entry = entry.unwrap();
                fs::copy(entry.path(), copy.0.join(part).join(entry.file_name())).unwrap();
            }
        }
        copy
    }

    fn asset(&self, name: &str) -> PathBuf {
        self.0.join("assets").join(name)
    }

    fn processed(&self, name: &str) -> PathBuf {
        self.0.join("processed").join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

/// Smoke, fire and a ball of water.
fn file() -> vdb_core::VdbFile {
    let fog = |name, radius| {
        let tree = synth::fog::sphere(DVec3::new(4.0, -2.0, 1.0), radius, 3.0);
        let mut grid = Grid::new(name, AnyTree::Float(tree.into()));
        grid.class = GridClass::FogVolume;
        grid
    };
    let tree = synth::level_set::sphere(DVec3::ZERO, 9.0);
    let mut surface = Grid::new("surface", AnyTree::Float(tree.into()));
    surface.class = GridClass::LevelSet;
    vdb_core::VdbFile::new(vec![fog("density", 12.0), fog("flame", 5.0), surface])
}

fn cooked(options: &CookOptions) -> Vec<u8> {
    CookedFile::cook(&file(), options).unwrap().write().unwrap()
}

fn app(folder: &Folder, plugin: AssetPlugin) -> App {
    let mut app = App::new();
    let (assets, processed) = (folder.0.join("assets"), folder.0.join("processed"));
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin {
            file_path: assets.display().to_string(),
            processed_file_path: processed.display().to_string(),
            unapproved_path_mode: UnapprovedPathMode::Allow,
            ..plugin
        },
        VdbRenderPlugin,
    ));
    app
}

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

fn load<A: Asset + Clone>(app: &mut App, path: &str) -> Result<A, String> {
    let handle: Handle<A> = app.world().resource::<AssetServer>().load(path.to_owned());
    until(app, path, |world| match world.resource::<AssetServer>().load_state(&handle) {
        LoadState::Failed(error) => Some(Err(error.to_string())),
        _ => world.resource::<Assets<A>>().get(&handle).cloned().map(Ok),
    })
}

fn grid(app: &App, handle: &Handle<VdbGrid>) -> VdbGrid {
    app.world().resource::<Assets<VdbGrid>>().get(handle).unwrap().clone()
}

#[test]
fn cooked_files_load_like_others_without_trees() {
    let folder = Folder::new("load");
    let options = CookOptions { format: ValueFormat::Exact, smooth: true, ..default() };
    fs::write(folder.asset("fire.vdbc"), cooked(&options)).unwrap();
    file().save(folder.asset("fire.vdb"), &WriteOptions::default()).unwrap();
    let mut app = app(&folder, AssetPlugin::default());
    let own: VdbFile = load(&mut app, "fire.vdbc").unwrap();
    let other: VdbFile = load(&mut app, "fire.vdb").unwrap();
    assert_eq!(own.grids.len(), 3);
    for (label, handle) in &own.named_grids {
        let (own, other) = (grid(&app, handle), grid(&app, &other.named_grids[label]));
        assert!(own.tree().is_none() && other.tree().is_some());
        assert_eq!(
            (own.name(), own.kind(), own.class()),
            (other.name(), other.kind(), other.class())
        );
        assert_eq!(own.world_bounds(), other.world_bounds());
        assert!(own.packed().words == other.packed().words, "other words: {label}");
    }
    // Emission is guessed from what is packed.
    let grids = app.world().resource::<Assets<VdbGrid>>();
    let guess = |file: &VdbFile| {
        let flame = &file.named_grids["flame"];
        match VdbEmission::guess(flame.clone(), grids.get(flame).unwrap()) {
            VdbEmission::Temperature { scale, offset, strength, .. } => [scale, offset, strength],
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(guess(&own), guess(&other));
    let alone: VdbGrid = load(&mut app, "fire.vdbc#surface").unwrap();
    assert_eq!(alone.kind(), PackKind::Smooth { iso: 0.0 });
}

#[test]
fn the_main_grid_of_a_cooked_file_is_found_or_asked_for() {
    let folder = Folder::new("main");
    let mut smoke = file();
    smoke.grids.truncate(2);
    let bytes = CookedFile::cook(&smoke, &CookOptions::default()).unwrap().write().unwrap();
    fs::write(folder.asset("smoke.vdbc"), bytes).unwrap();
    fs::write(folder.asset("all.vdbc"), cooked(&CookOptions::default())).unwrap();
    let mut app = app(&folder, AssetPlugin::default());
    let main: VdbGrid = load(&mut app, "smoke.vdbc").unwrap();
    assert_eq!(main.name(), "density");
    let error = load::<VdbGrid>(&mut app, "all.vdbc").unwrap_err();
    assert!(error.contains("`#density`, `#flame`, `#surface`"), "{error}");
    let error = load::<VdbVectorGrid>(&mut app, "smoke.vdbc").unwrap_err();
    assert!(
        error.contains("no grid of vectors that could be meant; it has density, flame"),
        "{error}"
    );
}

#[test]
fn what_needs_a_tree_says_that_there_is_none() {
    let folder = Folder::new("errors");
    fs::write(folder.asset("fire.vdbc"), cooked(&CookOptions::default())).unwrap();
    let mut app = app(&folder, AssetPlugin::default());
    let mut density: VdbGrid = load(&mut app, "fire.vdbc#density").unwrap();
    let words = density.packed().clone();
    let errors: [Result<(), VdbGridError>; 5] = [
        density.edit(|voxels| voxels.set(IVec3::ZERO, 1.0)),
        density.save(folder.asset("saved.vdb")),
        density.to_grid().map(|_| ()),
        density.clone().with_values(VdbValues::Half).map(|_| ()),
        density.clone().with_kind(PackKind::Surface { iso: 0.5 }).map(|_| ()),
    ];
    for error in errors {
        let error = error.unwrap_err().to_string();
        assert!(error.starts_with("grid 'density' is cooked"), "{error}");
    }
    assert!(Arc::ptr_eq(&words, density.packed()) && !density.is_edited());
    assert!(!folder.asset("saved.vdb").exists());
}

#[test]
fn rays_and_points_find_cooked_volumes() {
    let folder = Folder::new("query");
    let options = CookOptions { format: ValueFormat::Exact, smooth: true, ..default() };
    fs::write(folder.asset("fire.vdbc"), cooked(&options)).unwrap();
    file().save(folder.asset("fire.vdb"), &WriteOptions::default()).unwrap();
    let mut app = app(&folder, AssetPlugin::default());
    let answers = |app: &mut App, path: &str| {
        let file: VdbFile = load(app, path).unwrap();
        let volumes: Vec<Entity> = ["density", "surface"]
            .map(|label| app.world_mut().spawn(VdbVolume(file.named_grids[label].clone())).id())
            .into();
        app.update();
        let run = move |query: VdbSpatialQuery| {
            volumes
                .iter()
                .map(|volume| {
                    let ray = Ray3d::new(Vec3::new(0.3, 40.0, 0.2), Dir3::NEG_Y);
                    let only = |entity| entity == *volume;
                    let settings = VdbRayCastSettings {
                        filter: &only,
                        visibility: VdbRayVisibility::Any,
                        ..default()
                    };
                    let hit = query.cast_ray_nearest(ray, &settings).unwrap();
                    let at = Vec3::new(1.0, 2.0, 0.5);
                    (hit.position, hit.normal, hit.voxel, hit.value, query.contains(*volume, at))
                })
                .collect::<Vec<_>>()
        };
        app.world_mut().run_system_once(run).unwrap()
    };
    let [own, other] = ["fire.vdbc", "fire.vdb"].map(|path| answers(&mut app, path));
    assert_eq!(own, other);
    assert!(own.iter().all(|(.., value, contains)| value.is_some() && *contains), "{own:?}");
}

#[test]
fn damaged_and_foreign_files_are_refused_with_a_message() {
    let folder = Folder::new("damaged");
    let good = cooked(&CookOptions::default());
    let mut damaged = good.clone();
    *damaged.last_mut().unwrap() ^= 1;
    let mut old = good.clone();
    old[8] = 99;
    fs::write(folder.asset("damaged.vdbc"), &damaged).unwrap();
    fs::write(folder.asset("short.vdbc"), &good[..good.len() / 2]).unwrap();
    fs::write(folder.asset("old.vdbc"), &old).unwrap();
    fs::write(folder.asset("text.vdbc"), b"no volume at all").unwrap();
    let mut app = app(&folder, AssetPlugin::default());
    for (name, message) in [
        ("damaged.vdbc", "the cooked file is damaged: the checksum is wrong"),
        ("short.vdbc", "the cooked file is damaged"),
        ("old.vdbc", "the file was cooked in version 99 of the format"),
        ("text.vdbc", "this is not a VDB file"),
    ] {
        let error = load::<VdbFile>(&mut app, name).unwrap_err();
        assert!(error.contains(message), "{name}: {error}");
    }
}

#[test]
fn frames_of_a_cooked_folder_play() {
    let folder = Folder::new("frames");
    fs::create_dir(folder.asset("fire")).unwrap();
    for number in 1..=5 {
        let mut tree = vdb_core::tree::Vdb543::new(0.0);
        tree.set(IVec3::ZERO, number as f32);
        let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
        grid.class = GridClass::FogVolume;
        let file = vdb_core::VdbFile::new(vec![grid]);
        let cooked = CookedFile::cook(&file, &CookOptions::default()).unwrap();
        cooked.save(folder.asset(&format!("fire/fire_{number:04}.vdbc"))).unwrap();
    }
    let mut app = app(&folder, AssetPlugin::default());
    let sequence = app.world().resource::<AssetServer>().load_vdb_sequence("fire");
    let player = app.world_mut().spawn(VdbPlayer::new(sequence).paused()).id();
    for number in [1_u64, 4, 2, 5] {
        app.world_mut().get_mut::<VdbPlayer>(player).unwrap().seek(number);
        until(&mut app, "the frame", |world| {
            let volume = world.get::<VdbVolume>(player)?;
            let grid = world.resource::<Assets<VdbGrid>>().get(&volume.0)?;
            (grid.packed().majorant == number as f32).then_some(())
        });
    }
}

/// An app that processes its assets and cooks all `.vdb` files.
fn processing(folder: &Folder) -> App {
    let plugin = AssetPlugin {
        mode: AssetMode::Processed,
        use_asset_processor_override: Some(true),
        watch_for_changes_override: Some(false),
        ..default()
    };
    let mut app = app(folder, plugin);
    app.set_default_asset_processor::<VdbCooker>("vdb");
    // By default, all processors of a project share a log, and one that finds unfinished entries of another there
    // processes everything anew.
    let log = FileTransactionLogFactory { file_path: folder.0.join("log") };
    app.world().resource::<AssetProcessor>().data().set_log_factory(Box::new(log)).unwrap();
    app
}

#[test]
fn bevy_cooks_files_when_it_processes_assets() {
    let folder = Folder::new("process");
    let mut with_colour = file();
    let colour = vdb_core::tree::Vdb543::new([0.5_f32; 3]);
    with_colour.grids.push(Grid::new("Cd", AnyTree::Vec3s(colour.into())));
    with_colour.save(folder.asset("fire.vdb"), &WriteOptions::default()).unwrap();
    let settings = "(meta_format_version: \"1.0\", asset: Process(\
        processor: \"bevy_vdb::VdbCooker\", \
        settings: (load: (grids: Some([\"density\"]), values: Byte))))";
    file().save(folder.asset("small.vdb"), &WriteOptions::default()).unwrap();
    fs::write(folder.asset("small.vdb.meta"), settings).unwrap();

    let mut first = processing(&folder);
    let fire: VdbFile = load(&mut first, "fire.vdb").unwrap();
    assert_eq!((fire.grids.len(), fire.vector_grids.len()), (3, 0));
    let density = grid(&first, &fire.named_grids["density"]);
    let surface = grid(&first, &fire.named_grids["surface"]);
    assert!(density.tree().is_none() && surface.tree().is_none());
    assert_eq!(surface.kind(), PackKind::Smooth { iso: 0.0 });
    // The words are those of the file.
    let AnyTree::Float(tree) = &with_colour.grids[0].tree else { panic!() };
    let packed = PackedGrid::new(tree, PackKind::Fog).unwrap();
    assert!(density.packed().words == packed.words);
    let small: VdbFile = load(&mut first, "small.vdb").unwrap();
    assert_eq!(small.grids.len(), 1);
    assert_eq!(grid(&first, &small.grids[0]).packed().sample_format(), Some(2));

    // Not a second time.
    let folder = folder.copy("process_again");
    let time = |name: &str| fs::metadata(folder.processed(name)).unwrap().modified().unwrap();
    let before = ["fire.vdb", "small.vdb"].map(time);
    let bytes = fs::read(folder.processed("fire.vdb")).unwrap();
    assert!(CookedFile::is_cooked(&bytes));
    let mut second = processing(&folder);
    load::<VdbFile>(&mut second, "fire.vdb").unwrap();
    load::<VdbFile>(&mut second, "small.vdb").unwrap();
    assert_eq!(["fire.vdb", "small.vdb"].map(time), before);

    // When the file changes.
    let folder = folder.copy("process_changed");
    let other = vdb_core::VdbFile::new(vec![file().grids.remove(1)]);
    other.save(folder.asset("fire.vdb"), &WriteOptions::default()).unwrap();
    let mut third = processing(&folder);
    let changed: VdbFile = load(&mut third, "fire.vdb").unwrap();
    assert_eq!(changed.named_grids.keys().collect::<Vec<_>>(), ["flame"]);
}

/// Points are cooked as they would be displayed: by default, they are not.
#[test]
fn points_are_cooked_as_a_volume() {
    let folder = Folder::new("points");
    let points = super::points::bytes();
    for name in ["balls.vdb", "left_out.vdb"] {
        fs::write(folder.asset(name), &points).unwrap();
    }
    let settings = "(meta_format_version: \"1.0\", asset: Process(\
        processor: \"bevy_vdb::VdbCooker\", settings: (load: (\
        points: Balls, point_voxel_size: Some(0.05), point_radius: Some(0.2)))))";
    fs::write(folder.asset("balls.vdb.meta"), settings).unwrap();
    let mut app = processing(&folder);
    let balls: VdbFile = load(&mut app, "balls.vdb").unwrap();
    assert_eq!(balls.grids.len(), 3);
    for balls in balls.grids.iter().map(|handle| grid(&app, handle)) {
        assert!(balls.tree().is_none() && matches!(balls.kind(), PackKind::Smooth { .. }));
    }
    load::<VdbFile>(&mut app, "left_out.vdb").unwrap_err();
}

#[test]
fn a_file_that_cannot_be_cooked_says_why() {
    let folder = Folder::new("refused");
    fs::write(folder.asset("text.vdb"), b"no volume at all").unwrap();
    let mut app = processing(&folder);
    let error = load::<VdbFile>(&mut app, "text.vdb").unwrap_err();
    assert!(Path::new(&folder.asset("text.vdb")).exists());
    assert!(!folder.processed("text.vdb.meta").exists(), "{error}");
}
