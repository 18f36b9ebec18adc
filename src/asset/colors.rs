//! Colours that programs save as three float grids.

use vdb_core::display::escaped;
use vdb_core::tree::{Vdb543, join_values};
use vdb_core::{AnyTree, Grid, Limits};

use super::parts::{COLORS, component_of, is};

/// Replaces three float grids that are the components of a colour, such as `Cd.x`, `Cd.y` and `Cd.z`,
/// with one vector grid, `Cd`, unless the file already has one. Returns the reasons why colours were
/// not joined.
pub(super) fn join_colors(grids: &mut Vec<Grid>, limits: &Limits) -> Vec<String> {
    let mut problems = Vec::new();
    for name in COLORS {
        let is_vector =
            |grid: &Grid| matches!(grid.tree, AnyTree::Vec3s(_)) && is(&grid.name, name);
        let Some(places) = components(grids, name).filter(|_| !grids.iter().any(is_vector)) else {
            continue;
        };
        match joined(places.map(|place| &grids[place]), limits) {
            Ok(joined) => {
                grids[places[0]] = joined;
                let mut index = 0;
                grids.retain(|_| {
                    index += 1;
                    !places[1..].contains(&(index - 1))
                });
            }
            Err(reason) => {
                let [x, y, z] = places.map(|place| escaped(&grids[place].unique_name).to_string());
                problems.push(format!(
                    "grids '{x}', '{y}' and '{z}' were not joined to a colour: {reason}"
                ));
            }
        }
    }
    problems
}

/// The positions of the components of a colour, if all are present.
fn components(grids: &[Grid], name: &str) -> Option<[usize; 3]> {
    // Of the three spellings of components.
    (0..3).find_map(|spelling| {
        let place = |axis: usize| {
            grids.iter().position(|grid| {
                matches!(grid.tree, AnyTree::Float(_))
                    && component_of(&grid.name, name) == Some((spelling, axis))
            })
        };
        Some([place(0)?, place(1)?, place(2)?])
    })
}

fn joined(parts: [&Grid; 3], limits: &Limits) -> Result<Grid, String> {
    let mut trees: Vec<&Vdb543<f32>> = Vec::new();
    for part in parts {
        if part.transform != parts[0].transform {
            return Err("their transforms differ".into());
        }
        if let AnyTree::Float(tree) = &part.tree {
            trees.push(tree);
        }
    }
    let most = 3 * trees.iter().map(|tree| tree.stats().bytes).sum::<u64>();
    if most > limits.tree_bytes {
        let limit = limits.tree_bytes;
        return Err(format!(
            "together they may take {most} bytes, but the limit tree_bytes is {limit}"
        ));
    }
    let [x, y, z] = trees[..] else { return Err("they are not grids of floats".into()) };
    let vector = parts[0].name.len() - 2;
    let tree = AnyTree::Vec3s(join_values([x, y, z]).into());
    let mut grid = Grid::new(&parts[0].name[..vector], tree);
    grid.transform = parts[0].transform.clone();
    grid.compression = parts[0].compression;
    grid.saved_as_half = parts.iter().all(|part| part.saved_as_half);
    Ok(grid)
}
