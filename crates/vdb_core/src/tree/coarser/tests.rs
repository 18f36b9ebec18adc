use glam::DVec3;

use super::*;
use crate::synth::{Uniform, build, level_set};
use crate::tree::CoordBox;

fn half_resolution(tree: &Vdb543<f32>, coarsening: Coarsening) -> Vdb543<f32> {
    super::half_resolution(tree, coarsening, &LevelOptions::default()).unwrap()
}

const DISTANCES: Coarsening = Coarsening::Surface { iso: 0.0, voxel: Some(1.0) };

fn fog(bbox: CoordBox, density: impl Fn(IVec3) -> f32 + Sync) -> Vdb543<f32> {
    build(0.0, bbox, |_| Uniform::No, |ijk| (density(ijk), true))
}

fn sum(tree: &Vdb543<f32>) -> f64 {
    let voxels = |tile_log2: u32| f64::from(tile_log2 * 3).exp2();
    tree.active_values().map(|at| f64::from(at.value) * voxels(at.log2_dim)).sum()
}

#[test]
fn fog_keeps_its_mass() {
    // Smooth enough that no result is negative; crosses node borders and all octants.
    let bbox = CoordBox { min: IVec3::splat(-150), max: IVec3::splat(150) };
    let tree = fog(bbox, |ijk| (-(ijk.as_vec3().length() / 30.0).powi(2)).exp());
    let coarser = half_resolution(&tree, Coarsening::Fog);
    let (fine, coarse) = (sum(&tree), 8.0 * sum(&coarser));
    assert!((coarse / fine - 1.0).abs() < 1e-5, "{fine} became {coarse}");
}

#[test]
fn a_slope_of_fog_stays_as_it_is() {
    let bbox = CoordBox { min: IVec3::splat(-40), max: IVec3::splat(300) };
    let slope = |p: DVec3| 200.0 + p.dot(DVec3::new(0.25, 0.125, -0.5));
    let tree = fog(bbox, |ijk| slope(ijk.as_dvec3()) as f32);
    let coarser = half_resolution(&tree, Coarsening::Fog);
    for ijk in [IVec3::splat(-10), IVec3::ZERO, IVec3::new(3, 100, 63), IVec3::splat(64)] {
        let (value, expected) = (coarser.get(ijk), slope(2.0 * ijk.as_dvec3()) as f32);
        assert!((value - expected).abs() < 1e-3, "{value}, not {expected} at {ijk}");
    }
}

#[test]
fn wide_tiles_stay_tiles() {
    let bbox = CoordBox { min: IVec3::splat(-256), max: IVec3::splat(255) };
    let tree = build(0.0, bbox, |_| Uniform::Yes(2.0, true), |_| (2.0, true));
    let coarser = half_resolution(&tree, Coarsening::Fog);
    assert_eq!(coarser.get(IVec3::splat(-20)), 2.0);
    // The last voxel contributes to the sample after it.
    let active = coarser.active_bbox().expect("there is fog");
    assert_eq!((active.min, active.max), (IVec3::splat(-128), IVec3::splat(128)));
    // Only shells of leaves, inside tiles of 8³ and 128³ voxels.
    let inside = CoordBox { min: IVec3::splat(-120), max: IVec3::splat(119) };
    let is_inside = |leaf: &&Leaf| inside.contains(leaf.origin());
    assert_eq!(coarser.leaves().filter(is_inside).count(), 0);
}

#[test]
fn distances_stay_distances() {
    let (center, radius) = (DVec3::new(0.3, -40.2, 7.7), 90.0);
    let mut tree = level_set::sphere(center, radius);
    // The errors of levels accumulate.
    for level in 1..=3 {
        let voxel = f32::from(1_u8 << (level - 1));
        let coarsening = Coarsening::Surface { iso: 0.0, voxel: Some(voxel) };
        tree = half_resolution(&tree, coarsening);
        let edge = f64::from(2.0 * voxel);
        assert_eq!(tree.background(), 3.0 * 2.0 * voxel);
        let mut known = 0;
        for at in tree.active_values() {
            let distance = (at.origin.as_dvec3() * edge).distance(center) - radius;
            let off = (f64::from(at.value) - distance).abs() / edge;
            assert!(off < 0.1, "level {level}: {} at {}, {distance}", at.value, at.origin);
            known += usize::from(distance.abs() < 2.5 * edge);
        }
        // All of the band except its outermost part, where the rings may end.
        let all = 4.0 * std::f64::consts::PI * (radius / edge).powi(2) * 5.0;
        let part = known as f64 / all;
        assert!((0.95..1.1).contains(&part), "level {level}: {part} of the band is left");
    }
}

