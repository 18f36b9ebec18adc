//! Checks of the input, before any memory is taken.

use glam::DVec3;

use super::close::Mesh;
use crate::tools::ToolError;
use crate::tools::nodes::Leaf;
use crate::{Limits, Transform};

/// The farthest coordinate, in voxels. Coordinates of voxels have 32 bits.
const FARTHEST: f64 = (1_u32 << 30) as f64;

/// Checks that there are triangles: first, because without any there is no size to make voxels of.
pub(crate) fn any(triangles: &[[u32; 3]]) -> Result<(), ToolError> {
    if triangles.is_empty() { Err(ToolError::NoTriangles) } else { Ok(()) }
}

/// The transform of voxels of a size.
pub(crate) fn transform(voxel_size: f64) -> Result<Transform, ToolError> {
    // The values of the band must be floats with full precision.
    let representable = (f64::from(f32::MIN_POSITIVE)..1e36).contains(&voxel_size);
    let transform = Transform::uniform(voxel_size, DVec3::ZERO).filter(|_| representable);
    transform.ok_or(ToolError::BadSetting {
        setting: "the voxel size",
        value: voxel_size,
        range: "a positive number from 1.2e-38 to 1e36",
    })
}

/// The half width of the band, in voxels.
pub(crate) fn half_width(half_width: f32) -> Result<f64, ToolError> {
    let value = f64::from(half_width);
    if (1.0..=100.0).contains(&value) {
        return Ok(value);
    }
    let (setting, range) = ("the half width of the band", "from 1 to 100 voxels");
    Err(ToolError::BadSetting { setting, value, range })
}

/// The positions in voxels. Only those that triangles refer to are checked, the others are zero.
pub(super) fn points(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    voxel_size: f64,
) -> Result<Vec<DVec3>, ToolError> {
    let vertices = positions.len();
    let mut is_used = vec![false; vertices];
    for (triangle, corners) in triangles.iter().enumerate() {
        for &vertex in corners {
            let used = is_used.get_mut(vertex as usize);
            *used.ok_or(ToolError::NoSuchVertex { triangle, vertex, vertices })? = true;
        }
    }
    let point = |(vertex, (&position, is_used)): (usize, (&[f32; 3], bool))| {
        let point = DVec3::from(position.map(f64::from)) / voxel_size;
        let voxels = point.abs().max_element();
        match is_used {
            false => Ok(DVec3::ZERO),
            true if !position.iter().all(|c| c.is_finite()) => {
                Err(ToolError::NotFinite { vertex, position })
            }
            true if voxels > FARTHEST => Err(ToolError::TooFar { vertex, voxels, limit: FARTHEST }),
            true => Ok(point),
        }
    };
    positions.iter().zip(is_used).enumerate().map(point).collect()
}

/// An estimate of the active voxels; an error if their leaves exceed the limit.
///
/// A plane cuts at most 8² · √3 unit squares out of a leaf, so a surface passes through at least its
/// area divided by that many leaves, if it does not overlap itself.
pub(super) fn check_size(mesh: &Mesh, half_width: f64, limits: &Limits) -> Result<f64, ToolError> {
    let (mut area, mut longest) = (0.0_f64, 0.0_f64);
    for triangle in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(triangle);
        area += (b - a).cross(c - a).length() / 2.0;
        longest = longest.max((a.max(b).max(c) - a.min(b).min(c)).max_element());
    }
    let voxels = area * 2.0 * half_width;
    let leaves = (area / (64.0 * 3.0_f64.sqrt())).max(longest / 8.0);
    let limit = limits.tree_bytes;
    if leaves * size_of::<Leaf>() as f64 > limit as f64 {
        let voxels = voxels.max(longest * half_width * half_width * std::f64::consts::PI);
        return Err(ToolError::TooManyVoxels { voxels, limit });
    }
    Ok(voxels)
}
