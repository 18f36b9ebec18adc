//! Which volumes each view sees.

use std::any::TypeId;

use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::render_resource::TextureUsages;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::RenderVisibleEntities;

use super::bind::ViewBindGroups;
use super::extract::ExtractedVolumes;
use super::gpu_tree::VdbTreePool;
use super::pipeline::ViewPipelines;
use super::resources::ViewResources;
use crate::{VdbCamera, VdbVolume};

/// On views that see at least one volume: which.
#[derive(Component, Debug)]
pub(super) struct ViewVolumes(pub Vec<MainEntity>);

/// Finds the volumes of each view whose grid is on the GPU.
pub(super) fn find_views(
    mut commands: Commands,
    volumes: Res<ExtractedVolumes>,
    pool: Res<VdbTreePool>,
    views: Query<
        (Entity, &RenderVisibleEntities, Option<&VdbCamera>, Has<ViewVolumes>),
        (With<ExtractedCamera>, With<Camera3d>),
    >,
) {
    for (view, visible, camera, had) in &views {
        let mut seen: Vec<MainEntity> = Vec::new();
        if camera.is_none_or(|camera| camera.enabled)
            && let Some(class) = visible.classes.get(&TypeId::of::<VdbVolume>())
        {
            let shown = |entity: &MainEntity| {
                volumes.0.get(entity).is_some_and(|volume| volume.is_there(&pool))
            };
            let here = class.entities_cpu_culling.iter().map(|(_, entity)| *entity);
            let here = here.chain(class.entities_gpu_culling.keys().copied());
            seen.extend(here.filter(shown));
        }
        if !seen.is_empty() {
            // An order of their own, so that the picture does not depend on that of spawning.
            seen.sort_unstable();
            commands.entity(view).insert(ViewVolumes(seen));
        } else if had {
            commands.entity(view).remove::<(ViewVolumes, ViewResources, ViewBindGroups)>();
        }
    }
}

/// Takes from all views what a GPU that was lost has made for them. At the first start there is nothing.
pub(super) fn forget_views(
    mut commands: Commands,
    views: Query<Entity, Or<(With<ViewVolumes>, With<ViewResources>, With<ViewPipelines>)>>,
) {
    for view in &views {
        commands
            .entity(view)
            .remove::<(ViewVolumes, ViewResources, ViewBindGroups, ViewPipelines)>();
    }
}

/// Lets the trace read the depth of the opaque meshes.
pub(super) fn make_depth_readable(mut views: Query<&mut Camera3d, With<ViewVolumes>>) {
    for mut camera in &mut views {
        camera.depth_texture_usages.0 |= TextureUsages::TEXTURE_BINDING.bits();
    }
}
