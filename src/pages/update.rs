//! Loads the pages that cameras need, and displays those that have arrived.

use std::sync::Arc;

use bevy::camera::primitives::Frustum;
use bevy::camera::visibility::RenderLayers;
use bevy::light::{NotShadowCaster, NotShadowReceiver};
use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use vdb_core::display::escaped;
use vdb_core::pages::{PageId, PageIndex};

use super::component::{VdbPagedVolume, VdbPagesStatus};
use super::memory::{LoadedPage, PagesInMemory};
use super::select::{Selection, cost, displayed, select};
use super::views::{Placed, Viewpoint};
use crate::scene::Page;
use crate::{VdbCamera, VdbGrid, VdbMaterial, VdbPages, VdbVolume, VdbVolumeState};

type Cameras<'w, 's> = Query<
    'w,
    's,
    (
        &'static Camera,
        Option<&'static VdbCamera>,
        &'static Projection,
        &'static Frustum,
        &'static GlobalTransform,
    ),
    With<Camera3d>,
>;

/// Frames after which Bevy has dropped assets whose last handle is gone.
const UNTIL_DROPPED: u32 = 3;

/// Loads and displays the pages of all paged volumes.
pub(super) fn update_pages(
    mut commands: Commands,
    mut volumes: Query<(
        Entity,
        &VdbPagedVolume,
        &GlobalTransform,
        &mut PagesInMemory,
        &mut VdbPagesStatus,
    )>,
    mut pages: Query<(&VdbVolume, &VdbVolumeState, &mut Visibility), With<Page>>,
    cameras: Cameras,
    all: Res<Assets<VdbPages>>,
    (assets, grids): (Res<AssetServer>, Res<Assets<VdbGrid>>),
) {
    let views: Vec<_> = cameras
        .iter()
        .filter(|(camera, settings, ..)| {
            camera.is_active && settings.is_none_or(|settings| settings.enabled)
        })
        .map(|(camera, _, projection, frustum, at)| {
            let height = camera.physical_viewport_size().map_or(1, |size| size.y).max(1);
            Viewpoint { projection, frustum, at, height }
        })
        .collect();
    for (entity, volume, at, mut memory, mut status) in &mut volumes {
        let Some(of) = all.get(&volume.pages) else {
            forget_all(&mut memory, &mut commands);
            status.set_if_neq(VdbPagesStatus::default());
            continue;
        };
        let index = of.index();
        // Also if the index has been loaded again.
        if !memory.of.as_ref().is_some_and(|before| Arc::ptr_eq(before, index)) {
            forget_all(&mut memory, &mut commands);
            memory.of = Some(index.clone());
            memory.wait = UNTIL_DROPPED;
        }
        if memory.wait > 0 {
            memory.wait -= 1;
            status.set_if_neq(VdbPagesStatus::default());
            continue;
        }
        note_arrivals(&mut memory, index, &pages, &grids, &mut commands);
        let placed = Placed::new(index, at);
        let selection = wanted(volume, &placed, index, &views, &memory);
        drop_cancelled(&mut memory, &selection, &mut commands);
        load(&mut memory, &selection, (entity, volume, of), &assets, &mut commands);
        let shown = displayed(
            index,
            &selection.refined,
            |id| memory.is_ready(id),
            |id| memory.failed.contains(&id),
        );
        display(&memory, &shown.iter().copied().collect(), &mut pages);
        status.set_if_neq(status_of(&memory, &selection, index, shown.len()));
    }
}

fn forget_all(memory: &mut PagesInMemory, commands: &mut Commands) {
    memory.pages.drain().for_each(|(_, page)| despawn(&page, commands));
    memory.failed.clear();
    memory.has_warned = false;
}

fn despawn(page: &LoadedPage, commands: &mut Commands) {
    commands.entity(page.entity).try_despawn();
}

