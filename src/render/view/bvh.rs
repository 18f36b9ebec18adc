//! A bounding volume hierarchy for shadow and reflection rays in views with many volumes: the
//! volume list is sorted in Morton order, and the boxes of runs of consecutive volumes form an
//! implicit tree, which `bvh.wgsl` traverses.

use bevy::math::DVec3;
use bevy::render::sync_world::MainEntity;

use super::volume::world_corners;
use crate::render::extract::{ExtractedVolume, ExtractedVolumes};
use crate::render::gpu::types::Volume;

/// The largest number of volumes that rays test one by one.
pub(crate) const FEW: usize = 8;
/// The branching factor of the hierarchy.
const BRANCHES: usize = 4;
/// The number of levels: the longest runs have 4¹⁰ volumes.
const MAX_LEVEL: u32 = 10;

/// A box in world space, relative to a view's eye.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: DVec3,
    max: DVec3,
}

impl Bounds {
    const NOTHING: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    fn of(points: impl Iterator<Item = DVec3>) -> Self {
        points.fold(Self::NOTHING, |all, at| Self { min: all.min.min(at), max: all.max.max(at) })
    }

    /// The box in f32, enlarged by the rounding errors of boxes and rays.
    fn rounded(self) -> [[f32; 3]; 2] {
        let farthest = self.min.abs().max(self.max.abs()).max_element();
        let by = farthest * 1e-5;
        // For an empty box, whose infinite bounds minus infinity would be NaN.
        let by = if by.is_finite() { by } else { 0.0 };
        [(self.min - by).as_vec3().to_array(), (self.max + by).as_vec3().to_array()]
    }
}

/// Sorts volumes in Morton order, in which neighbours in space are close to each other (Morton
/// 1966, "A computer oriented geodetic data base"). The order depends only on positions and
/// entities.
pub(crate) fn sort(entities: &mut [MainEntity], volumes: &ExtractedVolumes) {
    let middle = |entity: &MainEntity| {
        let corners = Bounds::of(world_corners(volumes.0.get(entity)?));
        Some(0.5 * (corners.min + corners.max)).filter(|middle| middle.is_finite())
    };
    let all = Bounds::of(entities.iter().filter_map(middle));
    let size = (all.max - all.min).max(DVec3::splat(1e-30));
    entities.sort_by_cached_key(|entity| {
        let at = middle(entity).map_or(DVec3::ZERO, |middle| (middle - all.min) / size);
        (morton((at * 1023.0).as_uvec3().to_array()), *entity)
    });
}

/// The Morton code of three numbers below 2¹⁰: their bits interleaved.
fn morton(at: [u32; 3]) -> u32 {
    (0..10).fold(0, |code, bit| {
        let [x, y, z] = at.map(|x| x >> bit & 1);
        code | (x | y << 1 | z << 2) << (3 * bit)
    })
}

/// Writes the boxes of volumes and runs into a view's volume list, relative to the eye.
pub(crate) fn fill(list: &mut [Volume], shown: &[&ExtractedVolume], eye: DVec3) {
    let boxes = shown.iter().map(|volume| {
        let corners = world_corners(volume);
        Bounds::of(corners.map(|at| at - eye))
    });
    let mut boxes: Vec<Bounds> = boxes.collect();
    for (volume, bounds) in list.iter_mut().zip(&boxes) {
        [volume.box_min, volume.box_max] = bounds.rounded();
    }
    for level in 1..=MAX_LEVEL {
        boxes = boxes
            .chunks(BRANCHES)
            .map(|run| Bounds::of(run.iter().flat_map(|part| [part.min, part.max])))
            .collect();
        for (i, run) in boxes.iter().enumerate() {
            if let Some(volume) = list.get_mut(slot(i * BRANCHES.pow(level), level)) {
                [volume.node_min, volume.node_max] = run.rounded();
            }
        }
    }
}

/// The index of the entry that stores the box of the run of a level that begins at `first`; unique
/// for every run.
fn slot(first: usize, level: u32) -> usize {
    let level = level as usize;
    first + if level > 3 { 4 * (level - 3) } else { level }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_run_has_a_place_of_its_own() {
        let volumes = 1 << 15;
        let mut taken = HashSet::new();
        for level in 1..=MAX_LEVEL {
            let length = BRANCHES.pow(level);
            for first in (0..volumes).step_by(length) {
                let slot = slot(first, level);
                assert!(slot < first + length, "the run of {first}, {length}, keeps to itself");
                assert!(taken.insert(slot), "the run of {first}, {length}");
            }
        }
    }

    #[test]
    fn neighbours_in_space_are_neighbours_in_the_order() {
        assert_eq!(morton([0, 0, 0]), 0);
        assert_eq!(morton([1, 0, 0]), 1);
        assert_eq!(morton([0, 1, 0]), 2);
        assert_eq!(morton([3, 2, 1]), 0b011_101);
        assert_eq!(morton([1023; 3]), (1 << 30) - 1);
    }
}
