//! What the levels of detail of a grid cost to make: `cargo bench -p vdb_core --bench levels [-- FILE.vdb …]`

use std::error::Error;
use std::time::Instant;

use glam::DVec3;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{
    Coarsening, IVec3, LevelOptions, Vdb543, half_resolution, voxel_in_distances,
};
use vdb_core::{AnyTree, GridClass, VdbFile};

/// A grid whose longest edge has fewer cells than twice this is not made coarser still.
const SMALLEST: u64 = 16;
/// Runs, of which the fastest counts.
const RUNS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    println!("{} threads; the fastest of {RUNS} runs.", rayon::current_num_threads());
    println!("| grid | level | made, ms | packed, ms | tree, MB | packed, MB |");
    println!("|---|---|---|---|---|---|");
    // `cargo bench` adds an option of its own.
    let files: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let smooth = PackKind::Smooth { iso: 0.0 };
    if files.is_empty() {
        let ball = level_set::sphere(DVec3::ZERO, 250.0);
        measure("ball, 500 voxels across", &ball, smooth, true)?;
        let gyroid = level_set::gyroid(DVec3::ZERO, 128.0, 24.0);
        measure("gyroid in a ball, 256 across", &gyroid, smooth, true)?;
        measure("cloud, 256 across", &fog::cloud(128.0, 1), PackKind::Fog, false)?;
    }
    measure("three tiles of 128³, no leaf", &tiles(), PackKind::Fog, false)?;
    for file in files {
        for grid in VdbFile::open(&file)?.grids {
            let AnyTree::Float(tree) = &grid.tree else { continue };
            let kind = match PackKind::suited(grid.class, tree) {
                PackKind::Surface { iso } => PackKind::Smooth { iso },
                kind => kind,
            };
            let name = format!("{file} {}", grid.name);
            measure(&name, tree, kind, grid.class == GridClass::LevelSet)?;
        }
    }
    Ok(())
}

/// Fog that is all tiles: a few kilobytes as a file.
fn tiles() -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.0);
    for (i, density) in [0.5, 1.0, 2.0].into_iter().enumerate() {
        for leaf in 0..4096 {
            let at = IVec3::new(leaf >> 8, leaf >> 4 & 15, leaf & 15) * 8;
            tree.fill_leaf(at + IVec3::splat(128 * i as i32), density, true);
        }
    }
    tree.prune();
    tree
}

/// The fastest run in milliseconds, and its outcome.
fn fastest<T, E>(run: impl Fn() -> Result<T, E>) -> Result<(f64, T), E> {
    let mut fastest = f64::INFINITY;
    let mut outcome = None;
    for _ in 0..RUNS {
        let start = Instant::now();
        outcome = Some(run()?);
        fastest = fastest.min(1e3 * start.elapsed().as_secs_f64());
    }
    Ok((fastest, outcome.expect("there are runs")))
}

/// Measures the levels as `bevy_vdb` makes them. Level 0 is the grid itself.
fn measure(
    name: &str,
    tree: &Vdb543<f32>,
    kind: PackKind,
    is_distance: bool,
) -> Result<(), Box<dyn Error>> {
    let (mut finer, mut made_ms) = (tree.clone(), 0.0);
    for level in 0.. {
        let (packed_ms, packed) = fastest(|| PackedGrid::new(&finer, kind))?;
        println!(
            "| {name} | {level} | {made_ms:.1} | {packed_ms:.1} | {:.2} | {:.2} |",
            finer.stats().bytes as f64 / 1e6,
            packed.bytes() as f64 / 1e6,
        );
        let cells = packed.occupied.and_then(|cells| cells.dim().into_iter().max()).unwrap_or(0);
        if cells < 2 * SMALLEST {
            break;
        }
        let half = || {
            let coarsening = match kind {
                PackKind::Fog => Coarsening::Fog,
                PackKind::Surface { iso } | PackKind::Smooth { iso } => {
                    let voxel = if is_distance { voxel_in_distances(&finer) } else { None };
                    Coarsening::Surface { iso, voxel }
                }
            };
            half_resolution(&finer, coarsening, &LevelOptions::default())
        };
        (made_ms, finer) = fastest(half)?;
    }
    Ok(())
}
