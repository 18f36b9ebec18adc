//! A backend of Bevy's picking for volumes: the cargo feature `picking`.

use bevy::camera::visibility::RenderLayers;
use bevy::picking::PickingSystems;
use bevy::picking::backend::ray::RayMap;
use bevy::picking::backend::{HitData, PointerHits};
use bevy::prelude::*;

use crate::{VdbCamera, VdbRayCastSettings, VdbRayVisibility, VdbSpatialQuery};

/// Lets pointers hover, click and drag [`VdbVolume`](crate::VdbVolume)s: a backend of Bevy's
/// picking. Needs the cargo feature `picking` and `DefaultPlugins` or `DefaultPickingPlugins`.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// commands.spawn(VdbVolume(assets.load("models/teapot.vdb#surface"))).observe(
///     |click: On<Pointer<Click>>| {
///         if let Some(hit) = click.hit.extra_as::<VdbRayHit>() {
///             println!("voxel {} of {}", hit.voxel, hit.entity);
///         }
///     },
/// );
/// # }
/// ```
///
/// A volume is under a pointer where the camera shows it: see [`VdbSpatialQuery`]. Depth is the
/// distance from the near plane, as for meshes, so the nearer of a mesh and a volume is hovered.
/// `Pickable`, `RenderLayers`, visibility, viewports and [`VdbCamera::enabled`] are obeyed. The
/// `extra` of the [`HitData`] is the [`VdbRayHit`](crate::VdbRayHit).
#[derive(Clone, Copy, Debug, Default)]
pub struct VdbPickingPlugin;

/// Settings for picking volumes: a resource.
#[derive(Clone, Debug, PartialEq, Reflect, Resource)]
#[reflect(Resource, Clone, Debug, Default, PartialEq)]
pub struct VdbPickingSettings {
    /// The optical depth at which fog counts as hit: see [`VdbRayCastSettings::optical_depth`]. `ln
    /// 2` by default; infinity to ignore fog.
    pub optical_depth: f32,
    /// Whether volumes that no camera sees can be picked. [`VdbRayVisibility::VisibleInView`] by
    /// default.
    pub visibility: VdbRayVisibility,
}

impl Default for VdbPickingSettings {
    fn default() -> Self {
        Self {
            optical_depth: VdbRayCastSettings::default().optical_depth,
            visibility: VdbRayVisibility::VisibleInView,
        }
    }
}

impl Plugin for VdbPickingPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<VdbPickingSettings>()
            .register_type::<VdbPickingSettings>()
            .add_systems(PreUpdate, update_hits.in_set(PickingSystems::Backend));
    }
}

fn update_hits(
    settings: Res<VdbPickingSettings>,
    rays: Res<RayMap>,
    cameras: Query<
        (&Camera, &GlobalTransform, Option<&VdbCamera>, Option<&RenderLayers>),
        With<Camera3d>,
    >,
    targets: Query<(Option<&Pickable>, Option<&RenderLayers>)>,
    volumes: VdbSpatialQuery,
    mut hits: MessageWriter<PointerHits>,
) {
    for (id, &ray) in rays.iter() {
        let Ok((camera, transform, shows, layers)) = cameras.get(id.camera) else { continue };
        if shows.is_some_and(|shows| !shows.enabled) {
            continue;
        }
        let layers = layers.cloned().unwrap_or_default();
        let filter = |entity| {
            targets.get(entity).is_ok_and(|(pickable, own)| {
                pickable.is_none_or(|pickable| *pickable != Pickable::IGNORE)
                    && layers.intersects(own.unwrap_or_default())
            })
        };
        let cast = VdbRayCastSettings {
            max_distance: distance_to_far_plane(camera, transform, ray),
            optical_depth: settings.optical_depth,
            visibility: settings.visibility,
            filter: &filter,
        };
        let picks: Vec<(Entity, HitData)> = volumes
            .cast_ray(ray, &cast)
            .into_iter()
            .map(|hit| {
                let (position, normal) = (Some(hit.position), Some(hit.normal));
                let entity = hit.entity;
                let data = HitData::new_with_extra(id.camera, hit.distance, position, normal, hit);
                (entity, data)
            })
            .collect();
        if !picks.is_empty() {
            hits.write(PointerHits::new(id.pointer, picks, camera.order as f32));
        }
    }
}

/// The distance to the far plane along a ray; infinity if there is none.
fn distance_to_far_plane(camera: &Camera, transform: &GlobalTransform, ray: Ray3d) -> f32 {
    let ndc = camera.world_to_ndc(transform, ray.origin);
    let end = ndc.and_then(|ndc| camera.ndc_to_world(transform, ndc.with_z(0.0)));
    end.filter(|end| end.is_finite()).map_or(f32::INFINITY, |end| end.distance(ray.origin))
}
