//! Pages of a file that is not read as a whole.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Mutex;

use glam::{DVec3, IVec3};
use vdb_core::pages::{
    FileSource, PageId, PageIndex, PageOptions, PageSource, PagesError, StreamedFile, TreeSource,
    cook_pages,
};
use vdb_core::synth::{Random, level_set};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{
    AnyTree, Codec, Compression, Error, Grid, GridClass, Limits, NanoVdbOptions, ReadOptions,
    VdbFile, WriteOptions,
};

/// A folder that is deleted at the end of a test.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("vdb-paged-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn vdb(&self) -> PathBuf {
        self.0.join("thing.vdb")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A ball that crosses the borders of pages and root nodes, with a thin sheet through it, and tiles.
pub fn thing() -> Vdb543<f32> {
    let center = DVec3::new(5.3, -7.1, 3.9);
    let bounds = CoordBox { min: IVec3::new(-150, -60, -60), max: IVec3::new(150, 60, 60) };
    let normal = DVec3::new(0.01, 0.02, 1.0).normalize();
    let half = DVec3::new(140.0, 30.0, 60.0);
    let distance = |p: DVec3| {
        let sheet = ((p.dot(normal) - 0.3).abs() - 0.6).max((p.abs() - half).max_element());
        (p.distance(center) - 45.0).min(sheet)
    };
    let mut tree = level_set::from_distance(bounds, distance);
    // A column of solid tiles of 8³.
    for z in 0..20 {
        tree.fill_leaf(IVec3::new(136, 112, 8 * z), -3.0, false);
    }
    tree.insert_tile(IVec3::splat(8192), 3.0, true);
    tree
}

pub fn file(tree: Vdb543<f32>, change: impl Fn(&mut Grid)) -> VdbFile {
    let mut grid = Grid::new("thing", AnyTree::Float(tree.into()));
    grid.class = GridClass::LevelSet;
    change(&mut grid);
    VdbFile::new(vec![grid])
}

type Files = BTreeMap<PageId, Vec<u8>>;

fn cook(source: &impl PageSource, edge: u32, smooth: bool) -> (PageIndex, Files) {
    let files = Mutex::new(Files::new());
    let options = PageOptions { edge, smooth, ..PageOptions::default() };
    let index = cook_pages(source, &options, &|id, bytes| {
        files.lock().unwrap().insert(id, bytes.to_vec());
        Ok(())
    });
    (index.unwrap(), files.into_inner().unwrap())
}

pub fn streamed(folder: &Folder, limits: Limits) -> Result<FileSource, PagesError> {
    let file = StreamedFile::open(folder.vdb(), &limits)
        .map_err(|error| PagesError::Source(error.into()))?;
    let name = file.grids()[0].unique_name.clone();
    FileSource::new(file, &name, &folder.0, limits)
}

#[test]
fn pages_of_a_file_are_those_of_its_tree_bit_for_bit() {
    let folder = Folder::new("same");
    let tree = thing();
    let codecs = [
        (Codec::None, false, false, 128, false),
        (Codec::None, true, true, 128, true),
        (Codec::Zip, true, false, 256, true),
        (Codec::Zip, false, true, 128, false),
        (Codec::Blosc, true, false, 128, true),
        (Codec::Blosc, false, true, 384, true),
    ];
    for (codec, active_mask, half, edge, smooth) in codecs {
        let written = file(tree.clone(), |grid| {
            grid.compression = Compression { codec, active_mask };
            grid.saved_as_half = half;
        });
        written.save(folder.vdb(), &WriteOptions::default()).unwrap();
        let read = VdbFile::open(folder.vdb()).unwrap();
        let whole = TreeSource::new(&read.grids[0], Limits::default()).unwrap();
        let expected = cook(&whole, edge, smooth);
        let found = cook(&streamed(&folder, Limits::default()).unwrap(), edge, smooth);
        assert!(expected.1.len() > 8 && expected.0.levels > 1 || edge > 128);
        assert_eq!(found.0, expected.0, "{codec:?} {edge}");
        assert!(found.1 == expected.1, "{codec:?} {edge}: other bytes");
    }
    let left: Vec<_> = std::fs::read_dir(&folder.0).unwrap().collect();
    assert_eq!(left.len(), 1, "temporary files are left: {left:?}");
}

