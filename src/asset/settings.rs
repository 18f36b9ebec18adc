//! How files are loaded.

use serde::{Deserialize, Serialize};
use vdb_core::Limits;
use vdb_core::pack::ValueFormat;

/// How a `.vdb` file is loaded; for `asset_server.load_builder().with_settings(…)` or a `.meta`
/// file. What is left out there has its default:
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
    /// Names of the grids to load; the others are not even decompressed. `None`: all.
    pub grids: Option<Vec<String>>,
    /// Level sets: how much of the narrow band to keep on each side of the surface, in voxels; the
    /// rest costs memory and shows nothing. At least 2. `None`: all that the file has.
    pub half_width: Option<f32>,
    /// Whether grids are surfaces or fog.
    pub render_as: VdbRenderAs,
    /// Whether surfaces are smooth, where the trilinear interpolant passes through the iso-value, on by
    /// default. Otherwise they are made of voxels, and only bits of them are on the GPU: less than half
    /// the time and a fifth of the memory.
    pub smooth: bool,
    /// In how many bits the GPU gets the samples of fog and of smooth surfaces.
    pub values: VdbValues,
    /// What the file may ask of the machine before loading it is given up. The defaults protect a desktop with
    /// 8 GB of memory; raise them for files that are larger and to be trusted.
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
            limits: Limits::default(),
        }
    }
}

/// In how many bits the GPU has samples; what each costs and loses is in `docs/benchmarks.md`. A surface
/// of voxels has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum VdbValues {
    /// As the file has them: in 16 bits where that loses nothing, as for files that were saved so, else
    /// in 32.
    #[default]
    Exact,
    /// Floats of 16 bits: relative errors of 2⁻¹² at most.
    Half,
    /// Bytes. Of fog, 255 steps from the least to the largest density of each leaf of 8³ voxels; of a
    /// smooth surface, steps of 1/127 of the largest distance that a cell on it has (about √3 voxels),
    /// such that no sign changes: the surface keeps its holes and gets no new ones.
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

/// Whether grids are shown as surfaces or as fog.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum VdbRenderAs {
    /// As their class says: level sets are surfaces, fog volumes are fog. A grid without a class is
    /// taken for a level set if its background is above zero and its values go below.
    #[default]
    Auto,
    /// Surfaces at this iso-value: what is below it is solid.
    Surface {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// Fog: the values are densities.
    Fog,
}