/// Notes which pages are on the GPU, and which could not be loaded.
fn note_arrivals(
    memory: &mut PagesInMemory,
    index: &PageIndex,
    pages: &Query<(&VdbVolume, &VdbVolumeState, &mut Visibility), With<Page>>,
    grids: &Assets<VdbGrid>,
    commands: &mut Commands,
) {
    memory.frame += 1;
    let PagesInMemory { pages: loaded, failed, has_warned, .. } = memory;
    loaded.retain(|id, page| {
        // A page whose entity the app has despawned is loaded again.
        let Ok((volume, state, _)) = pages.get(page.entity) else {
            return commands.get_entity(page.entity).is_ok();
        };
        // A hidden page is not shown only if the GPU has no room for it.
        let has_failed = match state {
            VdbVolumeState::Failed(reason) => {
                if !std::mem::replace(has_warned, true) {
                    warn_of(*id, index, reason);
                }
                true
            }
            VdbVolumeState::NotShown(_) => !page.is_ready,
            VdbVolumeState::Unseen | VdbVolumeState::Drawn if !page.is_ready => {
                exceeds_index(*id, index, grids.get(&volume.0))
            }
            _ => false,
        };
        page.is_ready |= matches!(state, VdbVolumeState::Unseen | VdbVolumeState::Drawn);
        page.is_ready &= *state != VdbVolumeState::Loading;
        if has_failed {
            failed.insert(*id);
            despawn(page, commands);
        }
        !has_failed
    });
}

/// Warns of the first page of a volume that cannot be loaded. Bevy logs the reason for each.
fn warn_of(id: PageId, index: &PageIndex, reason: &str) {
    warn!(
        "page {} of '{}' cannot be loaded: {reason}; pages of other levels are displayed instead \
         where there are any, and no warning follows for further pages of this volume",
        id.file(),
        escaped(&index.name)
    );
}

/// Whether a page is larger than its index says, so that the limit of memory would not hold.
fn exceeds_index(id: PageId, index: &PageIndex, grid: Option<&VdbGrid>) -> bool {
    let exceeds = grid.is_some_and(|grid| grid.packed().bytes() > cost(index, id));
    if exceeds {
        warn!(
            "page {} of '{}' is larger than the index of pages says, and is not displayed; cook the \
             pages again",
            id.file(),
            escaped(&index.name)
        );
    }
    exceeds
}

fn wanted(
    volume: &VdbPagedVolume,
    placed: &Placed,
    index: &PageIndex,
    views: &[Viewpoint],
    memory: &PagesInMemory,
) -> Selection {
    let detail = if volume.detail > 0.0 { volume.detail } else { f32::MIN_POSITIVE };
    let excess = |id: PageId| {
        views.iter().map(|view| placed.voxel_pixels(id, view) / detail).fold(0.0, f32::max)
    };
    select(index, volume.max_bytes, excess, |id| !memory.failed.contains(&id))
}

/// Stops loading pages that are no longer needed.
fn drop_cancelled(memory: &mut PagesInMemory, selection: &Selection, commands: &mut Commands) {
    let frame = memory.frame;
    for id in &selection.wanted {
        if let Some(page) = memory.pages.get_mut(id) {
            page.wanted = frame;
        }
    }
    memory.pages.retain(|_, page| {
        let keeps = page.is_ready || page.wanted == frame;
        if !keeps {
            despawn(page, commands);
        }
        keeps
    });
}

/// Begins to load missing pages, the most important first, and makes room for them.
fn load(
    memory: &mut PagesInMemory,
    selection: &Selection,
    (entity, volume, of): (Entity, &VdbPagedVolume, &VdbPages),
    assets: &AssetServer,
    commands: &mut Commands,
) {
    let loading = memory.pages.values().filter(|page| !page.is_ready).count();
    let free = (volume.max_loading.max(1) as usize).saturating_sub(loading);
    let index = of.index();
    let is_missing = |id: &&PageId| {
        index.has_grid(**id) && !memory.pages.contains_key(*id) && !memory.failed.contains(*id)
    };
    let missing: Vec<_> = selection.wanted.iter().filter(is_missing).copied().take(free).collect();
    make_room(memory, volume.max_bytes, commands);
    for id in missing {
        let more = cost(index, id);
        make_room(memory, volume.max_bytes.saturating_sub(more), commands);
        let grid: Handle<VdbGrid> = assets.load(of.path(id));
        let name = Name::new(format!("page {}", id.file()));
        let page =
            commands.spawn((name, VdbVolume(grid), Page, Visibility::Hidden, ChildOf(entity)));
        let page =
            LoadedPage { entity: page.id(), bytes: more, wanted: memory.frame, is_ready: false };
        memory.pages.insert(id, page);
    }
}

