//! Bevy's meshes to level sets, and back.

use bevy::asset::RenderAssetUsages;
use bevy::mesh::{Indices, PrimitiveTopology, VertexAttributeValues};
use bevy::prelude::*;
use bevy_vdb::{VdbGrid, VdbMeshError};
use vdb_core::tools::{LevelSetToMesh, MeshToLevelSet, ToolError};

const VOXEL: f64 = 0.05;

fn made(mesh: &Mesh) -> Result<VdbGrid, VdbMeshError> {
    VdbGrid::from_mesh(mesh, &MeshToLevelSet::new(VOXEL))
}

/// The distance at a point that is the place of a voxel.
fn distance(grid: &VdbGrid, at: Vec3) -> f32 {
    let voxel = (at.as_dvec3() / VOXEL).round().as_ivec3();
    grid.tree().unwrap().get(voxel)
}

fn triangles(topology: PrimitiveTopology, positions: Vec<[f32; 3]>) -> Mesh {
    Mesh::new(topology, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
}

#[test]
fn a_sphere_of_triangles_is_a_sphere_of_distances() {
    let grid = made(&Sphere::new(1.0).mesh().uv(256, 128)).unwrap();
    for (at, expected) in [
        (Vec3::X * 1.1, 0.1),
        (Vec3::Y * 0.95, -0.05),
        (Vec3::new(-0.6, 0.0, 0.8), 0.0),
        (Vec3::ZERO, -0.15),
        (Vec3::ONE * 2.0, 0.15),
    ] {
        let found = distance(&grid, at);
        assert!((found - expected).abs() < 1e-3, "{found} instead of {expected} at {at}");
    }
}

/// The vertices of a cuboid's faces are its own: only their positions are common.
#[test]
fn split_vertices_leave_no_holes() {
    let grid = made(&Cuboid::from_length(2.0).into()).unwrap();
    assert!((distance(&grid, Vec3::ZERO) + 0.15).abs() < 1e-6);
    assert!((distance(&grid, Vec3::new(1.1, 0.0, 0.0)) - 0.1).abs() < 1e-5);
}

#[test]
fn all_forms_of_triangles_give_the_same_grid() {
    let corners = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]];
    let listed = [0_u32, 1, 2, 2, 1, 3, 2, 3, 0, 1, 0, 3];
    let list = triangles(PrimitiveTopology::TriangleList, corners.to_vec());
    let forms = [
        list.clone().with_inserted_indices(Indices::U32(listed.to_vec())),
        list.with_inserted_indices(Indices::U16(listed.map(|i| i as u16).to_vec())),
        triangles(
            PrimitiveTopology::TriangleList,
            listed.iter().map(|&i| corners[i as usize]).collect(),
        ),
        triangles(PrimitiveTopology::TriangleStrip, corners.to_vec())
            .with_inserted_indices(Indices::U16(vec![0, 1, 2, 3, 0, 1])),
    ];
    let grids = forms.map(|mesh| made(&mesh).unwrap());
    let points = (0..40 * 40 * 40).map(|i| IVec3::new(i / 1600, i / 40 % 40, i % 40));
    for at in points {
        let values = grids.each_ref().map(|grid| grid.tree().unwrap().get(at));
        assert!(values.iter().all(|value| *value == values[0]), "{values:?} at {at}");
    }
    assert!(distance(&grids[0], Vec3::splat(0.3)) < 0.0);
}

#[test]
fn a_mesh_of_a_grid_has_its_surface() {
    let grid = made(&Sphere::new(1.0).mesh().uv(256, 128)).unwrap();
    let mesh = grid.to_mesh(&LevelSetToMesh::default()).unwrap();
    let of = |attribute| match mesh.attribute(attribute) {
        Some(VertexAttributeValues::Float32x3(all)) => all.iter().copied().map(Vec3::from),
        other => panic!("{other:?}"),
    };
    let vertices = of(Mesh::ATTRIBUTE_POSITION).zip(of(Mesh::ATTRIBUTE_NORMAL));
    assert!(vertices.len() > 1000);
    for (position, normal) in vertices {
        assert!((position.length() - 1.0).abs() < 2e-3, "{position}");
        assert!(normal.dot(position) > 0.98, "{normal} at {position}");
    }
    let again = made(&mesh).unwrap();
    assert!((distance(&again, Vec3::X * 1.1) - 0.1).abs() < 3e-3);
}

#[test]
fn what_has_no_surface_is_refused() {
    let error = |mesh: Mesh| made(&mesh).unwrap_err();
    let corners = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let lines = triangles(PrimitiveTopology::LineList, corners.clone());
    assert!(matches!(error(lines), VdbMeshError::Topology(PrimitiveTopology::LineList)));
    let bare = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default());
    assert!(matches!(error(bare), VdbMeshError::Access(_)));
    let none = triangles(PrimitiveTopology::TriangleList, vec![]);
    assert!(matches!(error(none), VdbMeshError::Tool(ToolError::NoTriangles)));
    let mesh = triangles(PrimitiveTopology::TriangleList, corners.clone());
    let beyond = mesh.with_inserted_indices(Indices::U32(vec![0, 1, 3]));
    assert!(matches!(error(beyond), VdbMeshError::Tool(ToolError::NoSuchVertex { vertex: 3, .. })));
    let mut wrong = corners;
    wrong[1][0] = f32::NAN;
    let wrong = triangles(PrimitiveTopology::TriangleList, wrong);
    assert!(matches!(error(wrong), VdbMeshError::Tool(ToolError::NotFinite { vertex: 1, .. })));
}
