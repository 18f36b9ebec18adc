//! Kinds of packed grids.

use crate::grid::GridClass;
use crate::tree::Vdb543;

/// The way a grid interacts with rays, which determines the lattice that is packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PackKind {
    /// Voxels below the iso-value are solid.
    Surface {
        /// The iso-value, in the units of the grid's values; 0 for a level set.
        iso: f32,
    },
    /// The surface where the trilinear interpolant passes through the iso-value.
    Smooth {
        /// The iso-value, in the units of the grid's values; 0 for a level set.
        iso: f32,
    },
    /// A density, interpolated trilinearly between samples; values that are not above zero are
    /// empty.
    Fog,
}

impl PackKind {
    /// The kind that suits a class: level sets are surfaces, and fog volumes are fog. A grid
    /// without a class is treated as a level set if its background is positive and it has negative
    /// values.
    pub fn suited(class: GridClass, tree: &Vdb543<f32>) -> Self {
        Self::suited_by(class, tree.background(), || tree.values().any(|value| value.value < 0.0))
    }

    /// The same of a tree with this background; asked only without a class, whether it has negative
    /// values.
    pub(crate) fn suited_by(
        class: GridClass,
        background: f32,
        has_negative: impl FnOnce() -> bool,
    ) -> Self {
        let level_set = match class {
            GridClass::LevelSet => true,
            GridClass::FogVolume => false,
            GridClass::Unknown | GridClass::Staggered => background > 0.0 && has_negative(),
        };
        if level_set { Self::Surface { iso: 0.0 } } else { Self::Fog }
    }

    /// The origin of lattice cell 0 in index space, on each axis.
    pub fn lattice_origin(self) -> f64 {
        match self {
            Self::Surface { .. } => -0.5,
            Self::Smooth { .. } | Self::Fog => 0.0,
        }
    }
}
