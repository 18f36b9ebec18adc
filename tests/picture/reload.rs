//! Shaders that are edited, and files that change, while an app runs.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::shader::Shader;
use bevy_vdb::{VdbFile, VdbGrid, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, WriteOptions};

use super::common::{Picture, Stage};
use super::log::{listen, said};
use super::{GREEN, SIZE, glow, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

const TRACE: &str = include_str!("../../assets/shaders/trace/trace.wgsl");

/// A shader that does not compile leaves the picture as it was; a sound one is seen.
#[gpu_test]
#[ignore = "slow: compiles shaders anew"]
fn a_broken_shader_leaves_the_last_good_one() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    stage.world().spawn((VdbVolume(grid), glow(GREEN)));
    let before = stage.picture(&target);
    assert!(before.center().y > 0.5, "nothing is there");
    let edit = |stage: &mut Stage, source: String| {
        let path = "embedded://bevy_vdb/shaders/trace/trace.wgsl";
        let shader: Handle<Shader> = stage.world().resource::<AssetServer>().load(path);
        let mut shaders = stage.world().resource_mut::<Assets<Shader>>();
        shaders.insert(shader.id(), Shader::from_wgsl(source, path)).unwrap();
        stage.update(8);
        stage.picture(&target)
    };
    let wrote = "vec4(finite(result.color), result.coverage)";
    assert!(TRACE.contains(wrote));
    let broken = edit(&mut stage, TRACE.replace(wrote, "vec4(no_such_thing)"));
    assert!(broken == before, "the broken shader shows");
    let blue = "vec4(0.0, 0.0, result.coverage, result.coverage)";
    let mended = edit(&mut stage, TRACE.replace(wrote, blue));
    assert!(mended.center().z > 0.9 && mended.center().y < 0.1, "{}", mended.center());
    assert!(edit(&mut stage, TRACE.into()) == before);
}

/// An app that watches a folder, and one file in it that is shown.
struct Watched {
    stage: Stage,
    target: Handle<Image>,
    volume: Entity,
    path: PathBuf,
    heard: usize,
}

impl Watched {
    /// The folder is of this name, and so is the file, by which what is said of it is told from all else.
    fn new(name: &str, grids: Vec<Grid>) -> Self {
        listen();
        let folder = std::env::temp_dir().join(format!("bevy_vdb_{name}_{}", std::process::id()));
        fs::remove_dir_all(&folder).ok();
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join(format!("{name}.vdb"));
        fs::write(&path, bytes(grids)).unwrap();
        let mut stage = Stage::watching(&folder, |_| {});
        let target = stage.target(SIZE);
        stage.camera(&target, looking(Vec3::Z * 6.0));
        let sun = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
        stage.world().spawn((DirectionalLight { illuminance: 3.0, ..default() }, sun));
        let volume = stage.world().spawn(glow(GREEN)).id();
        let mut watched = Self { stage, target, volume, path, heard: 0 };
        watched.show(&format!("{name}.vdb#density"));
        watched
    }

    /// Shows a grid, once it is there.
    fn show(&mut self, label: &str) {
        let server = self.stage.world().resource::<AssetServer>();
        let grid: Handle<VdbGrid> = server.load(label.to_owned());
        self.stage.world().entity_mut(self.volume).insert(VdbVolume(grid.clone()));
        self.until("the grid", |watched| {
            watched.stage.world().resource::<Assets<VdbGrid>>().contains(&grid)
        });
    }

    fn picture(&mut self) -> Picture {
        self.stage.picture(&self.target)
    }

