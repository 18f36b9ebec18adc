//! Files: `.vdb` and `.nvdb`, which have trees, and `.vdbc`, whose grids are packed already.

use vdb_core::cooked::{CookedFile, CookedGrid};
use vdb_core::display::quoted;
use vdb_core::pack::{PackKind, PackOptions, PackedGrid, ValueFormat};
use vdb_core::roles::{Candidate, Parts, main_grid, parts};
use vdb_core::{AnyTree, Grid, Limits, ReadOptions, SkippedGrid, VdbFile};
use wasm_bindgen::prelude::*;

use crate::Kind;
use crate::place::Placement;
use crate::volume::Volume;

/// A file in memory.
#[wasm_bindgen]
#[derive(Debug)]
pub struct VolumeFile {
    contents: Contents,
    notes: Vec<String>,
}

#[derive(Debug)]
enum Contents {
    Trees(Vec<Grid>),
    Cooked(Vec<CookedGrid>),
}

/// A grid that can be shown.
#[wasm_bindgen]
#[derive(Clone, Debug)]
pub struct GridInfo {
    #[wasm_bindgen(getter_with_clone, readonly)]
    /// The unique name.
    pub name: String,
    #[wasm_bindgen(readonly)]
    /// How it is shown at first.
    pub kind: Kind,
    #[wasm_bindgen(js_name = isFixed, readonly)]
    /// Whether it can be shown in no other way.
    pub is_fixed: bool,
}

/// Together less than the 4 GiB that a page can address: the file, its trees, and the words packed from one.
fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.file_bytes = 1 << 30;
    limits.tree_bytes = 3 << 29;
    limits.packed_bytes = 1 << 30;
    limits
}

fn kind_of(kind: PackKind) -> Kind {
    match kind {
        PackKind::Surface { .. } => Kind::Voxels,
        PackKind::Smooth { .. } => Kind::Smooth,
        PackKind::Fog => Kind::Fog,
    }
}

fn failed(message: impl std::fmt::Display) -> JsError {
    JsError::new(&message.to_string())
}

#[wasm_bindgen]
impl VolumeFile {
    /// Reads a file of any format.
    ///
    /// # Errors
    /// If it is none of these formats, damaged, too large for a page, or has nothing to show.
    pub fn open(bytes: &[u8]) -> Result<Self, JsError> {
        let options = ReadOptions { limits: limits(), ..ReadOptions::default() };
        let file = if CookedFile::is_cooked(bytes) {
            let grids = CookedFile::read(bytes, &options).map_err(failed)?.grids;
            Self { contents: Contents::Cooked(grids), notes: Vec::new() }
        } else {
            let mut file = VdbFile::read(bytes, &options).map_err(failed)?;
            let converted = file.convert_to_floats(&options.limits);
            let mut notes: Vec<_> = converted.iter().map(ToString::to_string).collect();
            notes.extend(file.skipped.iter().map(skipped));
            notes.extend(file.points.iter().map(|grid| {
                let name = quoted(&grid.unique_name);
                format!("grid {name} has points; `vdb from-points` makes a volume of them")
            }));
            let is_shown = |grid: &Grid| matches!(grid.tree, AnyTree::Float(_));
            let (grids, vectors): (Vec<_>, Vec<_>) = file.grids.into_iter().partition(is_shown);
            notes.extend(vectors.iter().map(|grid| {
                format!(
                    "grid {} has vectors, which this page cannot show",
                    quoted(&grid.unique_name)
                )
            }));
            Self { contents: Contents::Trees(grids), notes }
        };
        if file.grids().is_empty() {
            let why: String = file.notes.iter().map(|note| format!("; {note}")).collect();
            return Err(failed(format!("the file has no grid of numbers{why}")));
        }
        Ok(file)
    }

    /// The grids that can be shown.
    pub fn grids(&self) -> Vec<GridInfo> {
        match &self.contents {
            Contents::Trees(grids) => grids.iter().map(of_tree).collect(),
            Contents::Cooked(grids) => grids.iter().map(of_cooked).collect(),
        }
    }

