//! What a file shows: which grids, as what, and the box around them.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3, IVec3};
use vdb_core::display::quoted;
use vdb_core::pack::{PackKind, PackOptions, PackedGrid, PackedTogether};
use vdb_core::query::{GridQuery, IndexRay};
use vdb_core::roles::{Candidate, kelvin, parts};
use vdb_core::tree::{CoordBox, Node, Vdb543};
use vdb_core::{AnyTree, Grid, Limits, VdbFile};

use super::ray::{Ray, corners};
use crate::files::{grid_of, shown};

/// A grid, ready for rays.
pub struct Volume {
    pub name: String,
    tree: Arc<Vdb543<f32>>,
    packed: PackedGrid,
    world_from_index: DAffine3,
    index_from_world: DAffine3,
    /// The corners of a box around all that is seen, in world space.
    pub bounds: [DVec3; 2],
    /// The edge of a voxel in world units; of a cube with its volume if it is none.
    pub voxel: f64,
}

/// Everything that is shown of a file.
pub struct Scene {
    pub surfaces: Vec<Volume>,
    pub fog: Option<Volume>,
    /// What emits light in the fog.
    pub fire: Option<Fire>,
    pub bounds: [DVec3; 2],
}

/// A grid that emits light.
pub struct Fire {
    pub volume: Volume,
    /// The temperatures in kelvin of values of 0 and 1.
    pub kelvin: [f32; 2],
}

impl Scene {
    /// The grid with a name, or what the viewer shows of a file. With `iso`, all of it is shown as
    /// surfaces at that value.
    pub fn new(
        file: &VdbFile,
        path: &Path,
        name: Option<&str>,
        iso: Option<f32>,
        limits: &Limits,
    ) -> Result<Self, String> {
        let options = PackOptions {
            limits: limits.clone(),
            together: Some(PackedTogether::default()),
            ..PackOptions::default()
        };
        let volume = |grid: &Grid, kind: PackKind| Volume::new(grid, kind, path, &options);
        let mut scene =
            Self { surfaces: Vec::new(), fog: None, fire: None, bounds: [DVec3::ZERO; 2] };
        let mut others = Vec::new();
        for (grid, kind, role) in chosen(file, path, name, iso)? {
            match role {
                Role::Surface => scene.surfaces.extend(volume(grid, kind)?),
                Role::Fog => scene.fog = volume(grid, kind)?,
                Role::Fire => others.extend(volume(grid, kind)?),
            }
        }
        scene.fire = others.pop().map(|volume| {
            let kelvin = kelvin(&volume.name, volume.packed.majorant);
            Fire { volume, kelvin }
        });
        let boxes = scene.volumes().map(|volume| volume.bounds);
        let union = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        let nothing = || match name {
            Some(name) => {
                format!("{}: grid {} shows nothing: it is empty", shown(path), quoted(name))
            }
            None => format!("{}: no grid shows anything: they are empty", shown(path)),
        };
        scene.bounds = boxes.reduce(union).ok_or_else(nothing)?;
        if !(scene.bounds[0].is_finite() && scene.bounds[1].is_finite()) {
            return Err(format!("{}: the volumes reach beyond the numbers of f64", shown(path)));
        }
        Ok(scene)
    }

    /// Calls `visit` for corners of boxes that together contain all that is seen, in world space.
    pub fn visit_corners(&self, mut visit: impl FnMut(DVec3)) {
        self.volumes().for_each(|volume| volume.visit_corners(&mut visit));
    }

    /// All volumes.
    pub fn volumes(&self) -> impl Iterator<Item = &Volume> {
        let fire = self.fire.as_ref().map(|fire| &fire.volume);
        self.surfaces.iter().chain(&self.fog).chain(fire)
    }
}

#[derive(Clone, Copy)]
enum Role {
    Surface,
    Fog,
    Fire,
}

/// The grids to show, in order.
fn chosen<'a>(
    file: &'a VdbFile,
    path: &Path,
    name: Option<&str>,
    iso: Option<f32>,
) -> Result<Vec<(&'a Grid, PackKind, Role)>, String> {
    let kind = |grid: &Grid| match (&grid.tree, iso) {
        (AnyTree::Float(_), Some(iso)) => Some(PackKind::Smooth { iso }),
        (AnyTree::Float(tree), None) => Some(match PackKind::suited(grid.class, tree) {
            PackKind::Surface { iso } => PackKind::Smooth { iso },
            kind => kind,
        }),
        _ => None,
    };
    let role = |kind| if kind == PackKind::Fog { Role::Fog } else { Role::Surface };
    if let Some(name) = name {
        let grid = grid_of(file, path, Some(name))?;
        let other = || {
            let (path, name) = (shown(path), quoted(name));
            format!("{path}: grid {name} has values of type {}, not floats", grid.tree.value_type())
        };
        let kind = kind(grid).ok_or_else(other)?;
        return Ok(vec![(grid, kind, role(kind))]);
    }
    let floats = file.grids.iter().filter_map(|grid| Some((grid, kind(grid)?)));
    let floats: Vec<_> = floats.collect();
    // The roles are those of the grids as they are, whatever they are shown as.
    let is_fog = |grid: &Grid| match &grid.tree {
        AnyTree::Float(tree) => PackKind::suited(grid.class, tree) == PackKind::Fog,
        _ => false,
    };
    let candidate = |(grid, _): &(&'a Grid, PackKind)| Candidate {
        name: &grid.name,
        is_fog: is_fog(grid),
        is_empty: grid.tree.active_bbox().is_none(),
    };
    let parts = parts(&floats.iter().map(candidate).collect::<Vec<_>>());
    let of = |i: usize, role: Role| (floats[i].0, floats[i].1, role);
    let mut all: Vec<_> = parts.surfaces.iter().map(|i| of(*i, Role::Surface)).collect();
    all.extend(parts.density.map(|i| of(i, role(floats[i].1))));
    all.extend(parts.fire.filter(|_| iso.is_none()).map(|i| of(i, Role::Fire)));
    if all.is_empty() {
        return Err(format!("{}: no grid of floats", shown(path)));
    }
    Ok(all)
}

