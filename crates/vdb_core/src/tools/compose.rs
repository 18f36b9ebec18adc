//! Fogs as one: their sum, their maximum or their product.

use super::ToolError;
use super::combine::{Effect, Rule, combine};
use super::grid::{floats, replaced};
use super::nodes::State;
use crate::Grid;

/// How two fogs are composed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Composition {
    /// Both are there: densities add up.
    Sum,
    /// The denser one is there.
    Max,
    /// One is a mask of the other.
    Multiply,
}

/// Composes two fogs of the same voxels; the result has the name and the metadata of the first.
///
/// Every voxel, and the background, is the sum, the maximum or the product of those of both grids.
/// A voxel is active where either grid is, and where both are in a product.
///
/// # Errors
/// If a grid is not of floats, or the transforms differ.
pub fn compose(a: &Grid, b: &Grid, composition: Composition) -> Result<Grid, ToolError> {
    let (first, second) = (floats(a)?, floats(b)?);
    if a.transform != b.transform {
        return Err(ToolError::TransformsDiffer);
    }
    Ok(replaced(a, combine(first, second, &composition)))
}

/// Where there is no fog.
const NOTHING: State = (0.0, false);

impl Rule for Composition {
    fn voxel(&self, a: State, b: State) -> State {
        match self {
            Self::Sum => (a.0 + b.0, a.1 || b.1),
            // The first one where they are equal, and where one is not a number.
            Self::Max => (if b.0 > a.0 { b.0 } else { a.0 }, a.1 || b.1),
            // Whatever nothing is multiplied with, infinity or not a number.
            Self::Multiply if a == NOTHING || b == NOTHING => NOTHING,
            Self::Multiply => (a.0 * b.0, a.1 && b.1),
        }
    }

    fn tile(&self, tile: State) -> Effect {
        match self {
            Self::Sum if tile == NOTHING => Effect::Shows,
            Self::Multiply if tile == NOTHING => Effect::Hides,
            _ => Effect::Changes,
        }
    }
}