#[test]
fn a_grid_without_a_class_is_a_surface_if_it_has_negative_values() {
    let folder = Folder::new("class");
    for (value, is_surface) in [(-1.0, true), (1.0, false)] {
        let mut tree = Vdb543::new(2.0);
        tree.set(IVec3::new(1, 2, 3), 0.5);
        tree.set(IVec3::new(300, 2, 3), value);
        let written = file(tree, |grid| grid.class = GridClass::Unknown);
        written.save(folder.vdb(), &WriteOptions::default()).unwrap();
        let source = streamed(&folder, Limits::default());
        assert_eq!(source.is_ok(), is_surface);
        assert!(is_surface || matches!(source, Err(PagesError::Fog { .. })));
    }
}

/// The reason why a file has to be read as a whole.
fn reason(folder: &Folder) -> String {
    match streamed(folder, Limits::default()).err().unwrap() {
        PagesError::Source(error) => {
            assert!(matches!(*error, Error::NotSupported { .. }), "{error}");
            error.to_string()
        }
        error => panic!("{error}"),
    }
}

#[test]
fn what_cannot_be_read_in_parts_says_why() {
    let folder = Folder::new("whole");
    let sphere = || level_set::sphere(DVec3::ZERO, 20.0);
    let stream = WriteOptions { stream: true, ..WriteOptions::default() };
    file(sphere(), |_| {}).save(folder.vdb(), &stream).unwrap();
    assert!(reason(&folder).contains("as a stream"));
    file(sphere(), |_| {}).save_nanovdb(folder.vdb(), &NanoVdbOptions::default()).unwrap();
    assert!(reason(&folder).contains(".nvdb"));
    let doubles = vdb_core::tree::Tree::new(1.0_f64);
    let grid = Grid::new("thing", AnyTree::Double(doubles.into()));
    VdbFile::new(vec![grid]).save(folder.vdb(), &WriteOptions::default()).unwrap();
    assert!(reason(&folder).contains("Tree_double_5_4_3"));
    let shared: std::sync::Arc<_> = sphere().into();
    let mut grids: Vec<_> =
        ["a", "b"].map(|name| Grid::new(name, AnyTree::Float(shared.clone()))).into();
    for grid in &mut grids {
        grid.class = GridClass::LevelSet;
    }
    VdbFile::new(grids).save(folder.vdb(), &WriteOptions::default()).unwrap();
    let open = || StreamedFile::open(folder.vdb(), &Limits::default()).unwrap();
    let source = |name| FileSource::new(open(), name, &folder.0, Limits::default());
    assert!(source("a").is_ok());
    let error = source("b").err().unwrap().to_string();
    assert!(error.contains("shares the tree") && error.contains("thing.vdb"), "{error}");
    assert!(source("c").err().unwrap().to_string().contains("no grid \"c\""));
}

#[test]
fn damaged_files_are_refused_or_cooked_without_panicking() {
    let folder = Folder::new("damaged");
    let written = file(level_set::sphere(DVec3::new(-3.0, 8.0, 4090.0), 12.0), |grid| {
        grid.compression = Compression { codec: Codec::Blosc, active_mask: true };
    });
    let good = written.write(&WriteOptions::default()).unwrap();
    let mut random = Random::new(9);
    let limits = Limits::default();
    let (mut refused, mut cooked) = (0, 0);
    for round in 0..200 {
        let mut bytes = good.clone();
        if round % 4 == 0 {
            bytes.truncate(random.below(good.len() as u64) as usize);
        } else {
            for _ in 0..1 + random.below(4) {
                let at = random.below(good.len() as u64) as usize;
                bytes[at] = random.below(256) as u8;
            }
        }
        std::fs::write(folder.vdb(), &bytes).unwrap();
        let whole = VdbFile::read(&bytes, &ReadOptions::default());
        let found = streamed(&folder, limits.clone()).and_then(|source| {
            let options = PageOptions { edge: 128, ..PageOptions::default() };
            cook_pages(&source, &options, &|_, _| Ok(()))
        });
        match found {
            Err(_) => refused += 1,
            Ok(index) => {
                cooked += 1;
                // What is read in parts can be read as a whole, with the same result.
                let file = whole.unwrap();
                let source = TreeSource::new(&file.grids[0], limits.clone()).unwrap();
                assert_eq!(index, cook(&source, 128, false).0, "round {round}");
            }
        }
    }
    assert!(refused > 50 && cooked > 5, "{refused} refused, {cooked} cooked");
}

