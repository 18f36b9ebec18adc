//! Where the packed grid of an entry is in the world.

use bevy::math::{DAffine3, DVec3};
use vdb_core::pack::{FogDetail, PackedGrid};
use vdb_core::tree::CoordBox;

use crate::render::extract::{ExtractedRamp, MaterialRow};

/// The packed grid of an entry, in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    /// From local lattice coordinates.
    pub world_from_local: DAffine3,
    /// The local cells that can stop or dim a ray.
    pub occupied: Option<CoordBox>,
    /// An upper bound of the density; of a fog with a ramp, of its extinction.
    pub majorant: f32,
    /// How much the densities of a fog change from voxel to voxel.
    pub detail: FogDetail,
    /// How steep the ramp of a fog is: see [`Ramp::steepness`](vdb_core::Ramp::steepness). 1 without.
    pub steepness: f32,
    /// Identifies the ramp of a fog.
    pub ramp: Option<u64>,
    /// The custom material.
    pub material: Option<MaterialRow>,
    /// Identifies what cuts the volume; 0 if nothing does.
    pub clip: u64,
    /// Identifies the voxels of the grids that colour the volume; 0 without.
    pub colors: u64,
    /// Identifies the voxels: see `VdbTreePool::content`.
    pub content: Option<u64>,
}

impl Lattice {
    pub fn new(packed: &PackedGrid, world_from_index: DAffine3, content: Option<u64>) -> Self {
        let origin = packed.base.as_dvec3() + packed.kind.lattice_origin();
        Self {
            world_from_local: world_from_index * DAffine3::from_translation(origin),
            occupied: packed.occupied,
            majorant: packed.majorant,
            detail: packed.detail,
            steepness: 1.0,
            ramp: None,
            material: None,
            clip: 0,
            colors: 0,
            content,
        }
    }

    /// Of these local cells, with nothing else to it, for tests. A fog has about the detail of a cloud of noise
    /// several hundred voxels across.
    #[cfg(test)]
    pub fn of_cells(world_from_local: DAffine3, occupied: CoordBox, majorant: f32) -> Self {
        Self {
            world_from_local,
            occupied: Some(occupied),
            majorant,
            detail: FogDetail {
                differences: [1.0, 3.0, 6.0].map(|d| d / 64.0),
                mean: 0.5,
                thickness: 144.0,
            },
            steepness: 1.0,
            ramp: None,
            material: None,
            clip: 0,
            colors: 0,
            content: Some(0),
        }
    }

    /// With the ramp of a fog.
    pub fn with_ramp(self, ramp: Option<&ExtractedRamp>) -> Self {
        let Some(ramp) = ramp else { return self };
        Self {
            majorant: ramp.ramp.largest_extinction(self.majorant),
            steepness: ramp.ramp.steepness(self.majorant),
            ramp: Some(ramp.content),
            ..self
        }
    }

    /// With the custom material, which only makes a fog thinner.
    pub fn with_material(self, row: Option<MaterialRow>) -> Self {
        Self { material: row, ..self }
    }

    /// With the planes that cut the volume.
    pub fn with_clip(self, clip: u64) -> Self {
        Self { clip, ..self }
    }

    /// The longest edge of a cell, in world units.
    pub fn cell_edge(&self) -> f64 {
        let axes = self.world_from_local.matrix3;
        [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max)
    }

    /// The corners of the occupied cells' box in the world.
    pub fn world_box(&self) -> Option<(DVec3, DVec3)> {
        let CoordBox { min, max } = self.occupied?;
        let ends = [min.as_dvec3(), max.as_dvec3() + 1.0];
        let corners = (0..8).map(|i| {
            let local = DVec3::from_array([0, 1, 2].map(|axis| ends[i >> axis & 1][axis]));
            self.world_from_local.transform_point3(local)
        });
        let (low, high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        Some(corners.fold((low, high), |(low, high), at| (low.min(at), high.max(at))))
    }
}
