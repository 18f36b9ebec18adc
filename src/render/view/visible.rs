//! The visible volumes of each view.

use std::any::TypeId;

use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::render_resource::TextureUsages;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::RenderVisibleEntities;

use super::state::{ViewPicture, ViewState};
use crate::render::extract::ExtractedVolumes;
use crate::render::pool::VdbTreePool;
use crate::{VdbCamera, VdbVolume};

/// The visible volumes of a view that sees at least one, sorted. This component requires those that
/// passes keep for a view, which are removed with it.
#[derive(Component, Debug, Default)]
#[require(ViewState, ViewPicture)]
pub(crate) struct VisibleVolumes(pub Vec<MainEntity>);

/// Finds the visible volumes of each view whose grids are on the GPU.
pub(super) fn find_visible(
    mut commands: Commands,
    volumes: Res<ExtractedVolumes>,
    pool: Res<VdbTreePool>,
    views: Query<
        (Entity, &RenderVisibleEntities, Option<&VdbCamera>, Has<VisibleVolumes>),
        (With<ExtractedCamera>, With<Camera3d>),
    >,
) {
    for (view, visible, camera, had) in &views {
        let mut seen: Vec<MainEntity> = Vec::new();
        if camera.is_none_or(|camera| camera.enabled)
            && let Some(class) = visible.classes.get(&TypeId::of::<VdbVolume>())
        {
            let shown = |entity: &MainEntity| {
                volumes.0.get(entity).is_some_and(|volume| pool.shows(volume))
            };
            let here = class.entities_cpu_culling.iter().map(|(_, entity)| *entity);
            let here = here.chain(class.entities_gpu_culling.keys().copied());
            seen.extend(here.filter(shown));
        }
        if !seen.is_empty() {
            // Sorted, so that the image does not depend on the order of spawning.
            seen.sort_unstable();
            commands.entity(view).insert(VisibleVolumes(seen));
        } else if had {
            commands.entity(view).remove_with_requires::<VisibleVolumes>();
        }
    }
}

/// Removes the resources of a lost GPU from all views. At the first start there are none.
pub(super) fn forget_views(mut commands: Commands, views: Query<Entity, With<VisibleVolumes>>) {
    for view in &views {
        commands.entity(view).remove_with_requires::<VisibleVolumes>();
    }
}

/// Makes the depth of opaque meshes readable by the trace.
pub(super) fn make_depth_readable(mut views: Query<&mut Camera3d, With<VisibleVolumes>>) {
    for mut camera in &mut views {
        camera.depth_texture_usages.0 |= TextureUsages::TEXTURE_BINDING.bits();
    }
}
