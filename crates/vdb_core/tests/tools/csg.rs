use glam::{DVec3, IVec3};
use vdb_core::synth::level_set;
use vdb_core::tools::{CsgOperation, Redistance, csg, redistance};
use vdb_core::tree::{Found, Vdb543, map_values};
use vdb_core::{AnyTree, Grid, GridClass, Transform};

use crate::shapes::{floats, voxels};

fn grid(tree: Vdb543<f32>) -> Grid {
    let mut grid = Grid::new("solid", AnyTree::Float(tree.into()));
    grid.class = GridClass::LevelSet;
    grid
}

const ALL: [CsgOperation; 3] =
    [CsgOperation::Union, CsgOperation::Intersection, CsgOperation::Difference];

fn combine(operation: CsgOperation, a: f32, b: f32) -> f32 {
    match operation {
        CsgOperation::Union => a.min(b),
        CsgOperation::Intersection => a.max(b),
        CsgOperation::Difference => a.max(-b),
    }
}

#[test]
fn every_voxel_is_combined() {
    let sphere = grid(level_set::sphere(DVec3::new(1.3, 2.2, -0.4), 30.0));
    let cuboid =
        grid(level_set::cuboid(DVec3::new(0.3, -40.2, -20.7), DVec3::new(50.1, 9.6, 18.8)));
    for operation in ALL {
        let made = csg(&sphere, &cuboid, operation).unwrap();
        assert_eq!((made.name.as_str(), made.class), ("solid", GridClass::LevelSet));
        let mut tiles = 0;
        for ijk in voxels(-45, 56, 1) {
            let [a, b] = [&sphere, &cuboid].map(|grid| floats(grid).probe(ijk));
            let (value, active) = floats(&made).probe(ijk);
            assert_eq!(value, combine(operation, a.0, b.0), "{operation:?} at {ijk}");
            assert_eq!(active, value.abs() < 3.0, "{operation:?} at {ijk}");
            tiles += u64::from(matches!(floats(&made).find(ijk), Found::Tile(_)));
        }
        assert!(tiles > 100_000, "{operation:?} has {tiles} voxels in tiles");
    }
}

#[test]
fn grids_that_do_not_match_are_refused() {
    let one = grid(level_set::sphere(DVec3::ZERO, 5.0));
    let mut other = one.clone();
    other.transform = Transform::uniform(0.5, DVec3::ZERO).unwrap();
    let error = |other: &Grid| csg(&one, other, CsgOperation::Union).unwrap_err().to_string();
    assert!(error(&other).starts_with("the grids have different transforms"));
    let wider = grid(map_values(floats(&one), |value: f32| 2.0 * value));
    assert!(error(&wider).starts_with("the grids have backgrounds of 3 and 6"));
    let mut words = one.clone();
    words.tree = AnyTree::Int32(Vdb543::new(1).into());
    assert!(error(&words).starts_with("this needs grids of floats"));
    assert!(redistance(&words, &Redistance::default()).is_err());
}

#[test]
fn distances_are_restored() {
    let (center, radius) = (DVec3::new(0.3, 0.8, -0.1), 25.0);
    let sphere = grid(level_set::sphere(center, radius));
    // Signs and roots stay, slopes do not.
    let steep = grid(map_values(floats(&sphere), |value: f32| value * (1.0 + value.abs())));
    for (iso, half_width) in [(0.0, 3.0), (0.0, 6.0), (2.0, 3.0)] {
        let options = Redistance { iso, half_width, ..Redistance::default() };
        let made = redistance(&steep, &options).unwrap();
        // `value (1 + |value|)` is 2 where the value is 1.
        let radius = radius + f64::from(iso) / 2.0;
        let tree = floats(&made);
        assert_eq!(tree.background(), half_width);
        for ijk in voxels(-35, 35, 1) {
            let expected = ijk.as_dvec3().distance(center) - radius;
            let expected = expected.clamp(-f64::from(half_width), half_width.into());
            let value = f64::from(tree.get(ijk));
            // Roots along edges of cells are off by the curvature of the value between two voxels:
            // an eighth of 2, over a slope of 1 to 3. Chords add 3 / 8r.
            assert!((value - expected).abs() < 0.27, "{ijk}: {value}, should be {expected}");
            if iso == 0.0 {
                assert_eq!(value < 0.0, floats(&sphere).get(ijk) < 0.0, "{ijk}");
            }
        }
    }
    // Of distances, it makes the same distances.
    let again = redistance(&sphere, &Redistance::default()).unwrap();
    for ijk in voxels(-35, 35, 1) {
        let [a, b] = [&sphere, &again].map(|grid| floats(grid).get(ijk));
        // Roots of a sphere's distances are off by 1 / 8 (r - 1), chords by 3 / 8r.
        assert!((a - b).abs() < 0.021, "{ijk}: {b}, should be {a}");
    }
}

