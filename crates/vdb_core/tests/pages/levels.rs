//! Coarser levels, and sources other than trees.

use glam::{DAffine3, DVec3, IVec3};
use vdb_core::pages::{FunctionSource, PageIndex, PageSource, TreeSource, cook_pages};
use vdb_core::pages::{PageOptions, PagesError};
use vdb_core::query::IndexRay;
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tree::CoordBox;
use vdb_core::{AnyTree, Grid, GridClass, Limits, Metadata};

use super::{Pages, random_ray, source};

const RADIUS: f64 = 240.0;
const CENTER: DVec3 = DVec3::new(5.3, -7.1, 3.9);

fn distance(p: DVec3) -> f64 {
    p.distance(CENTER) - RADIUS
}

/// The bounds of a ball, on whole samples.
const REACH: i32 = 260;

fn function() -> FunctionSource<fn(DVec3) -> f64> {
    let reach = DVec3::splat(REACH.into());
    FunctionSource::new("surface", DAffine3::IDENTITY, [-reach, reach], distance)
}

/// A ray in index space of a level; `t` stays the same.
fn in_level(index: &PageIndex, level: u32, ray: &IndexRay) -> IndexRay {
    let level_from_index = index.world_from_level(level).inverse() * index.world_from_index;
    IndexRay {
        origin: level_from_index.transform_point3(ray.origin),
        dir: level_from_index.transform_vector3(ray.dir),
        t_max: ray.t_max,
    }
}

#[test]
fn coarse_levels_are_as_near_as_promised() {
    for smooth in [false, true] {
        let pages = Pages::cook(&function(), smooth);
        assert!(pages.index.levels > 1);
        let mut random = Random::new(3);
        for level in 0..pages.index.levels {
            let mut hits = 0;
            let voxel = f64::from(1 << level);
            // A voxel at a corner is farther away than along an axis.
            let bound = if smooth { 0.1 * voxel } else { 3.0_f64.sqrt() * voxel };
            for _ in 0..2000 {
                let ray = random_ray(&mut random, DVec3::splat(RADIUS));
                let towards = ray.origin + (CENTER - ray.origin).dot(ray.dir).max(0.0) * ray.dir;
                let found = pages.first_hit(level, &in_level(&pages.index, level, &ray));
                if distance(ray.origin) > 0.0 {
                    assert!(found.is_some() || distance(towards) > -bound, "{level}, {ray:?}");
                }
                let Some((_, hit)) = found.filter(|(_, hit)| !hit.begins_inside) else { continue };
                hits += 1;
                let off = distance(ray.at(hit.t)).abs();
                assert!(off <= bound, "level {level}: {off} at {ray:?}");
            }
            assert!(hits > 500, "{hits} hits of level {level}");
        }
    }
}

#[test]
fn voxels_of_all_levels_share_their_planes() {
    let (low, high) = (DVec3::new(-512.5, -512.5, -0.5), DVec3::new(511.5, 511.5, 15.5));
    let tree = level_set::cuboid(low, high);
    let pages = Pages::of_tree(&tree, false);
    assert_eq!(pages.index.levels, 3);
    for level in 0..3 {
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut dir = DVec3::ZERO;
                dir[axis] = sign;
                let middle = (low + high) / 2.0 + 0.25;
                let ray = IndexRay { origin: middle - 2000.0 * dir, dir, t_max: f64::INFINITY };
                let (_, hit) =
                    pages.first_hit(level, &in_level(&pages.index, level, &ray)).unwrap();
                let face = if sign > 0.0 { low[axis] } else { high[axis] };
                let found = ray.at(hit.t)[axis];
                assert!((found - face).abs() < 1e-3, "level {level}, {dir}: {found}, not {face}");
            }
        }
    }
}

