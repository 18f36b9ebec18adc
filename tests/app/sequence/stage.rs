//! An app with sequences, whose time is in the hands of the test, and files whose voxels tell the frame.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bevy::asset::AssetPlugin;
use bevy::asset::io::file::FileAssetReader;
use bevy::asset::io::{
    AssetReader, AssetReaderError, AssetSourceBuilder, PathStream, Reader, ReaderNotSeekableError,
    SeekableReader,
};
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::tasks::futures_lite::AsyncRead;
use bevy::time::TimeUpdateStrategy;
use bevy_vdb::prelude::*;
use vdb_core::query::GridQuery;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, WriteOptions};

/// The frame of a fog: its voxel at the origin.
pub fn frame_of(grid: &VdbGrid) -> u64 {
    GridQuery::of_packed(grid.packed()).nearest(DVec3::ZERO).unwrap() as u64
}

/// A fog with the number of its frame.
pub fn fog(name: &str, number: u64) -> Grid {
    let mut tree = Vdb543::new(0.0);
    tree.set(IVec3::ZERO, number as f32);
    tree.set(IVec3::new(2, 0, 0), 0.5);
    let mut grid = Grid::new(name, AnyTree::Float(tree.into()));
    grid.class = GridClass::FogVolume;
    grid
}

pub fn file(grids: Vec<Grid>) -> Vec<u8> {
    vdb_core::VdbFile::new(grids).write(&WriteOptions::default()).unwrap()
}

/// The files that the asset source `gate` lets pass, and those that have ever waited there.
#[derive(Clone, Default)]
pub struct Gate {
    open: Arc<Mutex<HashSet<PathBuf>>>,
    arrived: Arc<Mutex<HashSet<PathBuf>>>,
}

impl Gate {
    pub fn open(&self, name: &str) {
        self.open.lock().unwrap().insert(name.into());
    }

    /// Whether a load has ever waited for a file. Bevy's loader then holds no handle to it any more.
    pub fn has_arrived(&self, name: &str) -> bool {
        self.arrived.lock().unwrap().contains(Path::new(name))
    }
}

struct GateReader {
    gate: Gate,
    files: FileAssetReader,
}

/// A file that is opened at once, and read when the gate is open.
struct Gated<R> {
    gate: Gate,
    path: PathBuf,
    file: R,
}

impl<R: Reader> AsyncRead for Gated<R> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context,
        buffer: &mut [u8],
    ) -> Poll<std::io::Result<usize>> {
        if !self.gate.open.lock().unwrap().contains(&self.path) {
            self.gate.arrived.lock().unwrap().insert(self.path.clone());
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        Pin::new(&mut self.file).poll_read(context, buffer)
    }
}

impl<R: Reader> Reader for Gated<R> {
    fn seekable(&mut self) -> Result<&mut dyn SeekableReader, ReaderNotSeekableError> {
        Err(ReaderNotSeekableError)
    }
}

impl AssetReader for GateReader {
    async fn read<'a>(&'a self, path: &'a Path) -> Result<impl Reader + 'a, AssetReaderError> {
        let file = self.files.read(path).await?;
        Ok(Gated { gate: self.gate.clone(), path: path.to_owned(), file })
    }

    async fn read_meta<'a>(&'a self, path: &'a Path) -> Result<impl Reader + 'a, AssetReaderError> {
        self.files.read_meta(path).await
    }

    async fn read_directory<'a>(
        &'a self,
        path: &'a Path,
    ) -> Result<Box<PathStream>, AssetReaderError> {
        self.files.read_directory(path).await
    }

    async fn is_directory<'a>(&'a self, path: &'a Path) -> Result<bool, AssetReaderError> {
        self.files.is_directory(path).await
    }
}

/// An app whose assets are in a folder of its own.
pub struct Stage {
    pub app: App,
    pub folder: PathBuf,
    pub gate: Gate,
    /// Failed frames, by player.
    pub failed: Arc<Mutex<Vec<VdbFrameFailed>>>,
    /// Players that have come to their end.
    pub finished: Arc<Mutex<Vec<Entity>>>,
}

impl Drop for Stage {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.folder).ok();
    }
}

impl Stage {
    pub fn new(test: &str) -> Self {
        Self::with(test, false)
    }

    /// An app that reloads files that change.
    pub fn watching(test: &str) -> Self {
        Self::with(test, true)
    }

