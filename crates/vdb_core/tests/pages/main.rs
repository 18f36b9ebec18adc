//! Pages: together they are the grid that they were cut from.

mod hostile;
mod index;
mod levels;
mod resumed;
mod streamed;
mod union;

use std::collections::BTreeMap;
use std::sync::Mutex;

use glam::{DVec3, IVec3};
use vdb_core::cooked::CookedFile;
use vdb_core::pack::{PackedGrid, ValueFormat};
use vdb_core::pages::{PageId, PageIndex, PageOptions, PageSource, TreeSource, cook_pages};
use vdb_core::query::{GridQuery, IndexHit, IndexRay};
use vdb_core::synth::{Random, level_set};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass, Limits, ReadOptions};

/// Pages in memory, as their files have them.
struct Pages {
    index: PageIndex,
    grids: BTreeMap<PageId, PackedGrid>,
}

impl Pages {
    fn cook(source: &impl PageSource, smooth: bool) -> Self {
        let options =
            PageOptions { edge: 128, smooth, format: ValueFormat::Exact, ..Default::default() };
        let grids = Mutex::new(BTreeMap::new());
        let index = cook_pages(source, &options, &|id, bytes| {
            let file = CookedFile::read(bytes, &ReadOptions::default()).unwrap();
            let [grid] = <[_; 1]>::try_from(file.grids).unwrap();
            assert_eq!(grid.name, source.name());
            grids.lock().unwrap().insert(id, (grid, bytes.len() as u64));
            Ok(())
        });
        let index = index.unwrap();
        let grids = grids.into_inner().unwrap();
        for (id, (grid, length)) in &grids {
            let entry = &index.pages[id];
            assert_eq!((entry.packed_bytes, entry.file_bytes), (grid.packed.bytes(), *length));
            let stored = grid.transform.linear().unwrap();
            assert!(stored.abs_diff_eq(index.world_from_level(id.level), 1e-12));
        }
        let with_file = index.pages.iter().filter(|(_, entry)| entry.file_bytes > 0).count();
        assert_eq!(with_file, grids.len());
        let grids = grids.into_iter().map(|(id, (grid, _))| (id, grid.packed)).collect();
        Self { index, grids }
    }

    fn of_tree(tree: &Vdb543<f32>, smooth: bool) -> Self {
        Self::cook(&source(tree), smooth)
    }

    /// The first hit of a ray in index space of a level, and the page that it is in.
    fn first_hit(&self, level: u32, ray: &IndexRay) -> Option<(PageId, IndexHit)> {
        let pages = self.grids.iter().filter(|(id, _)| id.level == level);
        let hits = pages
            .filter_map(|(id, grid)| Some((*id, GridQuery::of_packed(grid).first_hit(ray, 0.0)?)));
        hits.min_by(|a, b| a.1.t.total_cmp(&b.1.t))
    }
}

fn source(tree: &Vdb543<f32>) -> TreeSource {
    let mut grid = Grid::new("surface", AnyTree::Float(tree.clone().into()));
    grid.class = GridClass::LevelSet;
    TreeSource::new(&grid, Limits::default()).unwrap()
}

/// The cells of a page in the lattice of its level.
fn cells(index: &PageIndex, id: PageId) -> CoordBox {
    let min = id.at * index.edge as i32;
    CoordBox { min, max: min + index.edge as i32 - 1 }
}

/// A ray towards a point of a box, from outside or from inside of it.
fn random_ray(random: &mut Random, half: DVec3) -> IndexRay {
    let mut in_box =
        |reach: f64| half * reach * DVec3::from_array([0; 3].map(|_| 2.0 * random.unit() - 1.0));
    let (origin, target) = (in_box(1.6), in_box(1.0));
    IndexRay { origin, dir: (target - origin).normalize(), t_max: f64::INFINITY }
}

/// Shapes that cross the borders of pages of 128 cells, with the half of their boxes.
fn shapes() -> [(&'static str, DVec3, Vdb543<f32>); 3] {
    let tree = |half: DVec3, distance: &(dyn Fn(DVec3) -> f64 + Sync)| {
        let reach = half.ceil().as_ivec3() + 8;
        level_set::from_distance(CoordBox { min: -reach, max: reach }, distance)
    };
    let in_box = |p: DVec3, half: DVec3| (p.abs() - half).max_element();
    let center = DVec3::new(5.3, -7.1, 3.9);
    let ball = DVec3::splat(165.0);
    // No whole numbers: rays along samples of exactly 0 may hit or miss.
    let slab = DVec3::new(150.3, 150.6, 20.4);
    let gyroid = move |p: DVec3| {
        let q = p / 9.0;
        let value = q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos();
        (value.abs() * 9.0 - 3.0) / 3.0_f64.sqrt()
    };
    let sheet = DVec3::new(200.4, 200.7, 6.3);
    let normal = DVec3::new(0.01, 0.02, 1.0).normalize();
    [
        ("sphere", ball, tree(ball, &|p| p.distance(center) - 150.0)),
        ("gyroid", slab, tree(slab, &|p| gyroid(p).max(in_box(p, slab)))),
        (
            "sheet",
            sheet,
            tree(sheet, &|p| ((p.dot(normal) - 0.3).abs() - 0.8).max(in_box(p, sheet))),
        ),
    ]
}

fn floor(point: DVec3) -> IVec3 {
    point.floor().as_ivec3()
}
