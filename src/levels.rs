//! Levels of detail: each grid again at a half, a quarter … of its resolution, made while the app goes on
//! where a camera asks for them.

use std::sync::Arc;

use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use bevy::tasks::futures::check_ready;
use bevy::tasks::{AsyncComputeTaskPool, Task};
use vdb_core::GridClass;
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat};
use vdb_core::tree::{Coarsening, LevelOptions, half_resolution, voxel_in_distances};

use crate::{VdbCamera, VdbGrid, VdbQuality, VdbVolume};

/// Of its longest edge, in cells: a grid that is smaller is not made coarser still.
const SMALLEST: u64 = 16;

/// The grids whose coarser levels are being made.
#[derive(Debug, Default, Resource)]
pub(crate) struct PendingLevels {
    tasks: HashMap<AssetId<VdbGrid>, Task<Levels>>,
}

/// The coarser levels of a grid, and which grid that was.
#[derive(Debug)]
struct Levels {
    of: Arc<PackedGrid>,
    levels: Arc<[Arc<PackedGrid>]>,
}

/// Makes the levels that cameras ask for, and drops them when none does any more.
pub(crate) fn make_levels(
    cameras: Query<(&VdbCamera, &VdbQuality)>,
    volumes: Query<&VdbVolume>,
    mut grids: ResMut<Assets<VdbGrid>>,
    mut pending: ResMut<PendingLevels>,
    mut made: Local<HashSet<AssetId<VdbGrid>>>,
) {
    if !cameras.iter().any(|(camera, quality)| camera.enabled && quality.detail > 0.0) {
        pending.tasks.clear();
        for id in made.drain() {
            if let Some(mut grid) = grids.get_mut(id) {
                grid.set_levels(None);
            }
        }
        return;
    }
    for volume in &volumes {
        let id = volume.0.id();
        let Some(grid) = grids.get(id) else { continue };
        // They would be out of date by the next edit, and make it copy what they are made of.
        if !grid.is_edited() && grid.levels().is_none() && !pending.tasks.contains_key(&id) {
            let grid = grid.clone();
            let task = AsyncComputeTaskPool::get()
                .spawn(async move { Levels { of: grid.packed().clone(), levels: coarser(&grid) } });
            pending.tasks.insert(id, task);
        }
    }
    let mut done = Vec::new();
    for (id, task) in &mut pending.tasks {
        if let Some(levels) = check_ready(task) {
            done.push((*id, levels));
        }
    }
    for (id, made_of) in done {
        pending.tasks.remove(&id);
        // Of a grid that has changed since they are worth nothing.
        if grids.get(id).is_some_and(|grid| Arc::ptr_eq(grid.packed(), &made_of.of))
            && let Some(mut grid) = grids.get_mut(id)
        {
            grid.set_levels(Some(made_of.levels));
            made.insert(id);
        }
    }
}

/// A grid at half its resolution, at half of that, and so on.
fn coarser(grid: &VdbGrid) -> Arc<[Arc<PackedGrid>]> {
    let packed = grid.packed();
    let format = match packed.sample_format() {
        Some(1) => ValueFormat::Half,
        Some(2) => ValueFormat::Byte,
        _ => ValueFormat::Exact,
    };
    let mut tree = Arc::clone(grid.tree());
    let mut levels: Vec<Arc<PackedGrid>> = Vec::new();
    loop {
        let finest = levels.last().unwrap_or(packed);
        // 64 bits, because a grid may span the whole of the index space.
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
        tree = match half_resolution(&tree, coarsening, &LevelOptions::default()) {
            Ok(coarser) => Arc::new(coarser),
            Err(error) => {
                warn!("grid '{}' has no coarser levels of detail: {error}", grid.name());
                break;
            }
        };
        match PackedGrid::with_format(&tree, packed.kind, format) {
            Ok(level) if level.occupied.is_some() => levels.push(Arc::new(level)),
            Ok(_) => break,
            Err(error) => {
                warn!("grid '{}' has no coarser levels of detail: {error}", grid.name());
                break;
            }
        }
    }
    levels.into()
}
