//! Packed grids against the trees that they come from: every cell, every value.

use glam::Vec3;
use vdb_core::pack::{PackKind, PackedGrid, traverse};
use vdb_core::reference::{Blocky, Occupied, Ray, optical_depth};
use vdb_core::synth::Random;
use vdb_core::tree::{CoordBox, IVec3, Vdb543};

/// Every lattice cell of a box, compared with the definition on the tree; and every sample.
fn check(tree: &Vdb543<f32>, kind: PackKind, boxes: &[CoordBox]) -> PackedGrid {
    let grid = PackedGrid::new(tree, kind).unwrap();
    let mut seen = 0;
    for cube in boxes {
        for x in cube.min.x..=cube.max.x {
            for y in cube.min.y..=cube.max.y {
                for z in cube.min.z..=cube.max.z {
                    let ijk = IVec3::new(x, y, z);
                    let local = ijk.wrapping_sub(grid.base);
                    let expected = match kind {
                        PackKind::Surface { iso } => tree.get(ijk) < iso,
                        PackKind::Fog => corners(ijk).any(|corner| tree.get(corner) > 0.0),
                        PackKind::Smooth { iso } => {
                            let inside = |corner| tree.get(corner) < iso;
                            corners(ijk).any(inside) && !corners(ijk).all(inside)
                        }
                    };
                    let span = traverse::locate(&grid, local, 0);
                    let boundary_tile =
                        span.occupied() && span.word & vdb_core::pack::layout::BOUNDARY != 0;
                    // A mixed tile may hold empty cells: it is exact in what it shows, not in what
                    // it looks at. Everything else is occupied if and only if the tree says so.
                    assert!(span.occupied() == expected || boundary_tile, "{ijk}: {span:?}");
                    if span.occupied() && !boundary_tile {
                        assert!(grid.occupied.unwrap().contains(local), "{ijk} is outside the box");
                    }
                    check_samples(tree, &grid, ijk, span);
                    seen += i32::from(expected);
                }
            }
        }
    }
    assert!(seen > 0, "nothing was occupied: the test tested nothing");
    grid
}

/// The samples of an occupied cell, as they are.
fn check_samples(tree: &Vdb543<f32>, grid: &PackedGrid, ijk: IVec3, span: traverse::Span) {
    let iso = match grid.kind {
        PackKind::Surface { .. } => return,
        PackKind::Smooth { iso } => iso,
        PackKind::Fog => 0.0,
    };
    if span.occupied() && span.constant() {
        let value = tree.get(ijk);
        assert!(corners(ijk).all(|corner| tree.get(corner) == value), "{ijk} is not constant");
    } else if span.occupied() {
        let kept = traverse::corners(grid, span, ijk.wrapping_sub(grid.base));
        let expected = corners(ijk).map(|corner| tree.get(corner) - iso);
        assert!(kept.into_iter().eq(expected), "{ijk}: {kept:?}");
    }
}

fn corners(ijk: IVec3) -> impl Iterator<Item = IVec3> {
    (0..8).map(move |i| ijk.wrapping_add(IVec3::new(i >> 2, i >> 1 & 1, i & 1)))
}

fn around(center: IVec3, radius: i32) -> CoordBox {
    CoordBox { min: center - radius, max: center + radius }
}

fn level_set_sphere(center: IVec3, radius: f32) -> Vdb543<f32> {
    let mut tree = Vdb543::new(3.0);
    let reach = radius as i32 + 4;
    for x in -reach..=reach {
        for y in -reach..=reach {
            for z in -reach..=reach {
                let distance = IVec3::new(x, y, z).as_vec3().length() - radius;
                if distance.abs() < 3.0 {
                    tree.set(center + IVec3::new(x, y, z), distance);
                } else if distance < 0.0 {
                    tree.set_inactive(center + IVec3::new(x, y, z), -3.0);
                }
            }
        }
    }
    tree.prune();
    tree
}

#[test]
fn a_level_set_is_solid_inside() {
    for center in [IVec3::ZERO, IVec3::new(4090, -4100, 130)] {
        let tree = level_set_sphere(center, 20.0);
        assert!(tree.stats().levels[1].nodes > 0);
        let grid = check(&tree, PackKind::Surface { iso: 0.0 }, &[around(center, 26)]);
        let occupied = grid.occupied.unwrap();
        let expected = around(center - grid.base, 19);
        assert!(
            expected.intersection(occupied) == Some(expected),
            "{occupied:?} does not hold {expected:?}"
        );
    }
}

