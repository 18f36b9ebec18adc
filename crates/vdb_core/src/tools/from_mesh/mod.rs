//! Triangles to a narrow-band level set.
//!
//! Every voxel of the band gets the exact distance to the nearest triangle: the triangles are sorted
//! into the leaves that their band reaches, and each leaf takes the minimum over its own.
//!
//! Signs are winding numbers (A. Jacobson, L. Kavan and O. Sorkine-Hornung, "Robust Inside-Outside
//! Segmentation using Generalized Winding Numbers", ACM Transactions on Graphics 32(4), 2013). Those
//! of a mesh with holes are fractions. Here the holes are closed first (`close`): then the winding
//! number is an integer, and equals the number of surfaces that a ray crosses, counted with their
//! orientation. So one sweep over vertical lines (`crossings`) gives the sign of every voxel,
//! exactly, and neither neighbours nor distances are asked.

mod band;
mod close;
mod crossings;
pub(super) mod input;
mod leaf;
mod pieces;
mod pillar;
mod triangle;

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use glam::DVec3;
use rayon::prelude::*;

use self::band::Band;
use self::pillar::{Pillar, Progress};
use super::nodes::{Lower, Upper};
use super::{ToolError, TriangleMesh};
use crate::tree::grow::{Built, internal};
use crate::tree::{IVec3, Node, Tree, Vdb543};
use crate::work::{Stop, Work, debug_options};
use crate::{AnyTree, Grid, GridClass, Limits, ProgressFn};
pub use band::InsideRule;

