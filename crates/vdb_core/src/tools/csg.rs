//! Constructive solid geometry of level sets: their pointwise minimum or maximum.

use super::ToolError;
use super::combine::{Effect, Rule, combine};
use super::grid::replaced;
use super::nodes::State;
use crate::tree::map_values;
use crate::{AnyTree, Grid};

/// How two solids are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CsgOperation {
    /// What is in either.
    Union,
    /// What is in both.
    Intersection,
    /// What is in the first, but not in the second.
    Difference,
}

/// Combines two level sets; the result has the name and the metadata of the first.
///
/// The surface is that of the combined solid. Values are distances on the side where the solids
/// agree, and bounds of them on the other, near edges where the surfaces meet:
/// [`redistance`](fn@super::redistance) makes them distances again.
///
/// # Errors
/// If a grid is not of floats, or the transforms or the backgrounds differ.
pub fn csg(a: &Grid, b: &Grid, operation: CsgOperation) -> Result<Grid, ToolError> {
    let (AnyTree::Float(first), AnyTree::Float(second)) = (&a.tree, &b.tree) else {
        return Err(ToolError::NotFloats);
    };
    if a.transform != b.transform {
        return Err(ToolError::TransformsDiffer);
    }
    let backgrounds = [first.background(), second.background()];
    if backgrounds[0] != backgrounds[1] || backgrounds[0] <= 0.0 {
        return Err(ToolError::BandsDiffer { backgrounds });
    }
    let background = backgrounds[0];
    let tree = match operation {
        CsgOperation::Union => combine(first, second, &Csg { background, union: true }),
        CsgOperation::Intersection => combine(first, second, &Csg { background, union: false }),
        CsgOperation::Difference => {
            let outside = map_values(second, |value: f32| -value);
            combine(first, &outside, &Csg { background, union: false })
        }
    };
    Ok(replaced(a, tree))
}

struct Csg {
    background: f32,
    /// Takes the minimum, otherwise the maximum.
    union: bool,
}

impl Rule for Csg {
    fn voxel(&self, a: State, b: State) -> State {
        let takes_first = if self.union { a.0 <= b.0 } else { a.0 >= b.0 };
        if takes_first { a } else { b }
    }

    /// A tile outside the band decides about all values within it.
    fn tile(&self, (value, active): State) -> Effect {
        match () {
            () if active || value.abs() != self.background => Effect::Changes,
            () if (value < 0.0) == self.union => Effect::Hides,
            () => Effect::Shows,
        }
    }
}
