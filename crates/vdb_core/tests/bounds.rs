//! Trees that are small and ask for much, as files and made here: packing and levels of detail take time
//! and memory in proportion to the nodes, or end in one error that names the limit.
//!
//! Memory is the peak of a process of its own, so that all of it counts.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use vdb_core::pack::{PackError, PackKind, PackOptions, PackedGrid, ValueFormat};
use vdb_core::synth::Random;
use vdb_core::tree::{
    Coarsening, IVec3, LevelOptions, Vdb543, half_resolution, voxel_in_distances,
};
use vdb_core::{AnyTree, Error, Grid, GridClass, ReadOptions, VdbFile, WriteOptions};

/// What all of it may take at once, with the file and its tree.
const MAX_KILOBYTES: u64 = 256 << 10;
/// Far more than it takes: for machines that are busy.
const MAX_TIME: Duration = Duration::from_secs(60);

const KINDS: [PackKind; 3] =
    [PackKind::Surface { iso: 0.0 }, PackKind::Smooth { iso: 0.0 }, PackKind::Fog];
const FORMATS: [ValueFormat; 4] =
    [ValueFormat::Exact, ValueFormat::Half, ValueFormat::Byte, ValueFormat::Full];

/// Files of `data/hostile` that have grids to pack.
const FILES: [&str; 10] = [
    "ansi",
    "lod_tiles_27k",
    "mutant_half_blosc_114k_1.5GB",
    "query_hang_ls",
    "roottiles_fog_100",
    "roottiles_fog_1000",
    "roottiles_ls_100",
    "uppertiles_fog_1",
    "uppertiles_fog_4",
    "uppertiles_ls_1",
];

/// Trees whose files have less than a megabyte.
const TREES: [(&str, fn() -> Vdb543<f32>); 6] = [
    ("root tiles side by side", || {
        root_tiles(20_000, |i| IVec3::new(i % 28, i / 28 % 28, i / 784))
    }),
    ("root tiles far apart", || {
        let mut random = Random::new(7);
        let mut at = || random.below(1 << 20) as i32 - (1 << 19);
        let places: Vec<IVec3> = (0..50_000).map(|_| IVec3::new(at(), at(), at())).collect();
        root_tiles(50_000, move |i| places[i as usize])
    }),
    ("upper nodes of tiles", || upper_nodes(50)),
    ("lower nodes with a leaf each", || leaves(800, 256)),
    ("leaves apart from each other", || leaves(6000, 16)),
    ("leaves in nodes of their own", || leaves(90, 8192)),
];

fn root_tiles(count: i32, at: impl Fn(i32) -> IVec3) -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.0);
    for i in 0..count {
        tree.insert_tile(at(i) * 4096, 0.5 + (i % 7) as f32, true);
    }
    tree
}

fn upper_nodes(count: i32) -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.0);
    for node in 0..count {
        let origin = IVec3::new(node % 5, node / 5 % 5, node / 25) * 4096;
        tree.insert_tile(origin, 1.0, true);
        // Tiles of 128³ that are unlike the others.
        for i in 0..8 {
            tree.fill_leaf(origin + IVec3::new(i * 500, 77 * i, 9), 0.0, false);
        }
    }
    tree.prune();
    tree
}

fn leaves(count: i32, apart: i32) -> Vdb543<f32> {
    let edge = (f64::from(count).cbrt().ceil()) as i32;
    let mut tree = Vdb543::new(0.0);
    for i in 0..count {
        let at = IVec3::new(i % edge, i / edge % edge, i / edge / edge) * apart;
        tree.set(at, 1.0 + i as f32 * 0.001);
    }
    tree
}