#[test]
fn memory_is_limited_before_it_is_taken() {
    let folder = Folder::new("limits");
    file(thing(), |_| {}).save(folder.vdb(), &WriteOptions::default()).unwrap();
    let limited = |change: fn(&mut Limits)| {
        let mut limits = Limits::default();
        change(&mut limits);
        streamed(&folder, limits).and_then(|source| {
            let options = PageOptions { edge: 128, ..PageOptions::default() };
            cook_pages(&source, &options, &|_, _| Ok(()))
        })
    };
    // The file as a whole does not count.
    assert!(limited(|limits| limits.file_bytes = 100).is_ok());
    let names = ["nodes", "voxels", "tree_bytes", "tree_bytes"];
    let changes: [fn(&mut Limits); 4] = [
        |limits| limits.nodes = 1000,
        |limits| limits.voxels = 100_000,
        |limits| limits.tree_bytes = 10_000,
        // Enough for the offsets and for children of the root, but not for the leaves of a page.
        |limits| limits.tree_bytes = 2_000_000,
    ];
    for (name, change) in names.into_iter().zip(changes) {
        let error = limited(change).unwrap_err().to_string();
        assert!(error.contains(&format!("Limits::{name}")), "{error}");
    }
}

/// Hills of about 50 voxels on a square, as a level set.
fn terrain(size: i32) -> Vdb543<f32> {
    // Arcs of parabolas, with slopes of up to 4.
    let wave = |t: f64| {
        let (whole, part) = (t.floor(), t - t.floor());
        let arc = 4.0 * part * (1.0 - part);
        if whole % 2.0 == 0.0 { arc } else { -arc }
    };
    let height = move |p: DVec3| {
        20.0 * (wave(p.x / 190.0) + wave(p.y / 270.0 + 0.3)) + 5.0 * wave((p.x + p.y) / 61.0)
    };
    // Slopes add up to less than 1.
    let bounds = CoordBox { min: IVec3::new(0, 0, -64), max: IVec3::new(size - 1, size - 1, 64) };
    level_set::from_distance(bounds, move |p| (p.z - height(p)) / 1.6)
}

/// Prints time, size and peak memory. With `TERRAIN=8192 FILE=terrain.vdb`, only writes that file, of a square
/// of 8192² voxels.
#[test]
#[ignore = "slow: a terrain of 1024² voxels"]
fn a_terrain_that_is_read_in_parts() {
    let size = std::env::var("TERRAIN").ok().and_then(|text| text.parse().ok()).unwrap_or(1024);
    let folder = Folder::new("terrain");
    let path = std::env::var_os("FILE").map(PathBuf::from);
    let written = file(terrain(size), |_| {});
    println!("{} active voxels", written.grids[0].tree.active_voxel_count());
    written.save(path.clone().unwrap_or(folder.vdb()), &WriteOptions::default()).unwrap();
    drop(written);
    if path.is_some() {
        return;
    }
    let begin = std::time::Instant::now();
    let (index, files) = cook(&streamed(&folder, Limits::default()).unwrap(), 256, true);
    let bytes: usize = files.values().map(Vec::len).sum();
    println!("{} pages, {bytes} bytes, {:.1?}", index.pages.len(), begin.elapsed());
    assert!(index.pages.len() >= 16 && index.roots().count() <= 8);
}
