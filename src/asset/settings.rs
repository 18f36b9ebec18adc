//! Settings of the loaders.

use serde::{Deserialize, Serialize};
use vdb_core::Limits;
use vdb_core::pack::ValueFormat;

/// Settings for loading a `.vdb` file, for `asset_server.load_builder().with_settings(…)` or a
/// `.meta` file. Settings left out of a `.meta` file keep their defaults:
///
/// ```ron
/// (
///     meta_format_version: "1.0",
///     asset: Load(
///         loader: "bevy_vdb::VdbLoader",
///         settings: (
///             grids: Some(["density"]),
///             limits: (file_bytes: 8_000_000_000, tree_bytes: 24_000_000_000),
///         ),
///     ),
/// )
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct VdbLoaderSettings {
    /// The names of the grids to load; others are not decompressed. `None` loads all.
    pub grids: Option<Vec<String>>,
    /// The width of the narrow band to keep on each side of a level set, in voxels. The rest costs
    /// memory and is never visible. At least 2. `None` keeps everything in the file.
    pub half_width: Option<f32>,
    /// Whether grids are surfaces or fog.
    pub render_as: VdbRenderAs,
    /// Whether surfaces follow the trilinear interpolant. On by default. Otherwise they consist of
    /// voxels, for which the GPU holds only occupancy bits. This takes less than half the time and a
    /// fifth of the memory.
    pub smooth: bool,
    /// The sample format of fog and smooth surfaces on the GPU.
    pub values: VdbValues,
    /// Whether points are displayed: as fog or as balls. By default, they are left out.
    pub points: VdbPoints,
    /// The edge of a voxel in the volumes of points, in world units. `None` takes that of the points' own
    /// grid, which programs choose for the number of points in it: it may be coarse.
    pub point_voxel_size: Option<f32>,
    /// The radius of points in world units. `None` takes each point's attribute `pscale` or, without
    /// it, the edge of a voxel.
    pub point_radius: Option<f32>,
    /// The resources that a file may demand before loading is aborted. The defaults protect a
    /// desktop with 8 GB of memory; raise them for larger files that you trust.
    pub limits: Limits,
}

impl Default for VdbLoaderSettings {
    fn default() -> Self {
        Self {
            grids: None,
            half_width: None,
            render_as: VdbRenderAs::Auto,
            smooth: true,
            values: VdbValues::Exact,
            points: VdbPoints::Skip,
            point_voxel_size: None,
            point_radius: None,
            limits: Limits::default(),
        }
    }
}

/// The sample format on the GPU. `docs/reference/benchmarks.md` has the cost and loss of each
/// format. A surface of voxels has no samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum VdbValues {
    /// Lossless: 16-bit floats where they represent all values exactly, as in files saved with half
    /// floats; otherwise 32-bit floats.
    #[default]
    Exact,
    /// 16-bit floats: relative errors of at most 2⁻¹¹.
    Half,
    /// Bytes. For fog, 255 steps from the smallest to the largest density in each leaf of 8³
    /// voxels. For a smooth surface, steps of 1/127 of the largest distance in a surface cell
    /// (about √3 voxels), rounded so that no sign changes: the surface keeps its holes and gets no
    /// new ones.
    Byte,
}

impl From<VdbValues> for ValueFormat {
    fn from(values: VdbValues) -> Self {
        match values {
            VdbValues::Exact => Self::Exact,
            VdbValues::Half => Self::Half,
            VdbValues::Byte => Self::Byte,
        }
    }
}

/// Whether grids are displayed as surfaces or as fog.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum VdbRenderAs {
    /// Decided by the class: level sets are surfaces, fog volumes are fog. A grid without a class
    /// is a level set if its background is positive and some of its values are negative.
    #[default]
    Auto,
    /// Surfaces at this iso-value; values below it are solid.
    Surface {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// Fog: values are densities.
    Fog,
}

/// Whether the points of a file are displayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum VdbPoints {
    /// They are left out, which a message reports.
    #[default]
    Skip,
    /// As fog, with a mean density of 1 in each point.
    Fog,
    /// As surfaces: each point is a ball.
    Balls,
}
