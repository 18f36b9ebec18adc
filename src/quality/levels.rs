//! Levels of detail: grids at half resolution, a quarter and so on, generated in the background
//! when a camera needs them.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::camera::primitives::Aabb;
use bevy::math::DVec3;
use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use bevy::tasks::Task;
use bevy::tasks::futures::check_ready;
use vdb_core::pack::{PackError, PackKind, PackOptions, PackedGrid, ValueFormat};
use vdb_core::tree::{Coarsening, LevelOptions, Vdb543, half_resolution, voxel_in_distances};
use vdb_core::{GridClass, ProgressFn};

use crate::asset::{background, corners};
use crate::quality::dial::{distance, pixel_size};
use crate::{VdbCamera, VdbGrid, VdbQuality, VdbVolume, VdbVolumeState};

/// Grids are not reduced further if their longest edge would become this short, in cells.
const SMALLEST: u64 = 16;

/// The grid whose levels are being generated.
#[derive(Debug, Default, Resource)]
pub(crate) struct PendingLevels(Option<Pending>);

#[derive(Debug)]
struct Pending {
    id: AssetId<VdbGrid>,
    of: Arc<PackedGrid>,
    levels: Task<Levels>,
    wanted: Arc<AtomicBool>,
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.wanted.store(false, Ordering::Relaxed);
    }
}

type Levels = Arc<[Arc<PackedGrid>]>;

/// Generates the levels that cameras need, only for volumes in view and for one grid at a time,
/// starting with the one with the smallest voxels on screen. Drops all levels once no camera needs
/// any.
pub(crate) fn make_levels(
    cameras: Query<(&VdbCamera, &VdbQuality, &Camera, &Projection, &GlobalTransform)>,
    volumes: Query<(&VdbVolume, &VdbVolumeState, &GlobalTransform, &Aabb)>,
    mut grids: ResMut<Assets<VdbGrid>>,
    mut pending: ResMut<PendingLevels>,
    mut made: Local<HashSet<AssetId<VdbGrid>>>,
) {
    if !cameras.iter().any(|(camera, quality, ..)| camera.enabled && quality.detail > 0.0) {
        pending.0 = None;
        for id in made.drain() {
            if let Some(mut grid) = grids.get_mut(id) {
                grid.set_levels(None);
            }
        }
        return;
    }
    if let Some(Pending { id, of, levels, .. }) = &mut pending.0 {
        // Levels of a grid that has changed in the meantime are discarded.
        let is_same = grids.get(*id).is_some_and(|grid| Arc::ptr_eq(grid.packed(), of));
        let ready = if is_same { check_ready(levels) } else { None };
        if let Some(levels) = ready
            && let Some(mut grid) = grids.get_mut(*id)
        {
            grid.set_levels(Some(levels));
            made.insert(*id);
        } else if is_same {
            return;
        }
        pending.0 = None;
    }
    let drawn = volumes.iter().filter(|(_, state, ..)| **state == VdbVolumeState::Drawn);
    let asked = drawn.filter_map(|(volume, _, at, aabb)| {
        let grid = grids.get(&volume.0)?;
        // The next edit would make the levels obsolete, and while they are generated they share the
        // tree, which the edit would have to copy.
        if grid.is_edited() || grid.levels().is_some() {
            return None;
        }
        let tree = grid.tree()?;
        let need = cameras.iter().map(|camera| need(camera, grid, at, aabb)).fold(0.0, f32::max);
        (need >= 1.0).then_some((need, volume.0.id(), grid, tree))
    });
    if let Some((_, id, grid, tree)) = asked.max_by(|a, b| a.0.total_cmp(&b.0)) {
        pending.0 = Some(begin(id, grid.clone(), tree.clone()));
    }
}