/// Evicts pages that no camera needs until the rest take at most `max_bytes`, or none is left to evict.
fn make_room(memory: &mut PagesInMemory, max_bytes: u64, commands: &mut Commands) {
    let mut bytes = memory.bytes();
    while bytes > max_bytes
        && let Some(oldest) = memory.oldest()
        && let Some(page) = memory.pages.remove(&oldest)
    {
        bytes -= page.bytes;
        despawn(&page, commands);
    }
}

/// Hides and unhides pages.
fn display(
    memory: &PagesInMemory,
    shown: &HashSet<PageId>,
    pages: &mut Query<(&VdbVolume, &VdbVolumeState, &mut Visibility), With<Page>>,
) {
    for (id, page) in &memory.pages {
        if let Ok((.., mut visibility)) = pages.get_mut(page.entity) {
            let is_shown = shown.contains(id);
            visibility.set_if_neq(if is_shown {
                Visibility::Inherited
            } else {
                Visibility::Hidden
            });
        }
    }
}

fn status_of(
    memory: &PagesInMemory,
    selection: &Selection,
    index: &PageIndex,
    displayed: usize,
) -> VdbPagesStatus {
    let is_missing = |id: &&PageId| {
        index.has_grid(**id) && !memory.is_ready(**id) && !memory.failed.contains(*id)
    };
    let missing = selection.wanted.iter().filter(is_missing).count() as u32;
    VdbPagesStatus {
        displayed: displayed as u32,
        in_memory: memory.pages.len() as u32,
        bytes: memory.bytes(),
        missing,
        without_room: selection.without_room,
        failed: memory.failed.len() as u32,
        is_complete: missing == 0,
    }
}

type Settings = (
    &'static VdbMaterial,
    Option<&'static RenderLayers>,
    Has<NotShadowCaster>,
    Has<NotShadowReceiver>,
);

/// Gives pages the settings of their volume that are components of their own.
pub(super) fn copy_settings(
    mut commands: Commands,
    volumes: Query<Settings, With<VdbPagedVolume>>,
    pages: Query<(Entity, &ChildOf, Settings), With<Page>>,
) {
    for (page, parent, (material, layers, casts_none, receives_none)) in &pages {
        let Ok(of) = volumes.get(parent.0) else { continue };
        let mut page = commands.entity(page);
        if of.0 != material {
            page.insert(of.0.clone());
        }
        if of.1 != layers {
            match of.1 {
                Some(layers) => page.insert(layers.clone()),
                None => page.remove::<RenderLayers>(),
            };
        }
        if of.2 != casts_none {
            if of.2 {
                page.insert(NotShadowCaster)
            } else {
                page.remove::<NotShadowCaster>()
            };
        }
        if of.3 != receives_none {
            if of.3 {
                page.insert(NotShadowReceiver)
            } else {
                page.remove::<NotShadowReceiver>()
            };
        }
    }
}

/// Drops the pages of entities that are no longer paged volumes.
pub(super) fn drop_pages(
    mut commands: Commands,
    mut removed: RemovedComponents<VdbPagedVolume>,
    mut left: Query<&mut PagesInMemory, Without<VdbPagedVolume>>,
) {
    for entity in removed.read() {
        if let Ok(mut memory) = left.get_mut(entity) {
            forget_all(&mut memory, &mut commands);
            commands.entity(entity).try_remove::<(PagesInMemory, VdbPagesStatus)>();
        }
    }
}
