//! Velocities between two frames.

use glam::{DAffine3, DMat3, DVec3};

use super::frame::{MAX_DISPLACEMENT, matrix};
use super::place::{Pair, voxel};
use super::sample::offset;
use crate::tree::{Accessor, IVec3, InternalNode, LeafNode, Vdb543};
use crate::{AnyTree, Error, Grid, GridClass};

type Upper<T> = InternalNode<InternalNode<LeafNode<[T; 3], 3>, 4>, 5>;

/// A tree of vectors.
enum Vectors<'a> {
    Single(&'a Vdb543<[f32; 3]>),
    Double(&'a Vdb543<[f64; 3]>),
}

/// Reads a tree of vectors.
enum Reader<'a> {
    Single(Accessor<'a, Upper<f32>>),
    Double(Accessor<'a, Upper<f64>>),
}

impl Reader<'_> {
    fn probe(&mut self, ijk: IVec3) -> (DVec3, bool) {
        match self {
            Self::Single(accessor) => {
                let (value, is_active) = accessor.probe(ijk);
                (DVec3::from_array(value.map(f64::from)), is_active)
            }
            Self::Double(accessor) => {
                let (value, is_active) = accessor.probe(ijk);
                (DVec3::from_array(value), is_active)
            }
        }
    }
}

/// The velocities of a frame.
struct Field<'a> {
    vectors: Vectors<'a>,
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
        let vectors = match &grid.tree {
            AnyTree::Vec3s(tree) => Vectors::Single(tree),
            AnyTree::Vec3d(tree) => Vectors::Double(tree),
            tree => {
                let what = format!(
                    "values of type {}, which are no velocities; name a grid of vectors",
                    tree.value_type()
                );
                return Err(Error::not_supported(what).in_grid(&grid.unique_name));
            }
        };
        let map = matrix(grid)?.inverse() * pair.world_from_index;
        Ok(Self { vectors, map, staggered: grid.class == GridClass::Staggered })
    }

    fn reader(&self) -> Reader<'_> {
        match self.vectors {
            Vectors::Single(tree) => Reader::Single(tree.accessor()),
            Vectors::Double(tree) => Reader::Double(tree.accessor()),
        }
    }
}

impl<'a> Flow<'a> {
    /// The flow between two frames; `scale` is in world units per unit of velocity.
    pub fn new(pair: &Pair, from: &'a Grid, to: &'a Grid, scale: f64) -> Result<Self, Error> {
        let voxels = pair.world_from_index.matrix3.inverse() * scale;
        Ok(Self { fields: [Field::new(pair, from)?, Field::new(pair, to)?], voxels })
    }

    /// Reads the flow, with velocities that are multiplied by `part`.
    pub fn sampler(&self, part: f64) -> FlowSampler<'_> {
        FlowSampler {
            readers: self.fields.each_ref().map(Field::reader),
            flow: self,
            voxels: self.voxels * part,
        }
    }
}

/// Reads a flow.
pub(super) struct FlowSampler<'a> {
    flow: &'a Flow<'a>,
    readers: [Reader<'a>; 2],
    voxels: DMat3,
}

impl FlowSampler<'_> {
    /// The displacement per frame at a point and at a time from 0 to 1, in voxels of the first
    /// frame. Where one frame has no velocities, those of the other hold: programs cut their grids
    /// off around the smoke, and its front moves out of the grid of the first frame.
    pub fn at(&mut self, p: DVec3, t: f64) -> DVec3 {
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for (i, weight) in [1.0 - t, t].into_iter().enumerate() {
            if weight > 0.0
                && let Some(velocity) = self.of_frame(i, p)
            {
                sum += weight * velocity;
                total += weight;
            }
        }
        if total == 0.0 {
            return DVec3::ZERO;
        }
        let displacement = self.voxels * (sum / total);
        // The product may not be finite, even if all factors are.
        if displacement.is_finite() {
            displacement.clamp_length_max(MAX_DISPLACEMENT)
        } else {
            DVec3::ZERO
        }
    }

    /// The velocity in a frame; `None` where its grid has none.
    fn of_frame(&mut self, i: usize, p: DVec3) -> Option<DVec3> {
        let (field, reader) = (&self.flow.fields[i], &mut self.readers[i]);
        let q = field.map.transform_point3(p);
        if !field.staggered {
            return interpolated(reader, q);
        }
        let mut component = |axis: usize| {
            let mut at = q;
            at[axis] += 0.5;
            interpolated(reader, at).map(|velocity| velocity[axis])
        };
        Some(DVec3::new(component(0)?, component(1)?, component(2)?))
    }
}

/// The linear interpolation of the active values around a point; `None` if there are none. Weights
/// of inactive ones are left out, so that smoke at the border of a velocity grid that is cut off
/// there moves along with the rest.
fn interpolated(reader: &mut Reader, p: DVec3) -> Option<DVec3> {
    let cell = p.floor();
    let (u, base) = (p - cell, voxel(cell));
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for corner in 0..8 {
        let at = IVec3::new(corner >> 2, corner >> 1 & 1, corner & 1);
        let weight = |axis: usize| if at[axis] == 1 { u[axis] } else { 1.0 - u[axis] };
        let weight = weight(0) * weight(1) * weight(2);
        if weight > 0.0
            && let (value, true) = reader.probe(offset(base, at))
        {
            sum += weight * DVec3::select(value.is_finite_mask(), value, DVec3::ZERO);
            total += weight;
        }
    }
    (total > 0.0).then(|| sum / total)
}
