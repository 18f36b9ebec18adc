//! Errors, transforms, bounds and paths shared by several kinds of assets.

use std::io;

use bevy::asset::io::Reader;
use bevy::asset::{AssetPath, AsyncReadExt};
use bevy::math::{BVec3, DAffine3, DVec3};
use thiserror::Error;
use vdb_core::display::escaped;
use vdb_core::pack::{PackError, PackedGrid};
use vdb_core::{AnyTree, GridClass, Metadata, Transform};

/// Why a grid cannot be made, changed or saved.
#[derive(Clone, Debug, Error)]
#[non_exhaustive]
pub enum VdbGridError {
    /// The transform is not linear or cannot be inverted.
    #[error("{0}")]
    Transform(String),
    /// The values are neither floats nor vectors of floats.
    #[error(
        "grids of type {} cannot be shown; only Tree_float_5_4_3 and Tree_vec3s_5_4_3 can",
        escaped(.0)
    )]
    Type(String),
    /// The grid does not fit the GPU's layout, or exceeds a limit.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// The grid with this name is cooked: it has no tree.
    #[error(
        "grid '{0}' is cooked, so its voxels cannot be changed or saved; load the `.vdb` file that \
         it was made of"
    )]
    Cooked(String),
    /// The grid could not be saved.
    #[error(transparent)]
    Save(#[from] vdb_core::Error),
}

/// Converts to a `vdb_core` grid.
pub(crate) fn core_grid(
    name: &str,
    class: GridClass,
    world_from_index: DAffine3,
    metadata: &Metadata,
    tree: AnyTree,
) -> vdb_core::Grid {
    let mut grid = vdb_core::Grid::new(name, tree);
    grid.class = class;
    grid.metadata = metadata.clone();
    // `check_transform` has made sure that the transform is valid.
    grid.transform = Transform::affine(world_from_index).unwrap_or_default();
    grid
}

/// The transform from index space to the world, if it is linear.
pub(crate) fn linear(transform: &Transform) -> Result<DAffine3, VdbGridError> {
    transform.linear().ok_or_else(|| {
        VdbGridError::Transform(format!(
            "a transform of type {} cannot be shown; export the grid with a linear transform",
            transform.map_type()
        ))
    })
}

/// Checks that a transform can place a grid.
pub(crate) fn check_transform(world_from_index: DAffine3) -> Result<(), VdbGridError> {
    let can_be_saved = Transform::affine(world_from_index).is_some();
    let inverse = world_from_index.inverse();
    if !can_be_saved || !inverse.is_finite() || !world_from_index.is_finite() {
        return Err(VdbGridError::Transform(format!(
            "the transform from index space to the world, {world_from_index}, cannot be inverted"
        )));
    }
    Ok(())
}

/// The corners of a box.
pub(crate) fn corners((low, high): (DVec3, DVec3)) -> impl Iterator<Item = DVec3> + Clone {
    (0..8).map(move |i: usize| {
        DVec3::select(BVec3::new(i & 1 != 0, i & 2 != 0, i & 4 != 0), high, low)
    })
}

/// The bounds of everything visible in a packed grid, in index space.
pub(crate) fn index_bounds(packed: &PackedGrid) -> Option<(DVec3, DVec3)> {
    let cells = packed.occupied?;
    let base = packed.base.as_dvec3() + packed.kind.lattice_origin();
    Some((cells.min.as_dvec3() + base, cells.max.as_dvec3() + base + 1.0))
}

/// The bounds of everything visible in a packed grid, in the file's world.
pub(crate) fn world_bounds(
    packed: &PackedGrid,
    world_from_index: DAffine3,
) -> Option<(DVec3, DVec3)> {
    Some(bounds_of(corners(index_bounds(packed)?).map(|at| world_from_index.transform_point3(at))))
}

/// The low and the high corner of the box around some points.
pub(crate) fn bounds_of(points: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    points
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
}

/// The bytes of a file, or `most` of them and at least one more.
pub(crate) async fn read_at_most(reader: &mut dyn Reader, most: u64) -> io::Result<Vec<u8>> {
    let (mut bytes, mut part) = (Vec::new(), vec![0; 1 << 16]);
    while bytes.len() as u64 <= most {
        let count = reader.read(&mut part).await?;
        let Some(read) = part.get(..count).filter(|read| !read.is_empty()) else { break };
        bytes.extend_from_slice(read);
    }
    Ok(bytes)
}

/// The path of a file in a folder. Unlike `AssetPath::resolve`, this does not interpret `#` and `..`.
pub(crate) fn within(folder: &AssetPath<'static>, name: &str) -> AssetPath<'static> {
    AssetPath::from_path_buf(folder.path().join(name)).with_source(folder.source().clone_owned())
}
