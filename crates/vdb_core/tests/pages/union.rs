//! The pages of the finest level against the whole grid.

use glam::{DVec3, IVec3};
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat};
use vdb_core::pages::PageSource;
use vdb_core::query::{GridQuery, IndexRay};
use vdb_core::synth::Random;
use vdb_core::tree::Vdb543;

use super::{Pages, cells, floor, random_ray, shapes, source};

const RAYS: usize = 4000;

#[test]
fn rays_meet_the_voxels_of_the_whole() {
    for (name, half, tree) in shapes() {
        let whole = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
        let pages = Pages::of_tree(&tree, false);
        let mut random = Random::new(11);
        let mut hits = 0;
        for _ in 0..RAYS {
            let ray = random_ray(&mut random, half);
            let expected = GridQuery::of_packed(&whole).first_hit(&ray, 0.0);
            let found = pages.first_hit(0, &ray);
            let [ijk, own] = [expected, found.map(|(_, hit)| hit)].map(|hit| hit.map(|h| h.ijk));
            assert_eq!(own, ijk, "{name}, {ray:?}");
            if let (Some(expected), Some((id, hit))) = (expected, found) {
                assert!((hit.t - expected.t).abs() < 1e-4, "{name}, {ray:?}");
                assert!(cells(&pages.index, id).contains(hit.ijk));
                hits += 1;
            }
        }
        assert!(hits > RAYS / 4, "{name}: {hits} hits");
    }
}

#[test]
fn rays_meet_the_smooth_surface_of_the_whole() {
    for (name, half, tree) in shapes() {
        let kind = PackKind::Smooth { iso: 0.0 };
        let whole = PackedGrid::with_format(&tree, kind, ValueFormat::Exact).unwrap();
        let whole = GridQuery::of_packed(&whole);
        let pages = Pages::of_tree(&tree, true);
        let mut random = Random::new(12);
        let (mut hits, mut at_borders) = (0, 0);
        for _ in 0..RAYS {
            let ray = random_ray(&mut random, half);
            let (expected, found) = (whole.first_hit(&ray, 0.0), pages.first_hit(0, &ray));
            assert_eq!(found.is_some(), expected.is_some(), "{name}, {ray:?}");
            let (Some(expected), Some((id, hit))) = (expected, found) else { continue };
            hits += 1;
            // A ray that hardly approaches the surface may meet it earlier or later.
            let (off, slope) = ((hit.t - expected.t).abs(), expected.normal.dot(ray.dir).abs());
            assert!(off < 0.1 && off * slope < 1e-5, "{name}, {ray:?}: {off}");
            let point = ray.at(hit.t);
            if (point - point.round()).abs().min_element() < 1e-3 {
                continue;
            }
            assert!(cells(&pages.index, id).contains(floor(point)), "{name}, {ray:?}");
            assert!(hit.normal.abs_diff_eq(expected.normal, 1e-3), "{name}, {ray:?}");
            // Interpolated normals look at the cells around.
            let own = GridQuery::of_packed(&pages.grids[&id]).smooth_gradient(point);
            assert_eq!(own, whole.smooth_gradient(point), "{name}, {point}");
            let page = cells(&pages.index, id);
            let is_border = |cell: IVec3| (cell - page.min).min(page.max - cell).min_element() == 0;
            at_borders += usize::from(own.is_some() && is_border(floor(point)));
        }
        assert!(hits > RAYS / 4, "{name}: {hits} hits");
        assert!(at_borders > 5, "{name}: {at_borders} gradients at borders");
    }
}

#[test]
fn a_smooth_page_has_no_cells_but_its_own_and_those_around() {
    let (_, _, tree) = &shapes()[0];
    let pages = Pages::of_tree(tree, true);
    for (id, grid) in &pages.grids {
        let own = cells(&pages.index, *id);
        let met = grid.occupied.unwrap();
        let met = [met.min + grid.base, met.max + grid.base];
        assert!(met.iter().all(|corner| own.contains(*corner)), "{id:?}: {met:?}");
    }
    // The ball goes on beyond the page: without the region, every border would be a surface, too.
    let whole: u64 =
        pages.grids.iter().filter(|(id, _)| id.level == 0).map(|(_, g)| g.bytes()).sum();
    let kind = PackKind::Smooth { iso: 0.0 };
    let packed = PackedGrid::with_format(tree, kind, ValueFormat::Exact).unwrap();
    assert!(whole < 2 * packed.bytes(), "{whole} and {}", packed.bytes());
}

#[test]
fn cells_of_tiles_around_a_page_are_not_its_own() {
    // Tiles of 8³ in the page at 0, and somewhat beyond.
    let mut tree = Vdb543::new(3.0_f32);
    let tiles = 20;
    for i in 0..tiles * tiles * tiles {
        let at = IVec3::new(i / (tiles * tiles), i / tiles % tiles, i % tiles);
        tree.fill_leaf(8 * at, -3.0, false);
    }
    let pages = Pages::of_tree(&tree, true);
    for (id, grid) in &pages.grids {
        let own = cells(&pages.index, *id);
        let met = grid.occupied.unwrap();
        let met = [met.min + grid.base, met.max + grid.base];
        assert!(met.iter().all(|corner| own.contains(*corner)), "{id:?}: {met:?}");
    }
    // The one whose cells are all inside has nothing to show; its neighbours on all sides do.
    let finest = pages.grids.keys().filter(|id| id.level == 0).count();
    assert_eq!(finest, 26);
    assert!(pages.grids.keys().all(|id| id.level > 0 || id.at != IVec3::ZERO));
}

#[test]
fn solid_tiles_are_voxels_but_no_smooth_surface() {
    let mut tree = Vdb543::new(3.0_f32);
    tree.insert_tile(IVec3::ZERO, -3.0, false);
    let source = source(&tree);
    let count = |kind| source.pages(0, 1024, kind).unwrap().len();
    // 4³ pages are solid. Of the trilinear cells, those along the faces cross the surface, and the
    // ones on the low side begin a sample before.
    assert_eq!(count(PackKind::Surface { iso: 0.0 }), 64);
    assert_eq!(count(PackKind::Smooth { iso: 0.0 }), 5_usize.pow(3) - 2_usize.pow(3));
}

#[test]
fn a_ray_from_within_a_solid_page_begins_inside() {
    let (_, _, tree) = &shapes()[0];
    let pages = Pages::of_tree(tree, false);
    let ray = IndexRay { origin: DVec3::ONE, dir: DVec3::X, t_max: 1.0 };
    let (_, hit) = pages.first_hit(0, &ray).unwrap();
    assert!(hit.begins_inside && hit.ijk == IVec3::ONE);
}
