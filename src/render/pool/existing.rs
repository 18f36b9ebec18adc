//! Extraction of which grids in the pool still are what the app's assets have.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::Extract;
use vdb_core::pack::PackedGrid;

use super::residency::VdbTreePool;
use crate::render::gpu::GridKey;
use crate::{VdbGrid, VdbVectorGrid};

/// Finds out whether the assets of the grids in the pool exist and are unchanged. Those of grids
/// that are no longer displayed may have been dropped, replaced or edited.
pub(super) fn find_existing(
    grids: Extract<Res<Assets<VdbGrid>>>,
    vectors: Extract<Res<Assets<VdbVectorGrid>>>,
    mut pool: ResMut<VdbTreePool>,
) {
    for (key, resident) in &mut pool.resident {
        let now = packed(*key, &grids, &vectors);
        resident.exists = resident.revision.is_none()
            && now.is_some_and(|packed| Arc::ptr_eq(packed, &resident.packed));
    }
}

/// The packed grid of a key, unless it is edited.
fn packed<'a>(
    key: GridKey,
    grids: &'a Assets<VdbGrid>,
    vectors: &'a Assets<VdbVectorGrid>,
) -> Option<&'a Arc<PackedGrid>> {
    if let Some((id, level)) = key.float_level() {
        let grid = grids.get(id).filter(|grid| !grid.is_edited())?;
        return match level.checked_sub(1) {
            None => Some(grid.packed()),
            Some(coarser) => grid.levels()?.get(coarser),
        };
    }
    let (id, component) = key.vector_part()?;
    vectors.get(id)?.packed().get(component)
}
