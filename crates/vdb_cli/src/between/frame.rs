//! The frames of a sequence, and the grids of a frame.

use std::path::{Path, PathBuf};

use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, VdbFile};

use crate::files::shown;

/// A frame, by the number in its name.
pub struct Numbered {
    pub path: PathBuf,
    pub number: u64,
    /// The name before the number.
    before: String,
    /// The name behind it.
    after: String,
    /// The digits of the number.
    digits: usize,
}

impl Numbered {
    fn new(path: &Path) -> Result<Self, String> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let stem = name.rsplit_once('.').map_or(&*name, |(stem, _)| stem);
        let without = || {
            format!(
                "{}: no number in the name, by which frames are put in order; rename it like \
                 `smoke_0001.vdb`",
                shown(path)
            )
        };
        let is_digit = |c: char| c.is_ascii_digit();
        let end = stem.rfind(is_digit).ok_or_else(without)? + 1;
        let start = stem[..end]
            .rfind(|c| !is_digit(c))
            .map_or(0, |last| last + stem[last..].chars().next().map_or(1, char::len_utf8));
        let number = stem[start..end]
            .parse()
            .map_err(|_| format!("{}: the number in the name is too large", shown(path)))?;
        Ok(Self {
            path: path.to_owned(),
            number,
            before: name[..start].to_owned(),
            after: name[end..].to_owned(),
            digits: end - start,
        })
    }

    /// The name of a frame of the same series.
    pub fn named(&self, number: u64) -> String {
        format!("{}{number:0digits$}{}", self.before, self.after, digits = self.digits)
    }
}

/// The frames of one series, in order.
pub fn series(paths: &[PathBuf]) -> Result<Vec<Numbered>, String> {
    let mut frames = paths.iter().map(|path| Numbered::new(path)).collect::<Result<Vec<_>, _>>()?;
    frames.sort_by_key(|frame| frame.number);
    for two in frames.windows(2) {
        let [a, b] = [&two[0], &two[1]].map(|frame| shown(&frame.path));
        if (&two[0].before, &two[0].after) != (&two[1].before, &two[1].after) {
            return Err(format!("{a} and {b} are not of one sequence: their names differ"));
        }
        if two[0].number == two[1].number {
            return Err(format!("{a} and {b} are both frame {}; name one", two[0].number));
        }
    }
    if frames.len() < 2 {
        return Err("nothing is in between of one frame; name two or more".into());
    }
    Ok(frames)
}

/// Whether frames in between can be made of a grid.
pub fn can_be_made(grid: &Grid) -> bool {
    matches!(grid.tree, AnyTree::Float(_))
        && grid.class != GridClass::LevelSet
        && grid.transform.is_linear()
}

/// A grid like another one, with nothing in it.
pub fn empty(grid: &Grid) -> Grid {
    let background = match &grid.tree {
        AnyTree::Float(tree) => tree.background(),
        _ => 0.0,
    };
    Grid { tree: AnyTree::Float(Vdb543::new(background).into()), ..grid.clone() }
}

/// The velocities of a frame, by the names that programs give them.
pub fn velocity(file: &VdbFile) -> Option<&Grid> {
    ["velocity", "vel", "v"].into_iter().find_map(|name| {
        file.grids.iter().find(|grid| {
            let is_vector = matches!(grid.tree, AnyTree::Vec3s(_) | AnyTree::Vec3d(_));
            is_vector && grid.name.eq_ignore_ascii_case(name)
        })
    })
}