/// The factor by which the voxels of a grid may be larger: for a fog, at the point nearest to the camera, which
/// determines its level; for a surface, at its farthest corner. At 2 or more, a coarser level is displayed, and should
/// exist by then.
fn need(
    (settings, quality, camera, projection, view): (
        &VdbCamera,
        &VdbQuality,
        &Camera,
        &Projection,
        &GlobalTransform,
    ),
    grid: &VdbGrid,
    at: &GlobalTransform,
    aabb: &Aabb,
) -> f32 {
    if !settings.enabled || quality.detail.is_nan() || quality.detail <= 0.0 {
        return 0.0;
    }
    let height = camera.physical_viewport_size().map_or(1, |size| size.y).max(1);
    let distance = match grid.kind() {
        PackKind::Fog => distance(view, at, aabb),
        PackKind::Surface { .. } | PackKind::Smooth { .. } => largest_distance(view, at, aabb),
    };
    let pixel = pixel_size(projection, height, distance);
    let world_from_index =
        Mat3::from(at.affine().matrix3) * grid.world_from_index().matrix3.as_mat3();
    let axes = [world_from_index.x_axis, world_from_index.y_axis, world_from_index.z_axis];
    let voxel = axes.into_iter().map(Vec3::length).fold(0.0, f32::max);
    quality.detail.min(64.0) * pixel / voxel
}

/// The distance of a view from the farthest corner of a volume.
fn largest_distance(view: &GlobalTransform, at: &GlobalTransform, aabb: &Aabb) -> f32 {
    let corners = corners((aabb.min().as_dvec3(), aabb.max().as_dvec3()));
    let distance =
        |corner: DVec3| at.transform_point(corner.as_vec3()).distance(view.translation());
    corners.map(distance).fold(0.0, f32::max)
}

fn begin(id: AssetId<VdbGrid>, grid: VdbGrid, tree: Arc<Vdb543<f32>>) -> Pending {
    let wanted = Arc::new(AtomicBool::new(true));
    let (of, asked) = (grid.packed().clone(), wanted.clone());
    let goes_on: Arc<ProgressFn> = Arc::new(move |_, _| match asked.load(Ordering::Relaxed) {
        true => ControlFlow::Continue(()),
        false => ControlFlow::Break(()),
    });
    Pending { id, of, levels: background::improve(move || coarser(&grid, tree, goes_on)), wanted }
}

/// A grid at half its resolution, a quarter and so on.
fn coarser(grid: &VdbGrid, mut tree: Arc<Vdb543<f32>>, goes_on: Arc<ProgressFn>) -> Levels {
    let packed = grid.packed();
    let format = match packed.sample_format() {
        Some(1) => ValueFormat::Half,
        Some(2) => ValueFormat::Byte,
        _ => ValueFormat::Exact,
    };
    let (limits, progress) = (grid.limits().clone(), Some(goes_on.clone()));
    let options = LevelOptions { limits: limits.clone(), progress: progress.clone() };
    let packing = PackOptions { format, limits, progress, ..default() };
    let mut levels: Vec<Arc<PackedGrid>> = Vec::new();
    let has_none = |error: &dyn std::fmt::Display| {
        // Not if the failure is that the levels are no longer wanted.
        if goes_on(0, 0).is_continue() {
            warn!("grid '{}' has no coarser levels of detail: {error}", grid.shown_name());
        }
    };
    loop {
        let finest = levels.last().unwrap_or(packed);
        // In 64 bits, because a grid may span the whole index space.
        let cells = finest.occupied.map_or([0; 3], |cells| cells.dim());
        if cells.into_iter().max() <= Some(2 * SMALLEST) {
            break;
        }
        let coarsening = match packed.kind {
            PackKind::Fog => Coarsening::Fog,
            PackKind::Surface { iso } | PackKind::Smooth { iso } => {
                let is_distance = grid.class() == GridClass::LevelSet && iso == 0.0;
                let voxel = if is_distance { voxel_in_distances(&tree) } else { None };
                Coarsening::Surface { iso, voxel }
            }
        };
        tree = match half_resolution(&tree, coarsening, &options) {
            Ok(coarser) => Arc::new(coarser),
            Err(error) => {
                has_none(&error);
                break;
            }
        };
        match PackedGrid::with_options(&tree, packed.kind, &packing) {
            Ok(level) if level.occupied.is_some() => levels.push(Arc::new(level)),
            Ok(_) | Err(PackError::Cancelled) => break,
            Err(error) => {
                has_none(&error);
                break;
            }
        }
    }
    levels.into()
}