#[test]
fn a_smooth_surface_is_where_samples_change_their_sign() {
    for center in [IVec3::ZERO, IVec3::new(4090, -4100, 130)] {
        let tree = level_set_sphere(center, 20.0);
        check(&tree, PackKind::Smooth { iso: 0.0 }, &[around(center, 26)]);
    }
    // Bands cut off, so that tiles of both signs touch leaves and each other.
    let mut tree = Vdb543::new(1.0);
    tree.insert_tile(IVec3::ZERO, -1.0, false);
    for corner in [0, 8, 128, 4095] {
        tree.set(IVec3::splat(corner), if corner == 4095 { -1.0 } else { 1.0 });
    }
    tree.set(IVec3::new(-3, 64, 64), -1.0);
    let boxes = [
        around(IVec3::splat(8), 10),
        around(IVec3::splat(128), 3),
        around(IVec3::splat(4095), 4),
        around(IVec3::new(-3, 64, 64), 4),
        around(IVec3::new(4095, 77, 900), 2),
    ];
    check(&tree, PackKind::Smooth { iso: 0.0 }, &boxes);
}

#[test]
fn interior_tiles_are_solid() {
    let tree = level_set_sphere(IVec3::splat(40), 30.0);
    let inside = tree.values().filter(|v| v.log2_dim == 3 && v.value < 0.0).count();
    assert!(inside > 0, "the sphere has no interior tile");
    check(&tree, PackKind::Surface { iso: 0.0 }, &[around(IVec3::splat(40), 35)]);
}

#[test]
fn fog_cells_reach_over_the_borders_of_leaves_and_nodes() {
    // One sample on each kind of low border: of a leaf, of a 16³ node, of a 32³ node, of octants.
    for corner in [8, 128, 4096, 0, -8, -4096] {
        let mut tree = Vdb543::new(0.0);
        tree.set(IVec3::splat(corner), 1.0);
        check(&tree, PackKind::Fog, &[around(IVec3::splat(corner), 3)]);
    }
}

#[test]
fn dense_tiles_of_every_level_are_boundary_tiles_at_their_borders_only() {
    let mut tree = Vdb543::new(0.0);
    for x in 0..8 {
        for y in 0..8 {
            for z in 0..8 {
                tree.set(IVec3::new(x, y, z) + 200, 0.5);
                tree.set(IVec3::new(x, y, z) + IVec3::new(208, 200, 200), 0.5);
            }
        }
    }
    tree.prune();
    assert_eq!(tree.stats().active_tiles(), 2);
    tree.insert_tile(IVec3::new(0, -4096, 0), 0.25, true);
    let boxes = [
        around(IVec3::splat(204), 12),
        around(IVec3::new(0, 0, 100), 3),
        around(IVec3::new(4096, -1, 4096), 3),
        around(IVec3::new(1000, -2000, 1000), 2),
    ];
    let grid = check(&tree, PackKind::Fog, &boxes);
    let inside = IVec3::new(1000, -2000, 1000) - grid.base;
    assert!(
        traverse::locate(&grid, inside, 0).log_dim >= 7,
        "the middle of a root tile is taken cell by cell"
    );
}

#[test]
fn a_leaf_beside_a_root_tile_leaves_the_tiles_around_it_whole() {
    // Before the face of a root tile, a row of mixed tiles of 128³ along z, with a leaf in one: that
    // one is a node, the tile before it is cut into leaves, and the tile before that is not.
    for kind in [PackKind::Fog, PackKind::Smooth { iso: 0.1 }] {
        let mut tree = Vdb543::new(0.0);
        tree.insert_tile(IVec3::ZERO, 0.25, true);
        tree.set(IVec3::new(-64, 200, 700), 0.5);
        let beside = |z: i32| around(IVec3::new(-1, 200, z), 4);
        let boxes = [beside(700), beside(640), beside(600), beside(512), beside(400)];
        check(&tree, kind, &boxes);
    }
}

/// Tiles of every size, of values that count and that do not, and voxels, around a corner of root
/// tiles. Bits of the numbers say what goes where.
fn tiles_around(corner: IVec3, random: &mut Random) -> Vdb543<f32> {
    let values = [0.0, 0.0, -0.5, 0.25, 0.25, 1.5];
    let mut tree = Vdb543::new([0.0, 0.3, -0.2][random.below(3) as usize]);
    let value = |random: &mut Random| values[random.below(6) as usize];
    for side in 0..8 {
        let side = IVec3::new(side >> 2, side >> 1 & 1, side & 1) - 1;
        let at = |size: i32| corner.checked_add(side * size);
        if let Some(at) = at(4096)
            && random.below(3) > 0
        {
            tree.insert_tile(at, value(random), random.below(2) == 0);
        }
        if let Some(at) = at(128)
            && random.below(2) == 0
        {
            // A tile of 128³ among others: every leaf of it is filled, which is then one.
            let own = value(random);
            for i in 0..4096 {
                let cube = IVec3::new(i >> 8, i >> 4 & 15, i & 15) * 8;
                tree.fill_leaf(at + cube, own, false);
            }
        }
        if let Some(at) = at(8)
            && random.below(2) == 0
        {
            tree.fill_leaf(at, value(random), false);
        }
        if let Some(at) = at(1)
            && random.below(3) == 0
        {
            tree.set(at, value(random));
        }
    }
    tree.prune();
    tree
}

