use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::{DVec3, IVec3};
use vdb_core::tools::{InsideRule, MeshToLevelSet, ToolError, mesh_to_level_set};
use vdb_core::tree::{Found, Vdb543};
use vdb_core::{Grid, GridClass};

use crate::shapes::{Triangles, corners, distance, floats, pebble, winding};

/// The greatest error of a distance, in voxels: that of the result's rounding to f32, as all is
/// computed in f64. Half a unit in the last place of 5.5, the widest band here, is 2.4e-7.
const ERROR: f64 = 2.5e-7;

fn level_set((positions, triangles): &Triangles, options: &MeshToLevelSet) -> Grid {
    mesh_to_level_set(positions, triangles, options).unwrap()
}

fn voxels(reach: i32) -> impl Iterator<Item = IVec3> {
    let axis = move || -reach..=reach;
    axis().flat_map(move |x| axis().flat_map(move |y| axis().map(move |z| IVec3::new(x, y, z))))
}

/// Compares all voxels of a box around the origin with brute force; returns how many are active.
fn check(
    tree: &Vdb543<f32>,
    triangles: &[[DVec3; 3]],
    options: &MeshToLevelSet,
    reach: i32,
) -> u64 {
    let (size, band) = (options.voxel_size, f64::from(options.half_width));
    let mut accessor = tree.accessor();
    let mut found = 0;
    for ijk in voxels(reach) {
        let p = ijk.as_dvec3() * size;
        let all = triangles.iter().map(|triangle| distance(p, *triangle) / size);
        let nearest = all.fold(f64::INFINITY, f64::min);
        let (value, active) = accessor.probe(ijk);
        let value = f64::from(value) / size;
        let expected = nearest.min(band);
        assert!((value.abs() - expected).abs() < ERROR, "{ijk}: {value}, should be {expected}");
        if (nearest - band).abs() > ERROR {
            assert_eq!(active, nearest < band, "{ijk}, at a distance of {nearest}");
        }
        let inside = winding(p, triangles).abs() > 0.5;
        assert!(nearest < ERROR || (value < 0.0) == inside, "{ijk}: {value}, inside: {inside}");
        found += u64::from(active);
    }
    found
}

#[test]
fn distances_and_signs_are_those_of_brute_force() {
    // Triangles of about a voxel, of several voxels, and larger than nodes of 8³.
    for (radius, rings, half_width, seed) in
        [(9.0, 12, 3.0, 1), (14.0, 5, 3.0, 2), (9.0, 3, 5.5, 3)]
    {
        let mesh = pebble(radius * 0.25, rings, seed);
        let options = MeshToLevelSet { half_width, ..MeshToLevelSet::new(0.25) };
        let grid = level_set(&mesh, &options);
        assert_eq!(grid.class, GridClass::LevelSet);
        assert_eq!(grid.transform.voxel_size(), DVec3::splat(0.25));
        let reach = (radius * 1.1 + f64::from(half_width)).ceil() as i32 + 1;
        let tree = floats(&grid);
        let active = check(tree, &corners(&mesh), &options, reach);
        assert_eq!(active, tree.active_voxel_count(), "none elsewhere");
    }
}

#[test]
fn corners_and_faces_on_voxels_are_inside_once() {
    // A cube with all corners, edges and faces on voxels, and diagonals through voxels.
    let corner = |i: u32| [i >> 2, i >> 1 & 1, i & 1].map(|bit| if bit == 1 { 4.0 } else { -4.0 });
    let quads: [[u32; 4]; 6] =
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let cube: Triangles = ((0..8).map(corner).collect(), triangles);
    let options = MeshToLevelSet::new(1.0);
    check(floats(&level_set(&cube, &options)), &corners(&cube), &options, 9);
}

#[test]
fn the_rest_is_tiles_of_the_background() {
    let mesh = pebble(300.0, 24, 4);
    let grid = level_set(&mesh, &MeshToLevelSet::new(1.0));
    let tree = floats(&grid);
    assert_eq!(tree.background(), 3.0);
    let Found::Tile(center) = tree.find(IVec3::ZERO) else { panic!("a leaf at the center") };
    assert_eq!((center.value, center.active, center.log2_dim), (-3.0, false, 7));
    // Along lines through the whole tree, signs change where the surface is and nowhere else.
    let triangles = corners(&mesh);
    for i in 0..40 {
        let (y, z) = (i * 13 % 200 - 100, i * 29 % 200 - 100);
        for x in (-400..400).step_by(9) {
            let ijk = IVec3::new(x, y, z);
            let inside = winding(ijk.as_dvec3(), &triangles) > 0.5;
            assert_eq!(tree.get(ijk) < 0.0, inside, "{ijk}");
        }
    }
}