#[test]
fn a_page_lies_in_its_bounds_which_are_those_of_its_children() {
    for smooth in [false, true] {
        let pages = Pages::cook(&function(), smooth);
        let index = &pages.index;
        for (id, grid) in &pages.grids {
            let (low, high) = index.index_bounds(*id);
            let met = grid.occupied.unwrap();
            let origin = grid.kind.lattice_origin() + grid.base.as_dvec3();
            let place = index.world_from_level(id.level);
            let own_low = place.transform_point3(met.min.as_dvec3() + origin);
            let own_high = place.transform_point3(met.max.as_dvec3() + 1.0 + origin);
            assert!(low.cmple(own_low).all() && own_high.cmple(high).all(), "{id:?}");
            if id.level > 0 {
                let children = id.children().map(|child| index.index_bounds(child));
                let all = children.iter().fold(children[0], |a, b| (a.0.min(b.0), a.1.max(b.1)));
                assert_eq!(all, (low, high));
                assert!(id.children().iter().all(|child| child.parent() == *id));
            }
        }
    }
}

#[test]
#[ignore = "slow: cooks a surface twice"]
fn a_function_has_the_pages_of_the_tree_of_the_same_function() {
    let bounds = CoordBox { min: IVec3::splat(-REACH), max: IVec3::splat(REACH) };
    let tree = level_set::from_distance(bounds, distance);
    let (by_function, by_tree) = (Pages::cook(&function(), false), Pages::of_tree(&tree, false));
    assert_eq!(by_function.index, by_tree.index);
    for (id, grid) in &by_function.grids {
        assert_eq!(grid.words, by_tree.grids[id].words, "{id:?}");
    }
    let (by_function, by_tree) = (Pages::cook(&function(), true), Pages::of_tree(&tree, true));
    assert!(by_function.index.pages.keys().eq(by_tree.index.pages.keys()));
    for (id, grid) in by_function.grids.iter().filter(|(id, _)| id.level == 0) {
        assert_eq!(grid.words, by_tree.grids[id].words, "{id:?}");
    }
}

#[test]
fn what_vanishes_from_a_coarse_level_is_still_found_from_the_roots() {
    // Balls around single samples with odd coordinates.
    let count = 20.0;
    let balls = move |p: DVec3| {
        let nearest = (p.x / 1001.0).round().clamp(0.0, count - 1.0);
        p.distance(DVec3::new(nearest * 1001.0 + nearest % 2.0, 1.0, 1.0) + DVec3::X) - 0.6
    };
    let bounds = [DVec3::splat(-4.0), DVec3::new(count * 1001.0, 4.0, 4.0)];
    let pages =
        Pages::cook(&FunctionSource::new("balls", DAffine3::IDENTITY, bounds, balls), false);
    let index = &pages.index;
    let empty = index.pages.iter().filter(|(_, page)| page.packed_bytes == 0).count();
    assert!(index.levels > 2 && empty > 0, "{} levels, {empty} empty", index.levels);
    assert!(index.roots().count() <= 8);
    let (mut open, mut found): (Vec<_>, _) = (index.roots().collect(), 0);
    while let Some(id) = open.pop() {
        found += usize::from(id.level == 0);
        open.extend(index.children(id));
    }
    assert_eq!(found, 20);
    assert_eq!(PageIndex::read(&index.write(), &Limits::default()).as_ref(), Ok(index));
}

fn of_grid(change: impl Fn(&mut Grid)) -> Result<TreeSource, PagesError> {
    let tree = level_set::sphere(DVec3::ZERO, 9.0);
    let mut grid = Grid::new("thing", AnyTree::Float(tree.into()));
    grid.metadata = Metadata::default();
    grid.class = GridClass::LevelSet;
    change(&mut grid);
    TreeSource::new(&grid, Limits::default())
}