    fn with(test: &str, watches: bool) -> Self {
        let folder =
            std::env::temp_dir().join(format!("bevy_vdb_seq_{test}_{}", std::process::id()));
        fs::remove_dir_all(&folder).ok();
        fs::create_dir_all(&folder).unwrap();
        let gate = Gate::default();
        let mut app = App::new();
        let (own, root) = (gate.clone(), folder.clone());
        app.register_asset_source(
            "gate",
            AssetSourceBuilder::new(move || {
                Box::new(GateReader { gate: own.clone(), files: FileAssetReader::new(&root) })
            }),
        );
        app.add_plugins((
            MinimalPlugins,
            AssetPlugin {
                file_path: folder.display().to_string(),
                watch_for_changes_override: Some(watches),
                ..default()
            },
            VdbRenderPlugin,
        ));
        app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
        let failed = Arc::<Mutex<Vec<VdbFrameFailed>>>::default();
        let finished = Arc::<Mutex<Vec<Entity>>>::default();
        let (all_failed, all_finished) = (Arc::clone(&failed), Arc::clone(&finished));
        app.add_observer(move |event: On<VdbFrameFailed>| {
            all_failed.lock().unwrap().push(event.event().clone());
        });
        app.add_observer(move |event: On<VdbPlayerFinished>| {
            all_finished.lock().unwrap().push(event.entity);
        });
        app.update();
        Self { app, folder, gate, failed, finished }
    }

    /// Writes the frames `fire_0001.vdb` and so on, each a fog called `density`.
    pub fn write(&self, numbers: impl IntoIterator<Item = u64>) {
        for number in numbers {
            self.write_file(&name(number), &file(vec![fog("density", number)]));
        }
    }

    pub fn write_file(&self, name: &str, bytes: &[u8]) {
        fs::write(self.folder.join(name), bytes).unwrap();
    }

    /// A sequence of frames of [`Stage::write`], from the folder or through the gate.
    pub fn sequence(
        &mut self,
        source: &str,
        numbers: impl IntoIterator<Item = u64>,
    ) -> Handle<VdbSequence> {
        let frame = |number| VdbFrame::new(number, format!("{source}{}", name(number)));
        let sequence = VdbSequence::new(numbers.into_iter().map(frame)).with_rate(10.0);
        self.app.world_mut().resource_mut::<Assets<VdbSequence>>().add(sequence)
    }

    pub fn spawn(&mut self, player: VdbPlayer) -> Entity {
        self.app.world_mut().spawn(player).id()
    }

    pub fn cache(&mut self) -> Mut<'_, VdbFrameCache> {
        self.app.world_mut().resource_mut::<VdbFrameCache>()
    }

    pub fn server(&self) -> &AssetServer {
        self.app.world().resource::<AssetServer>()
    }

    pub fn player(&mut self, player: Entity) -> Mut<'_, VdbPlayer> {
        self.app.world_mut().get_mut::<VdbPlayer>(player).unwrap()
    }

    pub fn status(&self, player: Entity) -> VdbPlayerStatus {
        self.app.world().get::<VdbPlayerStatus>(player).unwrap().clone()
    }

    /// The grid that an entity shows.
    pub fn grid(&self, player: Entity) -> Option<&VdbGrid> {
        let world = self.app.world();
        let volume = world.get::<VdbVolume>(player)?;
        world.resource::<Assets<VdbGrid>>().get(&volume.0)
    }

    /// The frame that an entity shows, by its voxels and not by its status, which must say the same.
    pub fn shown(&self, player: Entity) -> Option<u64> {
        let shown = self.grid(player).map(frame_of);
        assert_eq!(shown, self.status(player).frame());
        shown
    }

    /// An update after a step of time.
    pub fn step(&mut self, step: Duration) {
        self.app.insert_resource(TimeUpdateStrategy::ManualDuration(step));
        self.app.update();
        self.app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
    }

    /// Updates without time until something holds.
    pub fn until(&mut self, what: &str, mut holds: impl FnMut(&Self) -> bool) {
        let start = Instant::now();
        while !holds(self) {
            assert!(start.elapsed() < Duration::from_secs(60), "{what} did not come");
            self.app.update();
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Updates without time until at least this many frames of a player are in memory: several may arrive in one
    /// update.
    pub fn until_loaded(&mut self, player: Entity, count: usize) {
        self.until("the frames", |stage| stage.status(player).loaded().len() >= count);
    }

    /// The frames that are shown in updates after equal steps of time; the first before any.
    pub fn frames(&mut self, player: Entity, step: Duration, count: usize) -> Vec<u64> {
        let mut frames = vec![self.shown(player).unwrap()];
        while frames.len() < count {
            self.step(step);
            frames.push(self.shown(player).unwrap());
        }
        frames
    }

    /// The numbers of the frames that have failed for a player, in the order of the events.
    pub fn failed(&self, player: Entity) -> Vec<u64> {
        let failed = self.failed.lock().unwrap();
        failed.iter().filter(|event| event.entity == player).map(|event| event.frame).collect()
    }

    pub fn files_in_memory(&self) -> usize {
        self.app.world().resource::<Assets<VdbFile>>().len()
    }
}

/// The file of a frame.
pub fn name(number: u64) -> String {
    format!("fire_{number:04}.vdb")
}

/// The time of a frame at 10 frames per second.
pub const FRAME: Duration = Duration::from_millis(100);
