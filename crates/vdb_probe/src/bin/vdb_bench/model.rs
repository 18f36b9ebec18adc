//! Models to trace rays through.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use vdb_core::pack::PackKind;
use vdb_core::synth::models;
use vdb_core::tree::{
    Coarsening, CoordBox, LevelOptions, Vdb543, half_resolution, voxel_in_distances,
};
use vdb_core::{AnyTree, GridClass, ReadOptions, Transform, VdbFile};

/// The source of a model.
pub struct Source {
    origin: Origin,
    /// The number of times the resolution is halved.
    level: u32,
}

enum Origin {
    File(PathBuf),
    Made { name: &'static str, edge: u32, make: fn(u32) -> Vdb543<f32> },
}

impl FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let made = |name, make: fn(u32) -> Vdb543<f32>, edge: &str| {
            let edge = edge.parse().ok().filter(|edge| models::EDGES.contains(edge));
            let (least, most) = (models::EDGES.start(), models::EDGES.end());
            let edge = edge.ok_or(format!("{text}: its size must be from {least} to {most}"))?;
            Ok::<_, String>(Origin::Made { name, edge, make })
        };
        let (text, level) = match text.rsplit_once('@') {
            Some((text, level)) => (text, level.parse().map_err(|_| format!("{text}: no level"))?),
            None => (text, 0),
        };
        let origin = match text.split_once(':') {
            Some(("gyroid", edge)) => made("gyroid", models::gyroid, edge),
            Some(("truss", edge)) => made("truss", models::truss_station, edge),
            _ => Ok(Origin::File(text.into())),
        };
        Ok(Self { origin: origin?, level })
    }
}

/// A float grid with active voxels.
pub struct Model {
    pub name: String,
    pub tree: Arc<Vdb543<f32>>,
    pub level_set: bool,
    /// The transform from index space to world space.
    pub transform: Transform,
    pub active: CoordBox,
    pub active_voxels: u64,
    pub level: u32,
}

impl Model {
    /// Reads or generates a model.
    pub fn new(source: &Source) -> Result<Self, String> {
        let mut model = match &source.origin {
            Origin::File(path) => {
                Self::read(path).map_err(|error| format!("{}: {error}", path.display()))
            }
            Origin::Made { name, edge, make } => {
                eprintln!("making {name}:{edge}");
                let tree = make(*edge).into();
                Self::of(format!("{name}_{edge}"), tree, true, Transform::default())
            }
        }?;
        for _ in 0..source.level {
            let coarsening = if model.level_set {
                Coarsening::Surface { iso: 0.0, voxel: voxel_in_distances(&model.tree) }
            } else {
                Coarsening::Fog
            };
            let half = half_resolution(&model.tree, coarsening, &LevelOptions::default());
            model.tree = half.map_err(|error| error.to_string())?.into();
        }
        if source.level > 0 {
            model.name = format!("{}@{}", model.name, source.level);
            model.level = source.level;
        }
        Ok(model)
    }

    fn read(path: &std::path::Path) -> Result<Self, String> {
        let bytes = std::fs::read(path).map_err(|error| error.to_string())?;
        let file = VdbFile::read(&bytes, &ReadOptions::default()).map_err(|e| e.to_string())?;
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
        let floats = file.grids.into_iter().find_map(|grid| match grid.tree {
            AnyTree::Float(tree) => Some((tree, grid.class, grid.transform)),
            _ => None,
        });
        let (tree, class, transform) = floats.ok_or("has no float grid")?;
        Self::of(name, tree, class == GridClass::LevelSet, transform)
    }

    fn of(
        name: String,
        tree: Arc<Vdb543<f32>>,
        level_set: bool,
        transform: Transform,
    ) -> Result<Self, String> {
        let active = tree.active_bbox().ok_or("has no active voxels")?;
        let active_voxels = tree.active_voxel_count();
        Ok(Self { name, tree, level_set, transform, active, active_voxels, level: 0 })
    }

    /// The kinds of rendering that a set measures; fog has only one.
    pub fn kinds(&self, smooth: &[bool]) -> Vec<Kind> {
        if !self.level_set {
            return vec![Kind::Fog];
        }
        let of = |smooth: &bool| if *smooth { Kind::Smooth } else { Kind::Voxels };
        smooth.iter().map(of).collect()
    }
}

/// A kind of rendering.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Voxels,
    Smooth,
    Fog,
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Voxels => "voxels",
            Self::Smooth => "smooth",
            Self::Fog => "fog",
        }
    }

    pub fn pack(self) -> PackKind {
        match self {
            Self::Voxels => PackKind::Surface { iso: 0.0 },
            Self::Smooth => PackKind::Smooth { iso: 0.0 },
            Self::Fog => PackKind::Fog,
        }
    }

    /// The shader def that selects this kind.
    pub fn def(self) -> Option<&'static str> {
        match self {
            Self::Voxels => None,
            Self::Smooth => Some("SMOOTH"),
            Self::Fog => Some("FOG"),
        }
    }

    /// Whether the shader's output for a ray is a hit.
    pub fn is_hit(self, value: f32) -> bool {
        if self == Self::Fog { value < 0.999 } else { value >= 0.0 }
    }
}