/// Corners of triangles are rounded to f32, so the surface may pass samples this near on either side.
#[test]
fn samples_within_rounding_of_the_surface_keep_their_side() {
    let mut tree = level_set::sphere(DVec3::new(0.3, 0.8, -0.1), 25.0);
    let mut random = vdb_core::synth::Random::new(2);
    let near: Vec<_> = tree.active_values().filter(|own| own.value.abs() < 0.8).collect();
    for own in &near {
        let value = (1e-9 * random.unit()) as f32;
        tree.set(own.origin, if random.below(2) == 0 { value } else { -value });
    }
    assert!(near.len() > 5000);
    let solid = grid(tree);
    let made = redistance(&solid, &Redistance::default()).unwrap();
    for ijk in voxels(-35, 35, 1) {
        let [a, b] = [&solid, &made].map(|grid| floats(grid).get(ijk));
        assert_eq!(a < 0.0, b < 0.0, "{ijk}: {b} of {a}");
    }
}

#[test]
fn unions_have_distances_again() {
    let a = grid(level_set::sphere(DVec3::new(-9.0, 0.2, 0.1), 15.0));
    let b = grid(level_set::sphere(DVec3::new(9.0, -0.2, 0.3), 15.0));
    let both = csg(&a, &b, CsgOperation::Intersection).unwrap();
    let made = redistance(&both, &Redistance::default()).unwrap();
    // Beyond the edge of the lens, where the spheres meet, the maximum is too small: the true
    // distance is that to the edge itself, about a circle around x of this radius.
    let edge = (15.0_f64 * 15.0 - 9.0 * 9.0).sqrt();
    let p = IVec3::new(0, 14, 0);
    let [bound, distance] = [&both, &made].map(|grid| f64::from(floats(grid).get(p)));
    assert!(bound < 14.0 - edge - 0.15, "{bound}");
    // The edge is cut off within its cell: by less than half of its diagonal.
    assert!((distance - (14.0 - edge)).abs() < 0.87, "{distance}");
    assert!(distance > bound + 0.1, "{distance} is no more than {bound}");
}

/// OpenVDB 10 fills such cavities, and slits that are open only where they are narrower still.
#[test]
fn cavities_with_one_layer_of_samples_stay() {
    let cuboid = |p: DVec3, half: DVec3| {
        let q = p.abs() - half;
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
    };
    // From 0.3 to 1.5 along x.
    let cavity = |p: DVec3| cuboid(p - DVec3::X * 0.9, DVec3::new(0.6, 8.5, 8.5));
    let mut tree = Vdb543::new(3.0_f32);
    for ijk in voxels(-16, 16, 1) {
        let p = ijk.as_dvec3();
        let value = cuboid(p, DVec3::splat(12.3)).max(-cavity(p)).clamp(-3.0, 3.0);
        tree.set(ijk, value as f32);
    }
    let solid = grid(tree);
    let made = redistance(&solid, &Redistance::default()).unwrap();
    for ijk in voxels(-4, 4, 1) {
        // The samples along x are -0.3, 0.5 and -0.5 from 0 on.
        let x = f64::from(ijk.x);
        let distance = (x - 0.375).abs().min((x - 1.5).abs()).min(3.0);
        let expected = if ijk.x == 1 { distance } else { -distance };
        let value = f64::from(floats(&made).get(ijk));
        // Corners of triangles and values have 24 bits, up to 12 voxels from the origin.
        assert!((value - expected).abs() < 2e-6, "{ijk}: {value}, should be {expected}");
    }
}