#[test]
fn tiles_of_every_size_beside_each_other() {
    let mut random = Random::new(16);
    // At the corner itself, along its edges and faces, and in the tiles around it.
    let steps = [0, 8, 128, 200, 512, 600, 2048, 4096];
    let mut places = vec![];
    for (i, &a) in steps.iter().enumerate() {
        for &b in &steps[i..] {
            places.extend([IVec3::new(0, a, b), IVec3::new(-a, 0, b), IVec3::new(b, -a, 0)]);
            places.extend([IVec3::new(-b, -a, a), IVec3::new(a, b, -a)]);
        }
    }
    let lowest = IVec3::MIN + 4096;
    for round in 0..40 {
        let corner = [IVec3::ZERO, IVec3::new(-8192, 4096, 40_960), lowest][round % 3];
        let tree = tiles_around(corner, &mut random);
        for kind in [PackKind::Fog, PackKind::Smooth { iso: 0.1 }] {
            let boxes: Vec<CoordBox> = (places.iter())
                .filter_map(|place| corner.checked_add(*place))
                .filter(|at| at.min_element() > i32::MIN + 2)
                .map(|at| around(at, 1))
                .collect();
            check_tiles(&tree, kind, &boxes);
        }
    }
}

#[test]
fn rays_through_tiles_are_those_of_the_oracle() {
    let mut random = Random::new(17);
    let (mut met, mut dimmed) = (0, 0);
    for round in 0..30 {
        let corner = [IVec3::ZERO, IVec3::new(-8192, 4096, 40_960)][round % 2];
        let tree = tiles_around(corner, &mut random);
        if tree.background() != 0.0 {
            continue;
        }
        let fog = PackedGrid::new(&tree, PackKind::Fog).unwrap();
        let solid = PackedGrid::new(&tree, PackKind::Surface { iso: -0.1 }).unwrap();
        let oracle = Blocky::new(&tree, Occupied::BelowIso(-0.1));
        for _ in 0..200 {
            let mut unit = || random.unit() as f32;
            let toward = Vec3::from_array([unit(), unit(), unit()]) - 0.5;
            let dir = toward.normalize_or(Vec3::X);
            let beside = Vec3::from_array([unit(), unit(), unit()]) * 24.0 - 12.0;
            let start = (beside - 140.0 * dir).floor();
            let cell = corner + start.as_ivec3();
            let frac = ((beside - 140.0 * dir - start) * 4096.0).floor() / 4096.0;

            let ray =
                traverse::Ray { t_max: 300.0, ..traverse::Ray::from_index(&fog, cell, frac, dir) };
            let exact = Ray::new(cell, frac, dir).with_span(0.0, 300.0);
            let found = f64::from(traverse::optical_length(&fog, &ray));
            let expected = optical_depth(&tree, &exact).value;
            let error = (found - expected).abs();
            assert!(error < 1e-4 * (1.0 + expected), "{found}, not {expected}: {ray:?} ({round})");
            dimmed += usize::from(expected > 0.0);

            let Some(_) = solid.occupied else { continue };
            let ray = traverse::Ray::from_index(&solid, cell, frac, dir);
            let exact = Ray::new(ray.cell + solid.base, ray.frac - 0.5, dir);
            let exact = exact.with_span(0.0, ray.t_max).flushed();
            let expected = oracle.first_voxel(&exact).map(|hit| hit.ijk);
            let found = traverse::first_hit(&solid, &ray).map(|hit| hit.cell + solid.base);
            assert_eq!(found, expected, "{ray:?} ({round})");
            met += usize::from(expected.is_some());
        }
    }
    assert!(met > 200 && dimmed > 1000, "{met} rays met something, {dimmed} were dimmed");
}

