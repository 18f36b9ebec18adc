//! Level sets to triangles, by marching cubes (W. E. Lorensen and H. E. Cline, "Marching Cubes: A
//! High Resolution 3D Surface Construction Algorithm", SIGGRAPH 1987).
//!
//! Its vertices are roots of the trilinear interpolant, on the edges of cells: they lie on the very
//! surface that rays hit. Dual methods have one vertex per cell, near that surface, and need further
//! rules where a cell has two sheets. The cases here make a closed manifold of any tree (`cases`).

mod block;
mod blocks;
mod cases;

use std::collections::HashMap;
use std::sync::Arc;

use glam::DMat3;
use rayon::prelude::*;

use super::ToolError;
use crate::tree::{IVec3, Vdb543};
use crate::work::{Work, debug_options};
use crate::{Limits, ProgressFn, Transform};
use block::{Block, Placement};

/// A closed surface made of triangles, in world space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// The vertices.
    pub positions: Vec<[f32; 3]>,
    /// Normals of unit length at the vertices, towards the outside; zero where the field is flat.
    pub normals: Vec<[f32; 3]>,
    /// Triangles as indices of vertices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Options of [`level_set_to_mesh`].
#[derive(Clone, Default)]
pub struct LevelSetToMesh {
    /// The value at the surface: 0 for level sets.
    pub iso: f32,
    /// Whether greater values are inside, as in fog. In level sets, smaller ones are.
    pub inside_is_above: bool,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

debug_options!(LevelSetToMesh { iso, inside_is_above, limits });

/// Makes triangles of the surface on which the values of a tree, trilinearly interpolated, are
/// [`LevelSetToMesh::iso`].
///
/// The mesh is watertight and manifold, whatever the values: each edge has two triangles, which
/// pass it in opposite directions. Vertices are on the lines between neighbouring voxels, exactly
/// where the value is `iso`; normals are gradients there. A mesh of nothing is empty.
///
/// # Errors
/// If `iso` is not finite, the transform is not linear, the mesh would exceed the limits or 2³²
/// vertices, or if it was cancelled.
pub fn level_set_to_mesh(
    tree: &Vdb543<f32>,
    transform: &Transform,
    options: &LevelSetToMesh,
) -> Result<TriangleMesh, ToolError> {
    let iso = options.iso;
    if !iso.is_finite() {
        let (setting, range) = ("the value at the surface", "finite");
        return Err(ToolError::BadSetting { setting, value: iso.into(), range });
    }
    let world_from_index = transform.linear().ok_or(ToolError::NotLinear)?;
    let matrix = world_from_index.matrix3;
    let placement = Placement {
        transform,
        normal_from_gradient: matrix.inverse().transpose() * outwards(options.inside_is_above),
        iso,
        flip: (matrix.determinant() < 0.0) != options.inside_is_above,
    };
    let origins = blocks::near_surface(tree, iso);
    let steps = 2 * origins.len() as u64;
    let work = Work::new(options.progress.as_ref(), steps, options.limits.tree_bytes);
    let stopped = |stop| ToolError::stopped(stop, 0.0);

    let blocks: Vec<Block> = origins
        .into_par_iter()
        .enumerate()
        .filter_map(|(i, origin)| {
            let block = Block::new(tree, origin, &placement)?;
            let checked = work.take(block.bytes()).and_then(|()| match i % 256 {
                0 => work.report(i as u64),
                _ => Ok(()),
            });
            Some(checked.map(|()| block))
        })
        .collect::<Result<_, _>>()
        .map_err(stopped)?;

    let mut starts = Vec::with_capacity(blocks.len());
    let mut count = 0_u64;
    for block in &blocks {
        starts.push(count as u32);
        count += block.positions.len() as u64;
    }
    if count > u32::MAX.into() {
        return Err(ToolError::TooManyVertices { vertices: count });
    }
    let by_origin: HashMap<IVec3, usize> =
        blocks.iter().enumerate().map(|(i, block)| (block.origin, i)).collect();
    let triangles = blocks
        .par_iter()
        .flat_map_iter(|block| {
            let neighbour = |offset: IVec3| {
                let found = by_origin.get(&block.origin.wrapping_add(offset * 8));
                found.map(|&i| (&blocks[i], starts[i]))
            };
            block.triangles(neighbour, placement.flip)
        })
        .collect();
    let positions = blocks.iter().flat_map(|block| block.positions.iter().copied()).collect();
    let normals = blocks.iter().flat_map(|block| block.normals.iter().copied()).collect();
    work.finish().map_err(stopped)?;
    Ok(TriangleMesh { positions, normals, triangles })
}

/// The direction of normals along the gradient.
fn outwards(inside_is_above: bool) -> DMat3 {
    DMat3::from_diagonal(glam::DVec3::splat(if inside_is_above { -1.0 } else { 1.0 }))
}