    fn until(&mut self, what: &str, mut holds: impl FnMut(&mut Self) -> bool) {
        let end = Instant::now() + Duration::from_secs(60);
        while !holds(self) {
            assert!(Instant::now() < end, "{what} did not come; said was {:#?}", self.said());
            self.stage.update(1);
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Until the grid that is shown has so many voxels: each of the files here has others.
    fn until_shown(&mut self, tree: &Vdb543<f32>) {
        let voxels = tree.active_voxel_count();
        let volume = self.volume;
        self.until("the changed grid", |watched| {
            let world = watched.stage.world();
            let grid = world.get::<VdbVolume>(volume).unwrap().0.clone();
            let grid = world.resource::<Assets<VdbGrid>>().get(&grid).unwrap();
            grid.tree().unwrap().active_voxel_count() == voxels
        });
    }

    /// All that has been said of the file.
    fn said(&self) -> Vec<String> {
        said(self.path.file_name().unwrap().to_str().unwrap())
    }

    /// What has been said of it since this was last asked: after longer than the watcher takes.
    fn news(&mut self) -> Vec<String> {
        let end = Instant::now() + Duration::from_secs(2);
        while Instant::now() < end {
            self.stage.update(1);
            std::thread::sleep(Duration::from_millis(5));
        }
        let said = self.said();
        let news = said[self.heard..].to_vec();
        self.heard = said.len();
        news
    }

    /// What is said, once something is.
    fn complaint(&mut self) -> Vec<String> {
        self.until("a message", |watched| watched.said().len() > watched.heard);
        self.news()
    }
}

fn grid(name: &str, class: GridClass, tree: &Vdb543<f32>) -> Grid {
    let mut grid = Grid::new(name, AnyTree::Float(Arc::new(tree.clone())));
    grid.class = class;
    let voxel = bevy::math::DAffine3::from_scale(DVec3::splat(0.1));
    grid.transform = vdb_core::Transform::affine(voxel).unwrap();
    grid
}

fn cloud(name: &str, tree: &Vdb543<f32>) -> Grid {
    grid(name, GridClass::FogVolume, tree)
}

fn bytes(grids: Vec<Grid>) -> Vec<u8> {
    let folder = std::env::temp_dir();
    let path = folder.join(format!("bevy_vdb_bytes_{:?}", std::thread::current().id()));
    vdb_core::VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
    let bytes = fs::read(&path).unwrap();
    fs::remove_file(path).unwrap();
    bytes
}

/// Whatever becomes of the file, what was last good in it is shown, one message says what is wrong, and when
/// the file is good again, so is the picture.
#[gpu_test]
#[ignore = "slow: waits for what does not come"]
fn the_last_good_file_is_shown() {
    let trees = [10.0, 14.0, 18.0].map(|radius| fog::sphere(DVec3::ZERO, radius, 4.0));
    let mut watched = Watched::new("last_good", vec![cloud("density", &trees[0])]);
    let first = watched.picture();
    assert!(first.center().y > 0.1, "nothing is there");
    let write = |watched: &Watched, bytes: &[u8]| fs::write(&watched.path, bytes).unwrap();

    let good = bytes(vec![cloud("density", &trees[1])]);
    write(&watched, &good[..good.len() / 2]);
    let said = watched.complaint();
    assert!(said.len() == 1 && said[0].contains("cut short"), "{said:#?}");
    assert!(watched.picture() == first, "what is damaged changed the picture");
    write(&watched, &good);
    watched.until_shown(&trees[1]);
    let second = watched.picture();
    assert!(second != first);
    assert_eq!(watched.news(), Vec::<String>::new());

    fs::remove_file(&watched.path).unwrap();
    assert_eq!(watched.news(), Vec::<String>::new(), "Bevy says nothing of a file that is deleted");
    assert!(watched.picture() == second, "what is deleted left the picture");

    // By a program that takes its time: the watcher looks when there is something, and again when it is whole.
    let good = bytes(vec![cloud("density", &trees[2])]);
    let mut file = fs::File::create(&watched.path).unwrap();
    file.write_all(&good[..good.len() / 2]).unwrap();
    file.sync_all().unwrap();
    let said = watched.complaint();
    assert!(said.len() == 1 && said[0].contains("cut short"), "{said:#?}");
    assert!(watched.picture() == second, "half of a file changed the picture");
    file.write_all(&good[good.len() / 2..]).unwrap();
    drop(file);
    watched.until_shown(&trees[2]);
    assert!(watched.picture() != second);
    assert_eq!(watched.news(), Vec::<String>::new());

    // Who holds the file itself is told by Bevy 0.19 twice: it tries twice (`reload_internal`).
    let server = watched.stage.world().resource::<AssetServer>();
    let file: Handle<VdbFile> = server.load("last_good.vdb");
    watched.until("the file", |watched| {
        watched.stage.world().resource::<Assets<VdbFile>>().contains(&file)
    });
    let third = watched.picture();
    write(&watched, b"no volume");
    let said = watched.complaint();
    assert!(said.len() <= 2 && said[0].contains("this is not a VDB file"), "{said:#?}");
    assert!(watched.picture() == third);
    assert!(watched.stage.world().resource::<Assets<VdbFile>>().contains(&file));
    fs::remove_dir_all(watched.path.parent().unwrap()).unwrap();
}

/// A grid that is no longer in its file, or is another kind of grid there.
#[gpu_test]
#[ignore = "slow: waits for what does not come"]
fn a_grid_may_leave_its_file_or_change_its_kind() {
    let trees = [10.0, 14.0].map(|radius| fog::sphere(DVec3::ZERO, radius, 4.0));
    let mut watched = Watched::new("lost_grid", vec![cloud("density", &trees[0])]);
    let first = watched.picture();
    fs::write(&watched.path, bytes(vec![cloud("smoke", &trees[1])])).unwrap();
    let said = watched.complaint();
    assert!(said.len() == 1 && said[0].contains("no longer has the grid 'density'"), "{said:#?}");
    assert!(watched.picture() == first, "the grid left the picture");

    let solid = level_set::sphere(DVec3::ZERO, 15.0);
    let level_set = grid("density", GridClass::LevelSet, &solid);
    let surface = bytes(vec![level_set]);
    fs::write(&watched.path, &surface).unwrap();
    watched.until_shown(&solid);
    let reloaded = watched.picture();
    // As an app sees it that never knew the fog.
    fs::write(watched.path.with_file_name("fresh.vdb"), &surface).unwrap();
    watched.show("fresh.vdb#density");
    assert!(watched.picture() == reloaded, "something of the fog is left");
    let mut fresh = Watched::new("fresh_grid", vec![grid("density", GridClass::LevelSet, &solid)]);
    assert!(fresh.picture() == reloaded);
    assert_eq!(watched.news(), Vec::<String>::new());

    // As vectors, no volume can show it.
    let vectors = Vdb543::new([0.5_f32, 0.0, 0.25]);
    let vectors = Grid::new("density", AnyTree::Vec3s(Arc::new(vectors)));
    fs::write(&fresh.path, bytes(vec![vectors])).unwrap();
    let said = fresh.complaint();
    assert!(said.len() == 1 && said[0].contains("no longer has the grid 'density'"), "{said:#?}");
    assert!(fresh.picture() == reloaded, "the grid left the picture");

    // A grid that is taken out of the assets is gone from the picture, and nothing else happens.
    let gone = watched.stage.world().get::<VdbVolume>(watched.volume).unwrap().0.clone();
    watched.stage.world().resource_mut::<Assets<VdbGrid>>().remove(&gone);
    assert_eq!(watched.picture().count(|pixel| pixel.max_element() > 0.01 && pixel.y > 0.01), 0);
    assert_eq!(watched.news(), Vec::<String>::new());
    for folder in [&watched.path, &fresh.path].map(|path| path.parent().unwrap()) {
        fs::remove_dir_all::<&Path>(folder).unwrap();
    }
}