/// As [`check`], of what a tree holds: of its background nothing is shown but where it touches that.
fn check_tiles(tree: &Vdb543<f32>, kind: PackKind, boxes: &[CoordBox]) {
    let grid = PackedGrid::new(tree, kind).unwrap();
    let Some(bounds) = grid.occupied else { return };
    let is_void =
        |at: IVec3| !tree.entries().any(|(origin, _)| CoordBox::cube(origin, 12).contains(at));
    let counts = |value: f32| match kind {
        PackKind::Surface { iso } | PackKind::Smooth { iso } => value < iso,
        PackKind::Fog => value > 0.0,
    };
    for ijk in boxes
        .iter()
        .flat_map(|cube| (0..27).map(|i| cube.min + IVec3::new(i / 9, i / 3 % 3, i % 3)))
    {
        let local = ijk.wrapping_sub(grid.base);
        let samples: Vec<f32> = corners(ijk).map(|corner| tree.get(corner)).collect();
        let any = samples.iter().any(|&value| counts(value));
        let all = samples.iter().all(|&value| counts(value));
        let expected = any && (kind == PackKind::Fog || !all);
        let span = traverse::locate(&grid, local, 0);
        let is_boundary = span.occupied() && span.word & vdb_core::pack::layout::BOUNDARY != 0;
        let void = is_void(ijk) && counts(tree.background());
        assert!(span.occupied() == expected || is_boundary || void, "{kind:?} {ijk}: {span:?}");
        if span.occupied() && (expected || !is_boundary) {
            assert!(bounds.contains(local), "{kind:?} {ijk} is outside the box");
        }
        check_samples_safe(tree, &grid, ijk, span);
    }
}

/// The samples of an occupied cell, as a shader gets them.
fn check_samples_safe(tree: &Vdb543<f32>, grid: &PackedGrid, ijk: IVec3, span: traverse::Span) {
    let safe = |corner: IVec3| match grid.kind {
        PackKind::Fog => tree.get(corner).max(0.0),
        PackKind::Surface { iso } | PackKind::Smooth { iso } => tree.get(corner) - iso,
    };
    if span.occupied() && span.constant() {
        assert!(corners(ijk).all(|corner| safe(corner) == safe(ijk)), "{ijk} is not constant");
    } else if span.occupied() {
        let kept = traverse::corners(grid, span, ijk.wrapping_sub(grid.base));
        assert!(kept.into_iter().eq(corners(ijk).map(safe)), "{ijk}: {kept:?} of {span:?}");
    }
}

#[test]
fn values_that_a_shader_cannot_hold_are_made_safe() {
    let mut tree = Vdb543::new(0.0);
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 1e38, 1e-40];
    for (i, value) in values.into_iter().enumerate() {
        tree.set(IVec3::new(i as i32, 0, 0), value);
    }
    for kind in [PackKind::Fog, PackKind::Smooth { iso: 0.0 }] {
        let grid = PackedGrid::new(&tree, kind).unwrap();
        assert!(grid.majorant.is_finite());
        let mut seen = 0;
        for x in -1..=6 {
            let cell = IVec3::new(x, 0, 0) - grid.base;
            let span = traverse::locate(&grid, cell, 0);
            if span.occupied() {
                seen += 1;
                let kept = traverse::corners(&grid, span, cell);
                assert!(kept.iter().all(|v| v.is_finite()), "{kept:?}");
                assert!(kind != PackKind::Fog || kept.iter().all(|v| *v >= 0.0), "{kept:?}");
            }
        }
        assert!(seen > 1);
    }
}

#[test]
fn coordinates_next_to_the_limits_and_far_apart() {
    let corners = [IVec3::MIN + 1, IVec3::MAX - 1, IVec3::new(i32::MIN + 1, i32::MAX - 1, 0)];
    let mut tree = Vdb543::new(0.0);
    for (i, ijk) in corners.into_iter().enumerate() {
        tree.set(ijk, 1.0 + i as f32);
    }
    let near = |ijk: IVec3| CoordBox { min: ijk - 1, max: ijk };
    let boxes = corners.map(near);
    let grid = check(&tree, PackKind::Fog, &boxes);
    assert!(grid.bytes() < 1 << 20, "{} bytes for three voxels", grid.bytes());
    let mut level_set = Vdb543::new(3.0);
    corners.iter().for_each(|&ijk| level_set.set(ijk, -1.0));
    let grid = check(&level_set, PackKind::Surface { iso: 0.0 }, &boxes);
    assert!(grid.bytes() < 1 << 20);

    // Each alone lies at a base of its own.
    for ijk in corners {
        let mut tree = Vdb543::new(0.0);
        tree.set(ijk, 1.0);
        let grid = check(&tree, PackKind::Fog, &[near(ijk)]);
        assert!(grid.occupied.unwrap().max.max_element() < 512);
    }
}

#[test]
fn an_empty_grid_packs_to_nothing() {
    for kind in [PackKind::Fog, PackKind::Surface { iso: 0.0 }] {
        let grid = PackedGrid::new(&Vdb543::new(1.0), kind).unwrap();
        assert_eq!(grid.occupied, None);
    }
}