impl Volume {
    /// `None` if there is nothing to see.
    fn new(
        grid: &Grid,
        kind: PackKind,
        path: &Path,
        options: &PackOptions,
    ) -> Result<Option<Self>, String> {
        let fails =
            |why: &str| format!("{}: grid {}: {why}", shown(path), quoted(&grid.unique_name));
        let AnyTree::Float(tree) = &grid.tree else { return Ok(None) };
        let world_from_index = grid.transform.linear().ok_or_else(|| {
            fails("its transform is a frustum; give it cubic voxels with `vdb resample`")
        })?;
        let packed = PackedGrid::with_options(tree, kind, options)
            .map_err(|error| fails(&error.to_string()))?;
        let Some(cells) = packed.occupied else { return Ok(None) };
        let first = packed.base.as_dvec3() + kind.lattice_origin();
        let bounds = [cells.min.as_dvec3(), cells.max.as_dvec3() + 1.0].map(|at| at + first);
        let points = corners(bounds).map(|corner| world_from_index.transform_point3(corner));
        Ok(Some(Self {
            name: grid.unique_name.clone(),
            tree: tree.clone(),
            bounds: points
                .iter()
                .fold([points[0]; 2], |[low, high], p| [low.min(*p), high.max(*p)]),
            voxel: world_from_index.matrix3.determinant().abs().cbrt(),
            world_from_index,
            index_from_world: world_from_index.inverse(),
            packed,
        }))
    }

    /// For rays: reads the packed values, which is faster than looking them up in the tree.
    pub fn query(&self) -> GridQuery<'_> {
        GridQuery::of_packed(&self.packed)
    }

    /// For points: reads the tree, because a packed surface has no values outside its own cells.
    pub fn query_points(&self) -> GridQuery<'_> {
        GridQuery::new(&self.tree, &self.packed)
    }

    /// Calls `visit` for corners of boxes that together contain all that is seen, in world space.
    pub fn visit_corners(&self, visit: &mut impl FnMut(DVec3)) {
        let Some(cells) = self.packed.occupied else { return };
        let cells =
            CoordBox { min: cells.min + self.packed.base, max: cells.max + self.packed.base };
        let origin = self.packed.kind.lattice_origin();
        let mut add = |cells: CoordBox| {
            let bounds = [cells.min.as_dvec3(), cells.max.as_dvec3() + 1.0].map(|at| at + origin);
            corners(bounds)
                .iter()
                .for_each(|at| visit(self.world_from_index.transform_point3(*at)));
        };
        // Tiles have no leaves.
        if self.tree.stats().active_tiles() > 0 {
            return add(cells);
        }
        let is_inside = |value: f32| match self.packed.kind {
            PackKind::Fog => value > 0.0,
            PackKind::Smooth { iso } | PackKind::Surface { iso } => value < iso,
        };
        for leaf in self.tree.leaves() {
            let inside = leaf.values_slice().iter().enumerate().filter(|(_, v)| is_inside(**v));
            let voxel = |(slot, _): (usize, _)| {
                let slot = slot as i32;
                CoordBox::voxel(leaf.origin() + IVec3::new(slot >> 6, slot >> 3 & 7, slot & 7))
            };
            if let Some(CoordBox { min, max }) = inside.map(voxel).reduce(CoordBox::union) {
                // The cells with one of these samples at a corner.
                let reached = CoordBox { min: min.saturating_sub(IVec3::ONE), max };
                reached.intersection(cells).into_iter().for_each(&mut add);
            }
        }
    }

    /// A ray in index space. `t` is the distance in world units.
    pub fn to_index(&self, ray: &Ray) -> IndexRay {
        IndexRay {
            origin: self.index_from_world.transform_point3(ray.origin),
            dir: self.index_from_world.transform_vector3(ray.dir),
            t_max: ray.t_max,
        }
    }

    /// A point in index space.
    pub fn point_to_index(&self, point: DVec3) -> DVec3 {
        self.index_from_world.transform_point3(point)
    }

    /// A direction in world space for a gradient in index space.
    pub fn normal(&self, gradient: DVec3) -> DVec3 {
        self.index_from_world.matrix3.transpose() * gradient
    }

    /// The largest value of a fog.
    pub fn most(&self) -> f32 {
        self.packed.majorant
    }
}