#[test]
fn what_is_no_surface_is_refused() {
    assert!(of_grid(|_| {}).is_ok());
    let fog = of_grid(|grid| {
        grid.class = GridClass::FogVolume;
        grid.tree = AnyTree::Float(fog::sphere(DVec3::ZERO, 9.0, 3.0).into());
    });
    let message = fog.err().unwrap().to_string();
    assert!(
        message.contains("\"thing\"") && message.contains("pages are for surfaces"),
        "{message}"
    );
    let inverted = of_grid(|grid| {
        grid.tree = AnyTree::Float(vdb_core::tree::Vdb543::new(-1.0).into());
    });
    assert!(matches!(inverted, Err(PagesError::Unbounded { .. })));
    let empty = of_grid(|grid| {
        grid.tree = AnyTree::Float(vdb_core::tree::Vdb543::new(1.0).into());
    });
    let cook = |source: &dyn Fn(&PageOptions) -> Result<PageIndex, PagesError>, edge| {
        source(&PageOptions { edge, ..PageOptions::default() })
    };
    let (empty, sphere) = (empty.ok().unwrap(), of_grid(|_| {}).ok().unwrap());
    let none = cook(&|options| cook_pages(&empty, options, &|_, _| Ok(())), 128);
    assert!(matches!(none, Err(PagesError::Nothing { .. })));
    for (edge, is_sound) in [(0, false), (127, false), (128, true), (200, false), (1152, false)] {
        let made = cook(&|options| cook_pages(&sphere, options, &|_, _| Ok(())), edge);
        assert_eq!(made.is_ok(), is_sound, "{edge}");
    }
    assert_eq!(sphere.name(), "thing");
}

#[test]
fn cooking_stops_when_asked_and_when_a_page_cannot_be_stored() {
    use std::ops::ControlFlow;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};
    let tree = level_set::from_distance(
        CoordBox { min: IVec3::splat(-REACH), max: IVec3::splat(REACH) },
        distance,
    );
    let full = |_, _: &[u8]| Err(std::io::Error::other("the disk is full"));
    let error = cook_pages(&source(&tree), &PageOptions::default(), &full).unwrap_err();
    assert!(error.to_string().contains("the disk is full"), "{error}");
    let last = Arc::new(AtomicU64::new(0));
    let seen = last.clone();
    let options = |stop: bool| PageOptions {
        edge: 128,
        progress: Some(Arc::new({
            let seen = seen.clone();
            move |done, all| {
                assert!(done <= all && done >= seen.swap(done, Ordering::Relaxed));
                if stop && done > 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            }
        })),
        ..PageOptions::default()
    };
    let stopped = cook_pages(&source(&tree), &options(true), &|_, _| Ok(()));
    assert!(matches!(stopped, Err(PagesError::Cancelled)));
    last.store(0, Ordering::Relaxed);
    let index = cook_pages(&source(&tree), &options(false), &|_, _| Ok(())).unwrap();
    assert!(last.load(Ordering::Relaxed) >= index.pages.len() as u64 / 2);
}

/// Prints time, size and peak memory; of 2048³ samples in pages of 256³ with `GYROID=2048 EDGE=256`, and of
/// a smooth surface with `SMOOTH=1`.
#[test]
#[ignore = "slow: a gyroid of 768³ samples"]
fn a_gyroid_that_is_never_in_memory() {
    let number = |name: &str, default: u32| {
        std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
    };
    let (size, edge) = (number("GYROID", 768), number("EDGE", 128));
    let scale = 256.0 / std::f64::consts::TAU;
    let gyroid = move |p: DVec3| {
        let q = p / scale;
        let value = q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos();
        value * scale / 3.0_f64.sqrt()
    };
    let bounds = [DVec3::ZERO, DVec3::splat(f64::from(size) - 1.0)];
    let source = FunctionSource::new("gyroid", DAffine3::IDENTITY, bounds, gyroid);
    let begin = std::time::Instant::now();
    let options = PageOptions { edge, smooth: number("SMOOTH", 0) == 1, ..PageOptions::default() };
    let index = cook_pages(&source, &options, &|_, _| Ok(())).unwrap();
    for level in 0..index.levels {
        let pages = index.pages.iter().filter(|(id, _)| id.level == level);
        let sums = pages.fold([0; 3], |[count, file, packed], (_, page)| {
            [count + 1, file + page.file_bytes, packed + page.packed_bytes]
        });
        println!("level {level}: pages, bytes of files, bytes on the GPU: {sums:?}");
        assert!(sums[0] <= (size.div_ceil(edge << level) as u64 + 1).pow(3));
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or_default();
    println!("{:.1?}, {peak}", begin.elapsed());
    let largest = index.pages.values().map(|page| page.packed_bytes).max();
    assert!(index.roots().count() <= 8 && largest.is_some_and(|bytes| bytes < 64 << 20));
}
