//! The grids that benchmarks measure: files named on the command line, or else the benchmark's own.

use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::sync::Arc;

use vdb_core::pack::PackKind;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, GridClass, VdbFile};

pub struct BenchGrid {
    pub name: String,
    pub class: GridClass,
    pub tree: Arc<Vdb543<f32>>,
}

/// A grid and how it is shown.
#[derive(Clone, Copy)]
pub struct Shown {
    pub grid: &'static BenchGrid,
    pub kind: PackKind,
}

impl Display for Shown {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            PackKind::Surface { .. } => "voxels",
            PackKind::Smooth { .. } => "smooth",
            PackKind::Fog => "fog",
        };
        write!(f, "{}, {kind}", self.grid.name)
    }
}

/// Runs the benchmarks. With files there are no options: divan would take the files for names of
/// benchmarks.
pub fn run() {
    if files().next().is_some() {
        divan::Divan::default().run_benches();
    } else {
        divan::main();
    }
}

fn files() -> impl Iterator<Item = String> {
    std::env::args().skip(1).filter(|argument| argument.ends_with(".vdb"))
}

/// Every grid of floats in the files, or else those that `own` makes.
pub fn grids(own: impl FnOnce() -> Vec<BenchGrid>) -> Vec<BenchGrid> {
    if files().next().is_none() { own() } else { files().flat_map(|file| read(&file)).collect() }
}

/// Every grid of floats in a file.
pub fn read(file: &str) -> Vec<BenchGrid> {
    let read = VdbFile::open(file).unwrap_or_else(|error| panic!("{error}"));
    let stem = Path::new(file).file_stem().unwrap_or_default().to_string_lossy();
    let grids = read.grids.into_iter().filter_map(|grid| match grid.tree {
        AnyTree::Float(tree) => {
            Some(BenchGrid { name: format!("{stem} {}", grid.name), class: grid.class, tree })
        }
        _ => None,
    });
    grids.collect()
}

/// Surfaces as voxels and smooth, other grids as fog.
pub fn shown(grids: &'static [BenchGrid]) -> Vec<Shown> {
    let kinds = |grid: &BenchGrid| match PackKind::suited(grid.class, &grid.tree) {
        PackKind::Fog => vec![PackKind::Fog],
        PackKind::Surface { iso } | PackKind::Smooth { iso } => {
            vec![PackKind::Surface { iso }, PackKind::Smooth { iso }]
        }
    };
    let shown = |grid| kinds(grid).into_iter().map(move |kind| Shown { grid, kind });
    grids.iter().flat_map(shown).collect()
}
