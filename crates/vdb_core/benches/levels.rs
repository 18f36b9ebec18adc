//! What the levels of detail of a grid cost in the making: `cargo bench -p vdb_core --bench levels [-- FILE.vdb …]`

use std::error::Error;
use std::time::Instant;

use glam::DVec3;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{Coarsening, LevelOptions, Vdb543, half_resolution, voxel_in_distances};
use vdb_core::{AnyTree, GridClass, VdbFile};

/// Of its longest edge, in cells: a grid that is smaller is not made coarser still.
const SMALLEST: i32 = 16;

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "{} threads; seconds to pack a grid, and to make and pack all its coarser levels; what these take \
         of the grid's packed bytes.",
        rayon::current_num_threads()
    );
    println!(
        "| grid | active voxels | packed, MB | packing, s | levels | in the making, s | memory |"
    );
    println!("|---|---|---|---|---|---|---|");
    let smooth = PackKind::Smooth { iso: 0.0 };
    let ball = level_set::sphere(DVec3::ZERO, 250.0);
    measure("ball, 500 voxels across", &ball, smooth, true)?;
    let gyroid = level_set::gyroid(DVec3::ZERO, 128.0, 24.0);
    measure("gyroid in a ball, 256 across", &gyroid, smooth, true)?;
    measure("cloud, 256 across", &fog::cloud(128.0, 1), PackKind::Fog, false)?;
    // `cargo bench` adds an option of its own.
    for file in std::env::args().skip(1).filter(|a| a != "--bench") {
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

/// As `bevy_vdb` makes them.
fn measure(
    name: &str,
    tree: &Vdb543<f32>,
    kind: PackKind,
    is_distance: bool,
) -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    let packed = PackedGrid::new(tree, kind)?;
    let packing = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let (mut coarser, mut levels): (Option<Vdb543<f32>>, Vec<PackedGrid>) = (None, Vec::new());
    loop {
        let finer = levels.last().unwrap_or(&packed);
        let cells = finer.occupied.map_or(0, |cells| (cells.max - cells.min).max_element());
        if cells < 2 * SMALLEST {
            break;
        }
        let from = coarser.as_ref().unwrap_or(tree);
        let coarsening = match kind {
            PackKind::Fog => Coarsening::Fog,
            PackKind::Surface { iso } | PackKind::Smooth { iso } => {
                let voxel = if is_distance { voxel_in_distances(from) } else { None };
                Coarsening::Surface { iso, voxel }
            }
        };
        let half = half_resolution(from, coarsening, &LevelOptions::default())?;
        levels.push(PackedGrid::new(&half, kind)?);
        coarser = Some(half);
    }
    let making = start.elapsed().as_secs_f64();
    let bytes = |packed: &PackedGrid| 4.0 * packed.words.len() as f64;
    let (own, all) = (bytes(&packed), levels.iter().map(bytes).sum::<f64>());
    println!(
        "| {name} | {} | {:.1} | {packing:.2} | {} | {making:.2} | {:.0} % |",
        tree.active_voxel_count(),
        own / 1e6,
        levels.len(),
        100.0 * all / own
    );
    Ok(())
}
