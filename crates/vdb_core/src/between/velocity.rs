//! Velocities between two frames.

use std::borrow::Cow;

use glam::{DAffine3, DMat3, DVec3};

use super::place::{Pair, voxel};
use super::sample::offset;
use super::{MAX_DISPLACEMENT, matrix};
use crate::tree::{Accessor, IVec3, InternalNode, LeafNode, Vdb543, map_values};
use crate::{AnyTree, Error, Grid, GridClass};

type Upper = InternalNode<InternalNode<LeafNode<[f32; 3], 3>, 4>, 5>;

/// The velocities of a frame.
struct Field<'a> {
    tree: Cow<'a, Vdb543<[f32; 3]>>,
    /// From the index space of the first frame's values.
    map: DAffine3,
    staggered: bool,
}

/// Velocities that change linearly in time from one frame to the next.
pub(super) struct Flow<'a> {
    fields: [Field<'a>; 2],
    /// From velocities to voxels of the first frame, from frame to frame.
    voxels: DMat3,
}

impl<'a> Field<'a> {
    fn new(pair: &Pair, grid: &'a Grid) -> Result<Self, Error> {
        let tree = match &grid.tree {
            AnyTree::Vec3s(tree) => Cow::Borrowed(&**tree),
            AnyTree::Vec3d(tree) => {
                Cow::Owned(map_values(tree, |value| value.map(|component| component as f32)))
            }
            tree => {
                let what = format!(
                    "values of type {}, which are no velocities; name a grid of vectors",
                    tree.value_type()
                );
                return Err(Error::not_supported(what).in_grid(&grid.unique_name));
            }
        };
        let map = matrix(grid)?.inverse() * pair.world_from_index;
        Ok(Self { tree, map, staggered: grid.class == GridClass::Staggered })
    }
}

impl<'a> Flow<'a> {
    /// The flow between two frames; `scale` is in world units per unit of velocity.
    pub fn new(pair: &Pair, from: &'a Grid, to: &'a Grid, scale: f64) -> Result<Self, Error> {
        let voxels = pair.world_from_index.matrix3.inverse() * scale;
        Ok(Self { fields: [Field::new(pair, from)?, Field::new(pair, to)?], voxels })
    }

    /// The same flow with another scale, relative to this one's.
    pub fn sampler(&self, part: f64) -> FlowSampler<'_> {
        FlowSampler {
            accessors: [0, 1].map(|i| self.fields[i].tree.accessor()),
            flow: self,
            voxels: self.voxels * part,
        }
    }
}

/// Reads a flow.
pub(super) struct FlowSampler<'a> {
    flow: &'a Flow<'a>,
    accessors: [Accessor<'a, Upper>; 2],
    voxels: DMat3,
}

impl FlowSampler<'_> {
    /// The displacement per frame at a point and at a time from 0 to 1, in voxels of the first
    /// frame.
    pub fn at(&mut self, p: DVec3, t: f64) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for (i, weight) in [1.0 - t, t].into_iter().enumerate() {
            if weight > 0.0 {
                sum += weight * self.of_frame(i, p);
            }
        }
        let displacement = self.voxels * sum;
        // Also for components that are finite, the product may not be.
        if displacement.is_finite() {
            displacement.clamp_length_max(MAX_DISPLACEMENT)
        } else {
            DVec3::ZERO
        }
    }

    fn of_frame(&mut self, i: usize, p: DVec3) -> DVec3 {
        let (field, accessor) = (&self.flow.fields[i], &mut self.accessors[i]);
        let q = field.map.transform_point3(p);
        if !field.staggered {
            return interpolated(accessor, q);
        }
        DVec3::from_array([0, 1, 2].map(|axis| {
            let mut at = q;
            at[axis] += 0.5;
            interpolated(accessor, at)[axis]
        }))
    }
}

/// The linear interpolation of the active values around a point; zero if there are none. Weights of
/// inactive ones are left out, so that smoke at the border of a velocity grid that is cut off there
/// moves along with the rest.
fn interpolated(accessor: &mut Accessor<Upper>, p: DVec3) -> DVec3 {
    let cell = p.floor();
    let (u, base) = (p - cell, voxel(cell));
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for corner in 0..8 {
        let at = IVec3::new(corner >> 2, corner >> 1 & 1, corner & 1);
        let weight = |axis: usize| if at[axis] == 1 { u[axis] } else { 1.0 - u[axis] };
        let weight = weight(0) * weight(1) * weight(2);
        if weight > 0.0
            && let (value, true) = accessor.probe(offset(base, at))
        {
            let sound = value.map(|c| if c.is_finite() { f64::from(c) } else { 0.0 });
            sum += weight * DVec3::from_array(sound);
            total += weight;
        }
    }
    if total > 0.0 { sum / total } else { DVec3::ZERO }
}