#[test]
fn large_solids_have_large_tiles() {
    // A tetrahedron with a whole node of 4096³ voxels inside, of which only the tiles are looked at.
    // Long triangles at 200 voxels per unit of a leaf would take minutes: the voxels are large.
    let edge = 60.0_f32;
    let positions =
        vec![[-9.0, -9.0, -9.0], [edge, -9.0, -9.0], [-9.0, edge, -9.0], [-9.0, -9.0, edge]];
    let mesh = (positions, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
    let grid = level_set(&mesh, &MeshToLevelSet::new(0.05));
    let Found::Tile(tile) = floats(&grid).find(IVec3::splat(64)) else { panic!("a leaf") };
    assert_eq!((tile.value, tile.log2_dim), (-0.15, 7));
}

/// Holes are closed, and flipped triangles turned around.
#[test]
fn holes_and_flipped_triangles_leave_solids() {
    let whole = pebble(20.0, 12, 5);
    let options = MeshToLevelSet::new(1.0);
    let solid = level_set(&whole, &options);
    let inside = |grid: &Grid| {
        let tree = floats(grid);
        voxels(26).filter(|ijk| tree.get(*ijk) < 0.0).count() as f64
    };

    let mut open = whole.clone();
    open.1.drain(..24);
    let closed = inside(&level_set(&open, &options));
    // The triangles around a pole are 24: a hole of a twelfth of π across, closed by a flat fan.
    assert!((0.97..1.0).contains(&(closed / inside(&solid))), "{closed} of {}", inside(&solid));

    let mut flipped = whole.clone();
    for triangle in flipped.1.iter_mut().step_by(7) {
        triangle.swap(1, 2);
    }
    let flipped = level_set(&flipped, &options);
    for ijk in voxels(26) {
        let [own, expected] = [&flipped, &solid].map(|grid| floats(grid).get(ijk));
        assert!(f64::from(own - expected).abs() < ERROR, "{ijk}: {own}, should be {expected}");
    }

    let split: Triangles = {
        let points = |corners: &[u32; 3]| corners.map(|i| whole.0[i as usize]);
        let positions: Vec<_> = whole.1.iter().flat_map(points).collect();
        let triangles = (0..whole.1.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        (positions, triangles)
    };
    let split = level_set(&split, &options);
    assert!(voxels(26).all(|ijk| floats(&split).get(ijk) == floats(&solid).get(ijk)));
}

/// Programs round positions, so copies of a vertex may differ in their last bits.
#[test]
fn slits_are_closed_across() {
    let whole = pebble(20.0, 12, 5);
    let corners = whole.1.iter().flatten().map(|&corner| whole.0[corner as usize]);
    // At most 0.0049 from the vertex: 0.0098 from each other.
    let moved = (0_u32..).zip(corners).map(|(i, at)| {
        let part = |axis: u32| {
            ((i * 3 + axis).wrapping_mul(2_654_435_761) >> 16 & 0xff) as f32 / 255.0 - 0.5
        };
        [0, 1, 2].map(|axis| at[axis as usize] + 0.0056 * part(axis))
    });
    let triangles = (0..whole.1.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let options = MeshToLevelSet::new(1.0);
    let [solid, split] =
        [&whole, &(moved.collect(), triangles)].map(|mesh| level_set(mesh, &options));
    for ijk in voxels(26) {
        let [own, expected] = [&split, &solid].map(|grid| floats(grid).get(ijk));
        assert!((own - expected).abs() < 0.005, "{ijk}: {own}, should be {expected}");
    }
}

#[test]
fn rules_differ_where_solids_overlap() {
    let (mut positions, mut triangles) = pebble(12.0, 8, 6);
    let (inner, faces) = pebble(6.0, 6, 7);
    let first = positions.len() as u32;
    positions.extend(inner);
    triangles.extend(faces.iter().map(|face| face.map(|i| i + first)));
    let center = |triangles: &[[u32; 3]], inside: InsideRule| {
        let options = MeshToLevelSet { inside, ..MeshToLevelSet::new(1.0) };
        let grid = mesh_to_level_set(&positions, triangles, &options).unwrap();
        floats(&grid).get(IVec3::ZERO)
    };
    let [non_zero, positive, odd] = [InsideRule::NonZero, InsideRule::Positive, InsideRule::Odd];
    // Around the center twice.
    assert_eq!(center(&triangles, non_zero), -3.0);
    assert_eq!(center(&triangles, positive), -3.0);
    assert_eq!(center(&triangles, odd), 3.0);
    // Once, backwards.
    let back: Vec<_> = faces.iter().map(|&[a, b, c]| [a + first, c + first, b + first]).collect();
    assert_eq!(center(&back, non_zero), -3.0);
    assert_eq!(center(&back, positive), 3.0);
    assert_eq!(center(&back, odd), -3.0);
}

#[test]
fn degenerate_triangles_are_segments_and_points() {
    let positions = vec![[0.5, 0.25, 0.0], [10.5, 3.0, 7.0], [5.5, 1.625, 3.5], [-9.0, 8.0, 2.0]];
    let mesh = (positions, vec![[0, 1, 2], [3, 3, 3], [0, 0, 1]]);
    let options = MeshToLevelSet::new(1.0);
    let grid = level_set(&mesh, &options);
    assert!(check(floats(&grid), &corners(&mesh), &options, 16) > 300);
}

#[test]
fn bad_input_is_one_error_and_takes_no_time() {
    let start = Instant::now();
    let (mut positions, mut triangles) = pebble(1.0, 6, 8);
    let error = |positions: &[[f32; 3]], triangles: &[[u32; 3]], options: &MeshToLevelSet| {
        mesh_to_level_set(positions, triangles, options).unwrap_err().to_string()
    };
    let fine = MeshToLevelSet::new(0.1);
    assert!(error(&positions, &[], &fine).starts_with("the mesh has no triangles"));
    for size in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
        let said = error(&positions, &triangles, &MeshToLevelSet::new(size));
        assert!(said.starts_with(&format!("the voxel size is {size}; ")), "{said}");
    }
    for half_width in [0.5, 101.0, f32::NAN] {
        let said = error(&positions, &triangles, &MeshToLevelSet { half_width, ..fine.clone() });
        assert!(said.starts_with(&format!("the half width of the band is {half_width}")), "{said}");
    }
    // A surface of 4π square units in voxels of 1e-5.5 units.
    let options = MeshToLevelSet::new(0.1_f64.powf(5.5));
    match mesh_to_level_set(&positions, &triangles, &options) {
        Err(ToolError::TooManyVoxels { voxels, limit }) => {
            assert!((1e12..1.5e13).contains(&voxels), "{voxels}");
            assert_eq!(limit, options.limits.tree_bytes);
        }
        other => panic!("{other:?}"),
    }
    let mut tight = fine.clone();
    tight.limits.tree_bytes = 300_000;
    assert!(error(&positions, &triangles, &tight).contains("`Limits::tree_bytes`"));
    let cancelled =
        MeshToLevelSet { progress: Some(Arc::new(|_, _| ControlFlow::Break(()))), ..fine.clone() };
    assert_eq!(
        mesh_to_level_set(&positions, &triangles, &cancelled).unwrap_err(),
        ToolError::Cancelled
    );

    positions[5][1] = 1e30;
    let said = error(&positions, &triangles, &fine);
    assert!(said.starts_with("vertex 5 of the mesh is 1.0e31 voxels from the origin"), "{said}");
    positions[5][1] = f32::NAN;
    let said = error(&positions, &triangles, &fine);
    assert!(said.starts_with("vertex 5 of the mesh is at [") && said.contains("NaN"), "{said}");
    triangles[7][2] = 4_000_000;
    let said = error(&positions, &triangles, &fine);
    assert!(said.starts_with("triangle 7 of the mesh refers to vertex 4000000"), "{said}");
    // Nothing above makes a tree; a second is a hundred times what it takes.
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
}