/// Reads, packs in all ways, and makes all levels: what the tests below run in a process of its own, and nothing
/// without their word.
#[test]
fn child() {
    let Ok(name) = std::env::var("VDB_BOUNDS") else { return };
    let trees = match TREES.iter().find(|(own, _)| *own == name) {
        Some((_, make)) => vec![make().into()],
        None => {
            let path = Path::new("tests/data/hostile").join(format!("{name}.vdb"));
            let file = VdbFile::open(path).unwrap_or_else(|error| panic!("{error}"));
            let floats = file.grids.into_iter().filter_map(|grid| match grid.tree {
                AnyTree::Float(tree) => Some(tree),
                _ => None,
            });
            floats.collect()
        }
    };
    for tree in trees {
        for kind in KINDS {
            let formats = if kind == KINDS[0] { &FORMATS[..1] } else { &FORMATS };
            for format in formats {
                let start = Instant::now();
                let outcome = match PackedGrid::with_format(&tree, kind, *format) {
                    Ok(packed) => format!("{} KB", packed.bytes() >> 10),
                    Err(error) => {
                        assert!(matches!(error, PackError::LimitExceeded { .. }), "{error:?}");
                        error.to_string()
                    }
                };
                println!("{kind:?} {format:?}: {:.1?}, {outcome}", start.elapsed());
            }
            make_levels(&tree, kind);
        }
    }
    if let Ok(status) = std::fs::read_to_string("/proc/self/status") {
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        println!("peak {}", peak.trim().trim_end_matches(" kB"));
    }
}

fn make_levels(tree: &Vdb543<f32>, kind: PackKind) {
    let start = Instant::now();
    let mut levels = Vec::new();
    while levels.len() < 32 {
        let finer = levels.last().unwrap_or(tree);
        let coarsening = match kind {
            PackKind::Fog => Coarsening::Fog,
            PackKind::Surface { iso } | PackKind::Smooth { iso } => {
                Coarsening::Surface { iso, voxel: voxel_in_distances(finer) }
            }
        };
        match half_resolution(finer, coarsening, &LevelOptions::default()) {
            Ok(coarser) => match PackedGrid::new(&coarser, kind) {
                // As long as there is something to see, as in the app.
                Ok(PackedGrid { occupied: Some(cells), .. }) => {
                    levels.push(coarser);
                    if cells.dim().into_iter().max() < Some(32) {
                        break;
                    }
                }
                Ok(_) => break,
                Err(error) => {
                    println!("level {}: {error}", levels.len() + 1);
                    break;
                }
            },
            Err(error) => {
                assert!(matches!(error, Error::LimitExceeded { .. }), "{error:?}");
                println!("level {}: {error}", levels.len() + 1);
                break;
            }
        }
    }
    println!("{} levels: {:.1?}", levels.len(), start.elapsed());
}

fn check(name: &str) {
    let start = Instant::now();
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--nocapture"])
        .env("VDB_BOUNDS", name)
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    println!("{name}: {:.1?}\n{told}", start.elapsed());
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    if let Some(peak) = told.lines().find_map(|line| line.strip_prefix("peak ")) {
        let peak: u64 = peak.parse().unwrap();
        assert!(peak <= MAX_KILOBYTES, "{name} takes {peak} KB");
    }
    assert!(start.elapsed() < MAX_TIME, "{name} takes {:.1?}", start.elapsed());
}

#[test]
fn files_end_in_bounds() {
    FILES.into_iter().for_each(check);
}

#[test]
#[ignore = "slow: trees that take all the memory they may"]
fn trees_end_in_bounds() {
    for (name, make) in TREES {
        let mut grid = Grid::new("hostile", AnyTree::Float(make().into()));
        grid.class = GridClass::FogVolume;
        let bytes = VdbFile::new(vec![grid]).write(&WriteOptions::default()).unwrap();
        assert!(bytes.len() < 1 << 20, "a file of {} bytes proves nothing", bytes.len());
        check(name);
    }
}

#[test]
fn instances_in_a_cycle_are_one_error() {
    let error = VdbFile::open("tests/data/hostile/cycle.vdb").unwrap_err();
    assert!(matches!(error, Error::Invalid { .. }), "{error:?}");
}

#[test]
fn limits_are_named() {
    let tree = leaves(600, 16);
    let mut options = PackOptions::default();
    options.limits.packed_bytes = 1 << 16;
    let error = PackedGrid::with_options(&tree, PackKind::Fog, &options).unwrap_err();
    assert!(error.to_string().contains("`Limits::packed_bytes`"), "{error}");
    let tree = root_tiles(50_000, |i| IVec3::new(i % 37, i / 37 % 37, i / 1369) * 16);
    let error = PackedGrid::new(&tree, PackKind::Fog).unwrap_err();
    assert!(error.to_string().contains("`Limits::packed_growth`"), "{error}");
    let error = half_resolution(&tree, Coarsening::Fog, &LevelOptions::default()).unwrap_err();
    assert!(error.to_string().contains("`Limits::level_bytes`"), "{error}");
}