#[test]
fn distances_are_measured_in_their_own_units() {
    let bbox = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) };
    for voxel in [1.0, 0.02] {
        let distance = |ijk: IVec3| voxel * (ijk.as_vec3().length() - 14.3);
        let width = 3.0 * voxel;
        let sample = |ijk| (distance(ijk).clamp(-width, width), distance(ijk).abs() < width);
        let tree = build(width, bbox, |_| Uniform::No, sample);
        let found = voxel_in_distances(&tree).expect("there is a band");
        assert!((found / voxel - 1.0).abs() < 0.02, "{found}, not {voxel}");
    }
    assert_eq!(voxel_in_distances(&Vdb543::new(3.0)), None);
}

#[test]
fn what_is_thin_does_not_vanish() {
    // A strut one voxel thick, all of whose samples are dropped.
    let mut tree = Vdb543::new(3.0);
    for x in 0..64 {
        for (y, z) in (-4..=4).flat_map(|y| (-4..=4).map(move |z| (y, z))) {
            let distance = (y as f32).hypot(z as f32) - 0.4;
            tree.set(IVec3::new(x, 9 + y, 7 + z), distance.min(3.0));
        }
    }
    let coarser = half_resolution(&tree, DISTANCES);
    for x in 0..32 {
        let around = (3..=5).flat_map(|y| (2..=4).map(move |z| IVec3::new(x, y, z)));
        let solid = around.filter(|ijk| coarser.get(*ijk) < 0.0).count();
        assert_eq!(solid, 1, "at x = {x}");
    }
}

#[test]
fn leaves_agree_where_they_meet() {
    // The same surface at another position relative to the nodes of the tree.
    let shift = IVec3::new(8, -24, 4104);
    let place = DVec3::new(4.2, 5.1, 6.4);
    let here = half_resolution(&level_set::sphere(place, 20.0), DISTANCES);
    let moved = level_set::sphere(place + shift.as_dvec3(), 20.0);
    let there = half_resolution(&moved, DISTANCES);
    for at in here.active_values() {
        let other = there.get(at.origin + shift / 2);
        assert!((at.value - other).abs() < 1e-5, "{} and {other} at {}", at.value, at.origin);
    }
}

/// Tiles of three sizes, adjacent to each other and to the background.
fn tiles() -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.25);
    for (i, value) in [0.5, 2.0, -1.0, 0.0].into_iter().enumerate() {
        let at = 128 * IVec3::new(i as i32, 1, 0);
        tree.touch_leaf(at);
        for slot in (0..1024).filter(|slot| slot % 7 != i) {
            tree.fill_leaf(at + Lower::slot_offset(slot), value, true);
        }
    }
    tree.prune();
    tree
}

#[test]
fn tiles_become_what_leaves_of_their_values_become() {
    let tiles = tiles();
    let mut leaves = tiles.clone();
    for value in tiles.values().filter(|at| at.log2_dim == Leaf::TOTAL_LOG2_DIM) {
        leaves.touch_leaf(value.origin);
    }
    assert!(leaves.stats().leaf_count() > 3000 && tiles.stats().leaf_count() == 0);
    for coarsening in [Coarsening::Fog, DISTANCES, Coarsening::Surface { iso: 1.0, voxel: None }] {
        let [of_tiles, of_leaves] = [&tiles, &leaves].map(|tree| half_resolution(tree, coarsening));
        let [mut a, mut b] = [of_tiles.values(), of_leaves.values()];
        loop {
            match (a.next(), b.next()) {
                (Some(a), Some(b)) => {
                    let [a, b] = [a, b].map(|at| (at.origin, at.value.to_bits(), at.active));
                    assert_eq!(a, b, "{coarsening:?}");
                }
                (None, None) => break,
                _ => panic!("{coarsening:?}: one of them has more values"),
            }
        }
    }
}

#[test]
fn leaves_along_tiles_are_worked_out_once() {
    let mut tree = Vdb543::new(0.0);
    tree.touch_leaf(IVec3::ZERO);
    for at in [IVec3::ZERO, IVec3::splat(128), IVec3::new(0, 0, 256)] {
        for slot in 0..Lower::SIZE {
            tree.fill_leaf(at + Lower::slot_offset(slot), 1.0, true);
        }
    }
    tree.prune();
    assert_eq!(tree.stats().leaf_count(), 0);
    let work = Work::new(None, 0, u64::MAX);
    let halving = Halving::new(&tree, Coarsening::Fog, &work);
    let made = match halving.upper(IVec3::ZERO) {
        Ok(Built::Node(upper)) => upper.leaves().count(),
        _ => panic!("there is a node"),
    };
    let worked_out = halving.tile_leaves.read().unwrap().len();
    assert!(made > 1000 && 8 * worked_out < made, "{worked_out} of {made} leaves");
}
