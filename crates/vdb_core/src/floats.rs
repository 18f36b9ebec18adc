//! Conversion of grids of other types to floats, which is what can be packed and displayed.

use std::fmt;
use std::sync::Arc;

use crate::display::quoted;
use crate::format::budget::Budget;
use crate::format::topology::{Upper, internal_bytes};
use crate::tree::{BitLeaf, BitValues, LeafNode, Node, Tree, Value, Vdb543, map_bits, map_values};
use crate::{AnyTree, Error, Limits, SkippedGrid, VdbFile};

/// A grid whose values were converted to floats, and what that changed.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvertedGrid {
    /// The unique name of the grid.
    pub grid: String,
    /// The type of its values before, as OpenVDB spells it: `double`, `vec3i`, …
    pub value_type: &'static str,
    /// Values, of voxels and tiles, that are no longer the same number.
    pub changed: u64,
    /// The largest relative error of any of their components: at most 2⁻²⁴, about 6·10⁻⁸, if all
    /// lie in the range of floats. A number beyond it becomes the largest float, and one that is too
    /// small zero; their error is close to 1.
    pub largest_error: f64,
}

impl fmt::Display for ConvertedGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, value_type) = (quoted(&self.grid), self.value_type);
        write!(f, "grid {name} of type {value_type} is shown as floats")?;
        match self.changed {
            0 => f.write_str(", which have the same values"),
            changed => write!(
                f,
                ", which changes {changed} values, by up to {:.1e} of their size",
                self.largest_error
            ),
        }
    }
}

impl VdbFile {
    /// Converts grids of doubles, integers, booleans and masks to floats, and grids of vectors of
    /// doubles and integers to vectors of floats. True and active become 1, false and inactive 0.
    /// Grids that share a tree still do.
    ///
    /// Returns what was converted. A grid whose converted tree would exceed the limits is moved to
    /// [`VdbFile::skipped`].
    pub fn convert_to_floats(&mut self, limits: &Limits) -> Vec<ConvertedGrid> {
        let mut budget = Budget::new(limits);
        let mut converted = Vec::new();
        // By the tree before, so that instances are converted once.
        let mut done: Vec<(AnyTree, AnyTree, ConvertedGrid)> = Vec::new();
        for mut grid in std::mem::take(&mut self.grids) {
            let shared = done.iter().find(|(before, ..)| before.shares_with(&grid.tree));
            let result = match shared {
                Some((_, tree, report)) => Ok(Some((tree.clone(), report.clone()))),
                None => to_floats(&grid.tree, &mut budget),
            };
            match result {
                Ok(None) => {}
                Ok(Some((tree, report))) => {
                    let before = std::mem::replace(&mut grid.tree, tree.clone());
                    grid.type_name = tree.type_name();
                    if shared.is_none() {
                        done.push((before, tree, report.clone()));
                    }
                    converted.push(ConvertedGrid { grid: grid.unique_name.clone(), ..report });
                }
                Err(reason) => {
                    self.skipped.push(SkippedGrid {
                        reason: reason.in_grid(&grid.unique_name),
                        name: grid.name,
                        unique_name: grid.unique_name,
                        type_name: grid.type_name,
                        class: grid.class,
                        saved_as_half: grid.saved_as_half,
                        transform: Some(grid.transform),
                        metadata: Some(grid.metadata),
                    });
                    continue;
                }
            }
            self.grids.push(grid);
        }
        converted
    }
}

/// The converted tree; `None` if it has floats already.
fn to_floats(
    tree: &AnyTree,
    budget: &mut Budget<'_>,
) -> Result<Option<(AnyTree, ConvertedGrid)>, Error> {
    let mut loss = ConvertedGrid {
        grid: String::new(),
        value_type: tree.value_type(),
        changed: 0,
        largest_error: 0.0,
    };
    let converted = match tree {
        AnyTree::Float(_) | AnyTree::Vec3s(_) => return Ok(None),
        AnyTree::Double(tree) => number(tree, double, &mut loss, budget)?,
        AnyTree::Int32(tree) => number(tree, |v| v as f32, &mut loss, budget)?,
        AnyTree::Int64(tree) => number(tree, |v| v as f32, &mut loss, budget)?,
        AnyTree::Bool(tree) => bits(tree, budget)?,
        AnyTree::Mask(tree) => bits(tree, budget)?,
        AnyTree::Vec3d(tree) => vector(tree, double, &mut loss, budget)?,
        AnyTree::Vec3i(tree) => vector(tree, |v| v as f32, &mut loss, budget)?,
    };
    Ok(Some((converted, loss)))
}

