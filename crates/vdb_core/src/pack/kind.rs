//! What a grid is packed as.

use crate::grid::GridClass;
use crate::tree::Vdb543;

/// How a grid meets a ray, and so which lattice is packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PackKind {
    /// The voxels below the iso-value are solid.
    Surface {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// The surface where the trilinear interpolant passes through the iso-value.
    Smooth {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// A density, trilinear between samples; what is not above zero is empty.
    Fog,
}

impl PackKind {
    /// What suits a grid of a class: level sets are surfaces, fog volumes are fog. A grid without a class
    /// is taken for a level set if its background is above zero and its values go below.
    pub fn suited(class: GridClass, tree: &Vdb543<f32>) -> Self {
        let level_set = match class {
            GridClass::LevelSet => true,
            GridClass::FogVolume => false,
            GridClass::Unknown | GridClass::Staggered => {
                tree.background() > 0.0 && tree.values().any(|value| value.value < 0.0)
            }
        };
        if level_set { Self::Surface { iso: 0.0 } } else { Self::Fog }
    }

    /// Where lattice cell 0 begins, in index space, on each axis.
    pub fn lattice_origin(self) -> f64 {
        match self {
            Self::Surface { .. } => -0.5,
            Self::Smooth { .. } | Self::Fog => 0.0,
        }
    }
}