    /// The number of the grid that the file is about, as far as names tell.
    #[wasm_bindgen(js_name = mainGrid)]
    pub fn main_grid(&self) -> usize {
        let grids = self.grids();
        let candidates: Vec<_> = (0..grids.len())
            .map(|i| Candidate {
                name: &grids[i].name,
                is_fog: grids[i].kind == Kind::Fog,
                is_empty: self.is_empty(i),
            })
            .collect();
        main_grid(&candidates).unwrap_or_else(|| {
            let Parts { surfaces, density, .. } = parts(&candidates);
            surfaces.first().copied().or(density).unwrap_or(0)
        })
    }

    fn is_empty(&self, grid: usize) -> bool {
        match &self.contents {
            Contents::Trees(grids) => grids[grid].tree.active_voxel_count() == 0,
            Contents::Cooked(grids) => grids[grid].packed.occupied.is_none(),
        }
    }

    /// What was left out or changed, a line each.
    pub fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// Packs a grid into words. If they would take more than `largest` bytes, samples are rounded to bytes.
    ///
    /// # Errors
    /// If there is no such grid, if it has nothing to show, if it was cooked for another kind, or if it is too large
    /// even so.
    pub fn pack(&self, grid: usize, kind: Kind, largest: f64) -> Result<Volume, JsError> {
        let (name, transform, packed) = match &self.contents {
            Contents::Trees(grids) => {
                let grid = grids.get(grid).ok_or_else(|| failed("there is no such grid"))?;
                (&grid.unique_name, &grid.transform, packed(grid, kind, largest)?)
            }
            Contents::Cooked(grids) => {
                let grid = grids.get(grid).ok_or_else(|| failed("there is no such grid"))?;
                let cooked = kind_of(grid.packed.kind);
                if kind != cooked {
                    let name = quoted(&grid.name);
                    return Err(failed(format!(
                        "grid {name} was cooked for {cooked}, not for {kind}"
                    )));
                }
                (&grid.name, &grid.transform, grid.packed.clone())
            }
        };
        let name = quoted(name);
        if packed.bytes() as f64 > largest {
            let [takes, room] = [packed.bytes() as f64, largest].map(|bytes| bytes / 1048576.0);
            return Err(failed(format!(
                "grid {name} takes {takes:.0} MiB on the GPU, and WebGPU promises {room:.0} MiB; \
                 `vdb resample` makes it coarser"
            )));
        }
        let placement = Placement::new(transform, &packed);
        let placement = placement.map_err(|why| failed(format!("grid {name}: {why}")))?;
        Ok(Volume::new(packed, placement))
    }
}

/// Why a grid was not read.
fn skipped(grid: &SkippedGrid) -> String {
    // An error in a tree that grids share names only the first of them.
    if grid.reason.place().grid.as_ref() == Some(&grid.unique_name) {
        return grid.reason.to_string();
    }
    format!("grid {}: {}", quoted(&grid.unique_name), grid.reason)
}

fn of_tree(grid: &Grid) -> GridInfo {
    let suited = match &grid.tree {
        AnyTree::Float(tree) => PackKind::suited(grid.class, tree),
        // Others are left out when a file is read.
        _ => PackKind::Fog,
    };
    let is_fixed = suited == PackKind::Fog;
    GridInfo { name: grid.unique_name.clone(), kind: kind_of(suited), is_fixed }
}

fn of_cooked(grid: &CookedGrid) -> GridInfo {
    GridInfo { name: grid.name.clone(), kind: kind_of(grid.packed.kind), is_fixed: true }
}

fn packed(grid: &Grid, kind: Kind, largest: f64) -> Result<PackedGrid, JsError> {
    let AnyTree::Float(tree) = &grid.tree else {
        return Err(failed("the grid is not made of numbers"));
    };
    let kind = match kind {
        Kind::Voxels => PackKind::Surface { iso: 0.0 },
        Kind::Smooth => PackKind::Smooth { iso: 0.0 },
        Kind::Fog => PackKind::Fog,
    };
    let in_format = |format| {
        let options = PackOptions { format, limits: limits(), ..PackOptions::default() };
        PackedGrid::with_options(tree, kind, &options).map_err(failed)
    };
    let exact = in_format(ValueFormat::Exact)?;
    if exact.bytes() as f64 <= largest {
        return Ok(exact);
    }
    drop(exact);
    in_format(ValueFormat::Byte)
}