/// The nearest float, which is never infinite unless the double is.
fn double(value: f64) -> f32 {
    if value.is_finite() { (value as f32).clamp(f32::MIN, f32::MAX) } else { value as f32 }
}

/// A number that becomes a float.
trait Exact: Copy {
    /// The relative error of a float; 0 if it is the same number, or both are NaN.
    fn error(self, float: f32) -> f64;
}

impl Exact for f64 {
    fn error(self, float: f32) -> f64 {
        let float = f64::from(float);
        if self == float || self.is_nan() { 0.0 } else { ((float - self) / self).abs() }
    }
}

macro_rules! exact_integers {
    ($($t:ty),*) => {$(
        impl Exact for $t {
            fn error(self, float: f32) -> f64 {
                // In 128 bits, since 64-bit integers are not all doubles.
                let apart = (i128::from(self) - float as i128).unsigned_abs();
                if apart == 0 { 0.0 } else { apart as f64 / self.unsigned_abs() as f64 }
            }
        }
    )*};
}
exact_integers!(i32, i64);

fn note(loss: &mut ConvertedGrid, error: f64) {
    loss.changed += u64::from(error > 0.0);
    loss.largest_error = loss.largest_error.max(error);
}

fn number<T: Exact + Value>(
    tree: &Vdb543<T>,
    convert: fn(T) -> f32,
    loss: &mut ConvertedGrid,
    budget: &mut Budget<'_>,
) -> Result<AnyTree, Error> {
    count::<_, f32>(tree, budget)?;
    let background = std::iter::once(tree.background());
    for value in tree.values().map(|value| value.value).chain(background) {
        note(loss, value.error(convert(value)));
    }
    Ok(AnyTree::Float(Arc::new(map_values(tree, convert))))
}

fn vector<T: Exact + Value>(
    tree: &Vdb543<[T; 3]>,
    convert: fn(T) -> f32,
    loss: &mut ConvertedGrid,
    budget: &mut Budget<'_>,
) -> Result<AnyTree, Error> {
    count::<_, [f32; 3]>(tree, budget)?;
    let background = std::iter::once(tree.background());
    for value in tree.values().map(|value| value.value).chain(background) {
        note(loss, value.map(|v| v.error(convert(v))).into_iter().fold(0.0, f64::max));
    }
    Ok(AnyTree::Vec3s(Arc::new(map_values(tree, |value| value.map(convert)))))
}

fn bits<V: BitValues>(
    tree: &Tree<Upper<BitLeaf<V, 3>>>,
    budget: &mut Budget<'_>,
) -> Result<AnyTree, Error> {
    count::<_, f32>(tree, budget)?;
    let value = |value: bool| if value { 1.0 } else { 0.0 };
    Ok(AnyTree::Float(Arc::new(map_bits(tree, value))))
}

/// Counts the memory of a tree of the same nodes with values of another type.
fn count<L: Node<Leaf = L>, U: Value>(
    tree: &Tree<Upper<L>>,
    budget: &mut Budget<'_>,
) -> Result<(), Error> {
    let stats = tree.stats();
    let nodes = |level: usize| usize::try_from(stats.levels[level].nodes).unwrap_or(usize::MAX);
    // Each node is the child of one other.
    budget.add(nodes(0), size_of::<LeafNode<U, 3>>() + size_of::<usize>(), L::SIZE)?;
    budget.add(nodes(1), internal_bytes::<U, 4>(1), 0)?;
    budget.add(nodes(2), internal_bytes::<U, 5>(1), 0)
}
