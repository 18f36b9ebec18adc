//! Meshes to level sets, and back.

use std::sync::Arc;

use bevy::asset::RenderAssetUsages;
use bevy::mesh::{Indices, MeshAccessError, PrimitiveTopology, VertexAttributeValues};
use bevy::prelude::*;
use thiserror::Error;
use vdb_core::pack::PackKind;
use vdb_core::tools::{
    LevelSetToMesh, MeshToLevelSet, ToolError, level_set_to_mesh, mesh_to_level_set,
};
use vdb_core::{AnyTree, Transform};

use super::common::{VdbGridError, linear};
use super::grid::VdbGrid;

/// Why a mesh cannot be made into a grid, or a grid into a mesh.
#[derive(Clone, Debug, Error)]
#[non_exhaustive]
pub enum VdbMeshError {
    /// The mesh consists of points or lines.
    #[error("the mesh has the topology {0:?}, which has no surface; it must consist of triangles")]
    Topology(PrimitiveTopology),
    /// The mesh has no positions, or its data has been moved to the GPU.
    #[error(
        "the vertices of the mesh cannot be read: {0}; load it with `RenderAssetUsages::MAIN_WORLD`"
    )]
    Access(#[from] MeshAccessError),
    /// The positions are not three 32-bit floats each.
    #[error("the positions of the mesh are not of the format Float32x3")]
    Positions,
    /// The triangles or an option are invalid, or the result would exceed the limits.
    #[error(transparent)]
    Tool(#[from] ToolError),
    /// The grid cannot be shown, or has no tree.
    #[error(transparent)]
    Grid(#[from] VdbGridError),
}

impl VdbGrid {
    /// Makes a level set of the triangles of a mesh: a smooth surface in the place of the mesh.
    ///
    /// The mesh need not be clean: holes are closed, and triangles may overlap or be flipped; see
    /// [`mesh_to_level_set`]. Vertices with the same position count as one.
    ///
    /// This takes from milliseconds to seconds: call it in a task for more than a few hundred voxels
    /// along an edge.
    ///
    /// # Errors
    /// If the mesh has no triangles or cannot be read, a vertex is not finite or too far away, an
    /// option is out of its range, or the level set would exceed the limits.
    ///
    /// ```
    /// use bevy::prelude::*;
    /// use bevy_vdb::VdbGrid;
    /// use bevy_vdb::vdb_core::tools::MeshToLevelSet;
    ///
    /// let mesh = Mesh::from(Torus::new(0.5, 1.0));
    /// let grid = VdbGrid::from_mesh(&mesh, &MeshToLevelSet::new(0.02))?;
    /// assert!(grid.world_bounds().is_some());
    /// # Ok::<(), bevy_vdb::VdbMeshError>(())
    /// ```
    pub fn from_mesh(mesh: &Mesh, options: &MeshToLevelSet) -> Result<Self, VdbMeshError> {
        let positions = mesh.try_attribute(Mesh::ATTRIBUTE_POSITION)?;
        let VertexAttributeValues::Float32x3(positions) = positions else {
            return Err(VdbMeshError::Positions);
        };
        let triangles = triangles(mesh, positions.len())?;
        let made = mesh_to_level_set(positions, &triangles, options)?;
        let world_from_index = linear(&made.transform)?;
        let AnyTree::Float(tree) = made.tree else { unreachable!("a level set holds floats") };
        let kind = PackKind::Smooth { iso: 0.0 };
        let grid = Self::new(made.name, Arc::unwrap_or_clone(tree), world_from_index, kind)?;
        Ok(grid.with_limits(options.limits.clone()))
    }

    /// Makes a mesh of the surface of the grid, with normals: for colliders, navigation or export.
    /// It is in the local space of the entity that shows the grid.
    ///
    /// For fog, set [`LevelSetToMesh::inside_is_above`] and a density as [`LevelSetToMesh::iso`].
    ///
    /// # Errors
    /// If an option is out of its range, the mesh would exceed the limits, or the grid is
    /// [cooked](VdbGrid::tree).
    pub fn to_mesh(&self, options: &LevelSetToMesh) -> Result<Mesh, VdbMeshError> {
        let tree = self.tree().ok_or_else(|| self.is_cooked())?;
        let transform = Transform::affine(self.world_from_index()).unwrap_or_default();
        let made = level_set_to_mesh(tree, &transform, options)?;
        let indices = made.triangles.into_flattened();
        let usages = RenderAssetUsages::default();
        Ok(Mesh::new(PrimitiveTopology::TriangleList, usages)
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, made.positions)
            .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, made.normals)
            .with_inserted_indices(Indices::U32(indices)))
    }
}

/// The triangles of a mesh, as indices of its vertices, counter-clockwise.
fn triangles(mesh: &Mesh, vertices: usize) -> Result<Vec<[u32; 3]>, VdbMeshError> {
    let topology = mesh.primitive_topology();
    let indices: Vec<u32> = match mesh.try_indices_option()? {
        Some(Indices::U32(indices)) => indices.clone(),
        Some(Indices::U16(indices)) => indices.iter().copied().map(u32::from).collect(),
        None => (0..vertices as u32).collect(),
    };
    match topology {
        PrimitiveTopology::TriangleList => Ok(indices.as_chunks().0.to_vec()),
        PrimitiveTopology::TriangleStrip => {
            // Every other triangle of a strip runs the other way.
            let turned = |(i, window): (usize, &[u32])| match (window, i % 2) {
                (&[a, b, c], 0) => Some([a, b, c]),
                (&[a, b, c], _) => Some([b, a, c]),
                _ => None,
            };
            Ok(indices.windows(3).enumerate().filter_map(turned).collect())
        }
        PrimitiveTopology::PointList
        | PrimitiveTopology::LineList
        | PrimitiveTopology::LineStrip => Err(VdbMeshError::Topology(topology)),
    }
}
