//! Grids and rays at all extremes of index space, at random, and smaller where one fails: the walk on the
//! CPU against the reference tracer. Overflow is checked, as in all tests.

use glam::{IVec3, Vec3};
use proptest::prelude::*;
use vdb_core::pack::traverse::{self, first_hit, optical_length};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::query::{GridQuery, IndexRay};
use vdb_core::reference::{Blocky, Fog, Occupied, Ray};
use vdb_core::synth::{Random, rays};
use vdb_core::tree::{CoordBox, Vdb543};

/// A coordinate: at both ends of index space and beside them, at zero, at borders of nodes, anywhere.
fn coordinate() -> impl Strategy<Value = i32> {
    let near = |c: i32| (-9..=9_i32).prop_map(move |off| c.saturating_add(off));
    prop_oneof![
        3 => near(i32::MIN),
        3 => near(i32::MAX),
        2 => near(0),
        1 => near(4096),
        1 => near(1 << 24),
        1 => near(-(1 << 30)),
        1 => any::<i32>(),
    ]
}

fn place() -> impl Strategy<Value = IVec3> {
    [coordinate(), coordinate(), coordinate()].prop_map(IVec3::from_array)
}

/// Few voxels, far from each other or beside each other.
fn voxels() -> impl Strategy<Value = Vec<IVec3>> {
    let beside = |place: IVec3| {
        let off = [-2..=2_i32, -2..=2, -2..=2].prop_map(IVec3::from_array);
        prop::collection::vec(off, 1..4).prop_map(move |offs| {
            let at = |off: IVec3| place.saturating_add(off);
            offs.into_iter().map(at).collect::<Vec<_>>()
        })
    };
    prop::collection::vec(place().prop_flat_map(beside), 1..4).prop_map(|groups| groups.concat())
}

/// A component of a direction: none, along an axis, creeping, or any.
fn component() -> impl Strategy<Value = f32> {
    prop_oneof![
        Just(0.0),
        Just(1.0),
        Just(-1.0),
        (-40..4_i32).prop_map(|e| 2.0_f32.powi(e)),
        -1.0..1.0_f32,
        (-1.0..1.0_f32).prop_map(|c| c * 1e-7),
        Just(1e-40),
        Just(f32::MIN_POSITIVE),
    ]
}

fn fraction() -> impl Strategy<Value = f32> {
    let any = (0..1 << 24_u32).prop_map(|units| units as f32 / (1 << 24) as f32);
    prop_oneof![Just(0.0), Just(0.5), Just(1.0 - 1.0 / (1 << 24) as f32), any]
}

/// Where a ray begins, which way it goes (or at which voxel), and a seed for its ends.
#[derive(Clone, Debug)]
struct Shot {
    cell: IVec3,
    frac: Vec3,
    dir: Vec3,
    aim: Option<usize>,
    size: i32,
    seed: u64,
}

fn shot() -> impl Strategy<Value = Shot> {
    let frac = [fraction(), fraction(), fraction()].prop_map(Vec3::from_array);
    let dir = [component(), component(), component()].prop_map(Vec3::from_array);
    let aim = prop::option::weighted(0.7, 0..12_usize);
    (place(), frac, dir, aim, -29..30_i32, any::<u64>())
        .prop_map(|(cell, frac, dir, aim, size, seed)| Shot { cell, frac, dir, aim, size, seed })
}

impl Shot {
    /// The ray in local coordinates of a grid with these voxels, and the same in index space, which is
    /// `half` a voxel away; none where 32 bits do not have it.
    fn ray(&self, grid: &PackedGrid, voxels: &[IVec3]) -> Option<(traverse::Ray, Ray)> {
        let mut dir = self.dir;
        if let Some(aim) = self.aim {
            let way = voxels[aim % voxels.len()].as_dvec3() - self.cell.as_dvec3();
            dir = (way / way.abs().max_element().max(1.0)).as_vec3() + dir * 1e-7;
        }
        // Powers of two are exact.
        let dir = rays::normalized(dir)? * 2.0_f32.powi(self.size);
        let cell = self.cell.checked_sub(grid.base)?;
        let bounds = grid.occupied?;
        let ray = Ray::new(cell, self.frac, dir);
        let ray = rays::ended(&mut Random::new(self.seed), ray, bounds, 0.0);
        let local =
            traverse::Ray { cell, frac: self.frac, dir, t_min: ray.t_min, t_max: ray.t_max };
        let frac = self.frac + grid.kind.lattice_origin() as f32;
        Some((local, Ray { cell: self.cell, frac, ..ray }.flushed()))
    }
}

fn tree_of(voxels: &[IVec3], value: f32, background: f32) -> Vdb543<f32> {
    let mut tree = Vdb543::new(background);
    voxels.iter().for_each(|&voxel| tree.set(voxel, value));
    tree
}

fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(cases(1500))]

    #[test]
    fn voxels_and_faces(voxels in voxels(), shots in prop::collection::vec(shot(), 16)) {
        let tree = tree_of(&voxels, -1.0, 1.0);
        let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
        let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
        for shot in shots {
            let Some((local, exact)) = shot.ray(&grid, &voxels) else { continue };
            let hit = oracle.first_voxel(&exact);
            let expected = hit.map(|hit| (hit.ijk, hit.face.map_or(3, |face| face.axis.into())));
            let found = first_hit(&grid, &local);
            let voxel = found.map(|hit| (hit.cell.wrapping_add(grid.base), hit.axis));
            prop_assert_eq!(voxel, expected, "{:?}", local);
        }
    }

    #[test]
    fn optical_depths(voxels in voxels(), shots in prop::collection::vec(shot(), 8)) {
        let tree = tree_of(&voxels, 0.25, 0.0);
        let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let oracle = Fog::new(&tree);
        for shot in shots {
            let Some((local, exact)) = shot.ray(&grid, &voxels) else { continue };
            // In voxels, which the ray passes a few of.
            let speed = exact.dir.as_dvec3().length();
            let depth = oracle.optical_depth(&exact).value * speed;
            let found = f64::from(optical_length(&grid, &local)) * speed;
            prop_assert!((found - depth).abs() < 1e-4, "{} for {}: {:?}", found, depth, local);
        }
    }

    #[test]
    #[ignore = "slow: many random rays"]
    fn queries_end(
        voxels in voxels(),
        shots in prop::collection::vec(shot(), 8),
        t_max in prop_oneof![Just(f64::INFINITY), Just(1e10), 0.0..1e9],
    ) {
        let tree = tree_of(&voxels, -1.0, 1.0);
        let fog = tree_of(&voxels, 0.25, 0.0);
        let iso = 0.0;
        for (tree, kind) in
            [(&tree, PackKind::Surface { iso }), (&tree, PackKind::Smooth { iso }), (&fog, PackKind::Fog)]
        {
            let grid = PackedGrid::new(tree, kind).unwrap();
            let query = GridQuery::new(tree, &grid);
            for shot in &shots {
                let Some((_, exact)) = shot.ray(&grid, &voxels) else { continue };
                let (origin, dir) = (exact.at(0.0), exact.dir.as_dvec3());
                let hit = query.first_hit(&IndexRay { origin, dir, t_max }, 0.0);
                let sound = hit.is_none_or(|hit| hit.t.is_finite() && hit.t >= 0.0 && hit.t <= t_max);
                prop_assert!(sound, "{:?} of {:?}", hit, exact);
                if let (Some(hit), PackKind::Surface { .. }) = (hit, kind) {
                    prop_assert!(tree.get(hit.ijk) < iso, "{:?} of {:?}", hit, exact);
                }
            }
        }
    }
}

/// From one end of index space to the other, where a cell's number ahead of the ray takes all of 32 bits.
#[test]
fn through_all_of_index_space() {
    let (low, high) = (IVec3::splat(i32::MIN), IVec3::splat(i32::MAX));
    let tree = tree_of(&[low, high, IVec3::new(i32::MAX, i32::MIN, i32::MIN)], -1.0, 1.0);
    let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
    let bounds = grid.occupied.unwrap();
    assert_eq!(bounds, CoordBox { min: low, max: high });
    let hit = |cell: IVec3, dir: Vec3, t_min: f32| {
        let ray = traverse::Ray { cell, frac: Vec3::splat(0.5), dir, t_min, t_max: f32::INFINITY };
        first_hit(&grid, &ray).map(|hit| (hit.cell, hit.axis))
    };
    assert_eq!(hit(low, Vec3::ONE, 0.0), Some((low, 3)));
    assert_eq!(hit(low, Vec3::ONE, 1.0), Some((high, 2)));
    assert_eq!(hit(high, Vec3::NEG_ONE, 1.0), Some((low, 2)));
    assert_eq!(hit(low, Vec3::X, 1.0), Some((IVec3::new(i32::MAX, i32::MIN, i32::MIN), 0)));
    // Out of index space, having met nothing.
    assert_eq!(hit(low + IVec3::Y, Vec3::X, 0.0), None);
    assert_eq!(hit(high - IVec3::Y, Vec3::NEG_X, 0.0), None);
    let query = GridQuery::new(&tree, &grid);
    let origin = low.as_dvec3() - 5.0;
    let ray = IndexRay { origin, dir: glam::DVec3::ONE, t_max: f64::INFINITY };
    let found = query.first_hit(&ray, 0.0).unwrap();
    assert_eq!((found.ijk, found.begins_inside, found.t), (low, false, 4.5));
    assert_eq!(query.first_hit(&IndexRay { dir: glam::DVec3::X, ..ray }, 0.0), None);
}