/// Options of [`mesh_to_level_set`].
#[derive(Clone)]
pub struct MeshToLevelSet {
    /// The edge of a voxel in the units of the mesh: positive.
    pub voxel_size: f64,
    /// Voxels from the surface to either end of the band: 1 to 100. 3 by default, as OpenVDB's.
    pub half_width: f32,
    /// What counts as inside.
    pub inside: InsideRule,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl MeshToLevelSet {
    /// Voxels of this size, a band of three voxels on each side, and default limits.
    pub fn new(voxel_size: f64) -> Self {
        Self {
            voxel_size,
            half_width: 3.0,
            inside: InsideRule::default(),
            limits: Limits::default(),
            progress: None,
        }
    }

    /// Voxels of such a size that there are `voxels` along the longest edge of the bounding box of
    /// the positions. The size is not a number if there are no positions.
    pub fn with_voxels(positions: &[[f32; 3]], voxels: u32) -> Self {
        let points = || positions.iter().map(|&p| DVec3::from(p.map(f64::from)));
        let low = points().reduce(DVec3::min).unwrap_or(DVec3::NAN);
        let high = points().reduce(DVec3::max).unwrap_or(DVec3::NAN);
        Self::new((high - low).max_element() / f64::from(voxels))
    }
}

debug_options!(MeshToLevelSet { voxel_size, half_width, inside, limits });

/// Makes the level set of a mesh: distances in its units, negative inside, clamped to the band.
///
/// A voxel is active where the distance to the mesh is less than the half width. The rest is
/// inactive and holds ± the half width, as tiles where a whole node does. Voxel (0, 0, 0) is at the
/// origin of the mesh.
///
/// Any triangles will do: they may be degenerate, intersect each other, be flipped, or leave holes.
/// Vertices less than a hundredth of a voxel apart count as joined. A hole is closed by a fan of
/// triangles from the centre of its rim, which then is part of the surface. Where solid parts overlap, their surfaces inside each other remain in the band, with
/// negative values on both sides.
///
/// # Errors
/// If there are no triangles, a vertex is missing, not finite or more than 2³⁰ voxels away, if an
/// option is out of its range, if the level set would exceed the limits, or if it was cancelled.
///
/// ```
/// use vdb_core::tools::{MeshToLevelSet, mesh_to_level_set};
///
/// let corners = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
/// let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
/// let grid = mesh_to_level_set(&corners, &tetrahedron, &MeshToLevelSet::new(0.1))?;
/// assert!(grid.tree.active_voxel_count() > 10_000);
/// # Ok::<(), vdb_core::tools::ToolError>(())
/// ```
pub fn mesh_to_level_set(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    options: &MeshToLevelSet,
) -> Result<Grid, ToolError> {
    input::any(triangles)?;
    let transform = input::transform(options.voxel_size)?;
    let tree = level_set(positions, triangles, options, options.voxel_size)?;
    let mut grid = Grid::new("surface", AnyTree::Float(tree.into()));
    grid.class = GridClass::LevelSet;
    grid.transform = transform;
    Ok(grid)
}

/// The tree of the level set of a mesh. Its values are distances in voxels, times `scale`.
pub(super) fn level_set(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    options: &MeshToLevelSet,
    scale: f64,
) -> Result<Vdb543<f32>, ToolError> {
    let points = input::points(positions, triangles, options.voxel_size)?;
    level_set_of(&close::closed(points, triangles), options, scale)
}

/// The same for a mesh without holes that is in index space.
pub(super) fn level_set_of_closed(
    mesh: TriangleMesh,
    options: &MeshToLevelSet,
    scale: f64,
) -> Result<Vdb543<f32>, ToolError> {
    let TriangleMesh { positions, normals, triangles } = mesh;
    drop(normals);
    let points = input::points(&positions, &triangles, 1.0)?;
    drop(positions);
    level_set_of(&close::Mesh { points, triangles }, options, scale)
}

fn level_set_of(
    mesh: &close::Mesh,
    options: &MeshToLevelSet,
    scale: f64,
) -> Result<Vdb543<f32>, ToolError> {
    let half_width = input::half_width(options.half_width)?;
    let voxels = input::check_size(mesh, half_width, &options.limits)?;
    let stopped = |stop| ToolError::stopped(stop, voxels);

    let pillars = pillar::sorted(mesh, half_width);
    let steps = pillars.iter().map(Pillar::steps).sum();
    let work = Work::new(options.progress.as_ref(), steps, options.limits.tree_bytes);
    let leaves_at_once = pillar::leaves_at_once(pillars.len());
    let progress = Progress { work: &work, done: AtomicU64::new(0), leaves_at_once };
    let band =
        Band { half_width, scale, background: (half_width * scale) as f32, inside: options.inside };
    let nodes: Vec<Vec<(IVec3, Built<Lower>)>> = pillars
        .into_par_iter()
        .map(|pillar| pillar::build(mesh, &pillar, &band, &progress))
        .collect::<Result<_, _>>()
        .map_err(stopped)?;
    let nodes = nodes.into_iter().flatten().collect();
    let tree = assemble(nodes, band.background, &work).map_err(stopped)?;
    work.finish().map_err(stopped)?;
    Ok(tree)
}

/// A tree of lower nodes and of tiles of that size.
pub(super) fn assemble(
    mut nodes: Vec<(IVec3, Built<Lower>)>,
    background: f32,
    work: &Work,
) -> Result<Vdb543<f32>, Stop> {
    let key = |origin: IVec3| (Upper::origin_of(origin).to_array(), Upper::slot(origin));
    nodes.sort_by_key(|(origin, _)| key(*origin));
    let mut tree = Tree::new(background);
    let mut nodes = nodes.into_iter().peekable();
    while let Some((first, _)) = nodes.peek() {
        let origin = Upper::origin_of(*first);
        work.take((Upper::SIZE * size_of::<f32>()) as u64)?;
        let outside = || Built::Tile(background, false);
        let mut slots: Vec<Built<Lower>> = (0..Upper::SIZE).map(|_| outside()).collect();
        while let Some((own, node)) = nodes.next_if(|(own, _)| Upper::origin_of(*own) == origin) {
            slots[Upper::slot(own)] = node;
        }
        tree.insert_child(internal::<Lower, 5>(origin, slots));
    }
    tree.prune();
    Ok(tree)
}