#[test]
fn packing_and_levels_report_and_can_be_cancelled() {
    use std::ops::ControlFlow;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};
    let tree = leaves(1000, 16);
    let steps = Arc::new(AtomicU64::new(0));
    let last = Arc::new(AtomicU64::new(0));
    for stop_after in [u64::MAX, 0, 1, 5] {
        steps.store(0, Ordering::Relaxed);
        let (steps, last) = (steps.clone(), last.clone());
        let progress: Arc<vdb_core::ProgressFn> = Arc::new(move |done, all| {
            assert!(done <= all, "{done} of {all}");
            last.fetch_max(done, Ordering::Relaxed);
            let stop = steps.fetch_add(1, Ordering::Relaxed) >= stop_after;
            if stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        let pack = PackOptions { progress: Some(progress.clone()), ..PackOptions::default() };
        let packed = PackedGrid::with_options(&tree, PackKind::Fog, &pack);
        let level = LevelOptions { progress: Some(progress), ..LevelOptions::default() };
        let coarser = half_resolution(&tree, Coarsening::Fog, &level);
        if stop_after == u64::MAX {
            assert!(packed.is_ok() && coarser.is_ok());
        } else {
            assert_eq!(packed.err(), Some(PackError::Cancelled));
            assert!(matches!(coarser, Err(Error::Cancelled { .. })));
        }
    }
    assert!(last.load(Ordering::Relaxed) > 10);
}

#[test]
fn progress_runs_from_zero_to_a_total_that_stays() {
    use std::ops::ControlFlow;
    use std::sync::{Arc, Mutex};
    let trees = [Vdb543::new(0.0), leaves(1000, 16), upper_nodes(3), root_tiles(9, IVec3::splat)];
    for (i, tree) in trees.iter().enumerate() {
        let reports: Arc<Mutex<Vec<(u64, u64)>>> = Arc::default();
        let seen = reports.clone();
        let progress: Arc<vdb_core::ProgressFn> = Arc::new(move |done, all| {
            seen.lock().unwrap().push((done, all));
            ControlFlow::Continue(())
        });
        let check = |what: &str| {
            let reports = std::mem::take(&mut *reports.lock().unwrap());
            let all = reports[0].1;
            assert!(
                reports.iter().all(|report| report.1 == all),
                "{what} of tree {i}: {reports:?}"
            );
            assert!(reports.is_sorted(), "{what} of tree {i} goes back: {reports:?}");
            assert_eq!(reports.first().map(|report| report.0), Some(0), "{what} of tree {i}");
            assert_eq!(reports.last().map(|report| report.0), Some(all), "{what} of tree {i}");
            let largest = reports.windows(2).map(|two| two[1].0 - two[0].0).max();
            // No value lies below the iso-value of surfaces: they have no samples to gather.
            let has_all_stages = i == 1 && !what.starts_with("S");
            assert!(!has_all_stages || largest < Some(all / 2), "{what} jumps: {reports:?}");
        };
        for kind in KINDS {
            let progress = Some(progress.clone());
            let options = PackOptions { progress, ..PackOptions::default() };
            PackedGrid::with_options(tree, kind, &options).unwrap();
            check(&format!("{kind:?}"));
        }
        if i < 2 {
            let options = LevelOptions { progress: Some(progress.clone()), ..Default::default() };
            half_resolution(tree, Coarsening::Fog, &options).unwrap();
            if i == 1 {
                check("a level");
            }
        }
    }
}

#[test]
fn limits_of_files_are_those_of_reading() {
    // What is read is read within the same limits.
    let mut options = ReadOptions::default();
    options.limits.nodes = 2;
    let bytes = std::fs::read("tests/data/hostile/roottiles_fog_100.vdb").unwrap();
    assert!(matches!(VdbFile::read(&bytes, &options), Err(Error::LimitExceeded { .. })));
}
