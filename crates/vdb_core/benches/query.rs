//! Rays that one core casts in a second: `cargo bench -p vdb_core --bench query -- FILE.vdb …`

use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use glam::DVec3;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::query::{GridQuery, IndexRay};
use vdb_core::synth::Random;
use vdb_core::{AnyTree, GridClass, VdbFile};

/// Rays of each kind.
const RAYS: usize = 1 << 18;
/// Times that they are cast; the fastest counts.
const ROUNDS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    // `cargo bench` adds an option of its own.
    let files: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if files.is_empty() {
        println!("nothing measured; cargo bench -p vdb_core --bench query -- FILE.vdb …");
        return Ok(());
    }
    println!(
        "Million rays a second, one core; of a view row by row, and from all around at random."
    );
    println!("| grid | shown as | view | met | random | met |");
    println!("|---|---|---|---|---|---|");
    for file in &files {
        for grid in VdbFile::open(file)?.grids {
            let AnyTree::Float(tree) = &grid.tree else { continue };
            let kinds = match grid.class {
                GridClass::LevelSet => {
                    &[PackKind::Surface { iso: 0.0 }, PackKind::Smooth { iso: 0.0 }][..]
                }
                _ => &[PackKind::Fog],
            };
            for &kind in kinds {
                let packed = PackedGrid::new(tree, kind)?;
                let Some(cells) = packed.occupied else { continue };
                let low = (cells.min + packed.base).as_dvec3();
                let size = (cells.max - cells.min).as_dvec3();
                let query = GridQuery::new(tree, &packed);
                let (view, random) = (view(low, size), random(low, size));
                let (seen, met) = (measure(&query, &view, size), measure(&query, &random, size));
                println!(
                    "| {} | {} | {:.2} | {:.0} % | {:.2} | {:.0} % |",
                    Path::new(file).file_stem().unwrap_or_default().to_string_lossy(),
                    match kind {
                        PackKind::Surface { .. } => "voxels",
                        PackKind::Smooth { .. } => "smooth surface",
                        PackKind::Fog => "fog",
                    },
                    seen.0 / 1e6,
                    100.0 * seen.1,
                    met.0 / 1e6,
                    100.0 * met.1,
                );
            }
        }
    }
    Ok(())
}

fn towards(origin: DVec3, target: DVec3) -> IndexRay {
    IndexRay { origin, dir: (target - origin).normalize(), t_max: f64::INFINITY }
}

/// The rays of a square picture, from a corner of the box's diagonal.
fn view(low: DVec3, size: DVec3) -> Vec<IndexRay> {
    let edge = (RAYS as f64).sqrt();
    let (middle, radius) = (low + 0.5 * size, 0.5 * size.length());
    let back = DVec3::new(0.6, 0.5, 1.0).normalize();
    let right = DVec3::Y.cross(back).normalize();
    let up = back.cross(right);
    let eye = middle + 1.5 * radius * back;
    let pixel = |i: usize| (i as f64 + 0.5) / edge - 0.5;
    (0..RAYS)
        .map(|i| (pixel(i % edge as usize), pixel(i / edge as usize)))
        .map(|(x, y)| towards(eye, middle + 1.2 * radius * (x * right + y * up)))
        .collect()
}

/// Rays from a sphere around the box through points in it.
fn random(low: DVec3, size: DVec3) -> Vec<IndexRay> {
    let mut random = Random::new(1);
    let mut point = || DVec3::new(random.unit(), random.unit(), random.unit());
    (0..RAYS)
        .map(|_| {
            let side = (2.0 * point() - 1.0).normalize();
            towards(low + 0.5 * size + size.length() * side, low + point() * size)
        })
        .collect()
}

/// Rays a second, and the part of them that met something.
fn measure(query: &GridQuery, rays: &[IndexRay], size: DVec3) -> (f64, f64) {
    // A cloud as dense as most: half the light is gone after a tenth of its height.
    let enough = 0.1 * size.min_element() * 0.5;
    let mut best = f64::INFINITY;
    let mut met = 0;
    for _ in 0..ROUNDS {
        let start = Instant::now();
        met = black_box(rays.iter().filter(|ray| query.first_hit(ray, enough).is_some()).count());
        best = best.min(start.elapsed().as_secs_f64());
    }
    (rays.len() as f64 / best, met as f64 / rays.len() as f64)
}
