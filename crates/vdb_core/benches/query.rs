//! Rays on one core: `cargo bench -p vdb_core --bench query [-- FILE.vdb …]`
//!
//! Rays of a view row by row, and rays from all around at random, as rays per second. Beside these it
//! prints the part of them that hits. Without files it takes the bundled models.

mod grids;

use std::sync::LazyLock;

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::DVec3;
use grids::{BenchGrid, Shown};
use vdb_core::pack::PackedGrid;
use vdb_core::query::{GridQuery, IndexRay};
use vdb_core::synth::Random;
use vdb_core::tree::CoordBox;

/// Rays of each kind.
const RAYS: usize = 1 << 18;
/// Times that they are cast.
const ROUNDS: u32 = 5;

static GRIDS: LazyLock<Vec<BenchGrid>> = LazyLock::new(|| {
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/models");
    grids::grids(|| {
        let read = |name| grids::read(&format!("{models}/{name}.vdb"));
        ["teapot", "cloud"].into_iter().flat_map(read).collect()
    })
});

fn main() {
    grids::run();
    println!("\n| grid | view hits | random hits |\n|---|---|---|");
    for shown in grids::shown(&GRIDS) {
        let (packed, cells) = packed(shown);
        let hits = |rays: &[IndexRay]| {
            100.0 * count_hits(&shown, &packed, rays, cells) as f64 / rays.len() as f64
        };
        println!("| {shown} | {:.0} % | {:.0} % |", hits(&view(cells)), hits(&random(cells)));
    }
}

#[divan::bench(args = grids::shown(&GRIDS), sample_count = ROUNDS, sample_size = 1)]
fn view_rays(bencher: Bencher, shown: Shown) {
    cast(bencher, shown, view);
}

#[divan::bench(args = grids::shown(&GRIDS), sample_count = ROUNDS, sample_size = 1)]
fn random_rays(bencher: Bencher, shown: Shown) {
    cast(bencher, shown, random);
}

fn cast(bencher: Bencher, shown: Shown, rays: fn(CoordBox) -> Vec<IndexRay>) {
    let (packed, cells) = packed(shown);
    let rays = rays(cells);
    bencher
        .counter(ItemsCount::of_iter(&rays))
        .bench_local(|| count_hits(&shown, &packed, &rays, cells));
}

/// The grid packed, and its cells in index space.
fn packed(shown: Shown) -> (PackedGrid, CoordBox) {
    let packed = PackedGrid::new(&shown.grid.tree, shown.kind).expect("the grid can be packed");
    let cells = packed.occupied.expect("the grid is not empty");
    let cells = CoordBox { min: cells.min + packed.base, max: cells.max + packed.base };
    (packed, cells)
}

fn count_hits(shown: &Shown, packed: &PackedGrid, rays: &[IndexRay], cells: CoordBox) -> usize {
    let query = GridQuery::new(&shown.grid.tree, packed);
    // For fog, the optical depth at which half the light would be gone after a tenth of the box's least
    // edge at half density.
    let enough = 0.1 * size(cells).min_element() * 0.5;
    rays.iter().filter(|ray| query.first_hit(ray, enough).is_some()).count()
}

fn size(cells: CoordBox) -> DVec3 {
    (cells.max - cells.min).as_dvec3()
}

fn towards(origin: DVec3, target: DVec3) -> IndexRay {
    IndexRay { origin, dir: (target - origin).normalize(), t_max: f64::INFINITY }
}

/// The rays of a square picture, from a corner of the box's diagonal.
fn view(cells: CoordBox) -> Vec<IndexRay> {
    let (low, size) = (cells.min.as_dvec3(), size(cells));
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
fn random(cells: CoordBox) -> Vec<IndexRay> {
    let (low, size) = (cells.min.as_dvec3(), size(cells));
    let mut random = Random::new(1);
    let mut point = || DVec3::new(random.unit(), random.unit(), random.unit());
    (0..RAYS)
        .map(|_| {
            let side = (2.0 * point() - 1.0).normalize();
            towards(low + 0.5 * size + size.length() * side, low + point() * size)
        })
        .collect()
}
