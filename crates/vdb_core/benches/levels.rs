//! Making the levels of detail of a grid: `cargo bench -p vdb_core --bench levels [-- FILE.vdb …]`
//!
//! Times of packing a grid, and of making and packing all its coarser levels. Beside these it prints the
//! memory that the levels take.

mod grids;

use std::sync::LazyLock;

use divan::Bencher;
use glam::DVec3;
use grids::{BenchGrid, Shown};
use vdb_core::GridClass;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{Coarsening, LevelOptions, Vdb543, half_resolution, voxel_in_distances};

/// Longest edge, in cells, of the smallest grid that is made coarser still, halved.
const SMALLEST: i32 = 16;

static GRIDS: LazyLock<Vec<BenchGrid>> = LazyLock::new(|| {
    let grid = |name: &str, class, tree: Vdb543<f32>| BenchGrid {
        name: name.into(),
        class,
        tree: tree.into(),
    };
    grids::grids(|| {
        vec![
            grid(
                "ball, 500 voxels across",
                GridClass::LevelSet,
                level_set::sphere(DVec3::ZERO, 250.0),
            ),
            grid(
                "gyroid in a ball, 256 across",
                GridClass::LevelSet,
                level_set::gyroid(DVec3::ZERO, 128.0, 24.0),
            ),
            grid("cloud, 256 across", GridClass::FogVolume, fog::cloud(128.0, 1)),
        ]
    })
});

fn main() {
    println!("{} threads", rayon::current_num_threads());
    grids::run();
    println!("\n| grid | active voxels | packed, MB | levels | memory of the levels |");
    println!("|---|---|---|---|---|");
    for shown in shown() {
        let packed = pack(&shown.grid.tree, shown.kind);
        let levels = levels(shown, &packed);
        let bytes = |packed: &PackedGrid| 4.0 * packed.words.len() as f64;
        println!(
            "| {shown} | {} | {:.1} | {} | {:.0} % |",
            shown.grid.tree.active_voxel_count(),
            bytes(&packed) / 1e6,
            levels.len(),
            100.0 * levels.iter().map(bytes).sum::<f64>() / bytes(&packed)
        );
    }
}

/// The grids as `bevy_vdb` shows them unless it is asked for voxels.
fn shown() -> Vec<Shown> {
    let mut shown = grids::shown(&GRIDS);
    shown.retain(|shown| !matches!(shown.kind, PackKind::Surface { .. }));
    shown
}

#[divan::bench(args = shown(), sample_count = 5, sample_size = 1)]
fn pack_grid(shown: Shown) -> PackedGrid {
    pack(&shown.grid.tree, shown.kind)
}

#[divan::bench(args = shown(), sample_count = 3, sample_size = 1)]
fn make_levels(bencher: Bencher, shown: Shown) {
    let packed = pack(&shown.grid.tree, shown.kind);
    bencher.bench_local(|| levels(shown, &packed));
}

fn pack(tree: &Vdb543<f32>, kind: PackKind) -> PackedGrid {
    PackedGrid::new(tree, kind).expect("the grid can be packed")
}

/// All coarser levels, as `bevy_vdb` makes them.
fn levels(shown: Shown, packed: &PackedGrid) -> Vec<PackedGrid> {
    let (mut coarser, mut levels): (Option<Vdb543<f32>>, Vec<PackedGrid>) = (None, Vec::new());
    loop {
        let finer = levels.last().unwrap_or(packed);
        let cells = finer.occupied.map_or(0, |cells| (cells.max - cells.min).max_element());
        if cells < 2 * SMALLEST {
            return levels;
        }
        let from = coarser.as_ref().unwrap_or(&shown.grid.tree);
        let coarsening = match shown.kind {
            PackKind::Fog => Coarsening::Fog,
            PackKind::Surface { iso } | PackKind::Smooth { iso } => {
                let is_distance = shown.grid.class == GridClass::LevelSet;
                Coarsening::Surface { iso, voxel: voxel_in_distances(from).filter(|_| is_distance) }
            }
        };
        let half = half_resolution(from, coarsening, &LevelOptions::default())
            .expect("the grid can be made coarser");
        levels.push(pack(&half, shown.kind));
        coarser = Some(half);
    }
}
