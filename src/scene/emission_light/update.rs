//! Spawns and updates the lights of fires.

use std::f32::consts::PI;
use std::sync::Arc;

use bevy::camera::visibility::RenderLayers;
use bevy::ecs::entity::EntityHashMap;
use bevy::ecs::query::QueryData;
use bevy::math::DMat3;
use bevy::prelude::*;
use bevy::transform::helper::TransformHelper;
use vdb_core::emitters::{Lamp, Smoke, Source, fit_lamps};

use super::component::VdbEmissionLight;
use super::summary::{Summaries, Summary, When};
use crate::scene::player::{FramesInMemory, NextFrame, Playback, Share};
use crate::{
    VdbEmission, VdbGrid, VdbMaterial, VdbPlayer, VdbPlayerStatus, VdbVectorGrid, VdbVolume,
};

/// A light of a fire: a child of the volume.
#[derive(Clone, Copy, Component, Debug)]
pub(crate) struct FireLight;

/// The inputs from which the lights of each volume were made. Lights are remade only if these change.
pub(super) type Lit = EntityHashMap<Inputs>;

#[derive(Debug, PartialEq)]
pub(super) struct Inputs {
    fires: Vec<Fire>,
    light: VdbEmissionLight,
    material: VdbMaterial,
    scene_from_local: DMat3,
    layers: Option<RenderLayers>,
}

/// A fire, or one of the two volumes of a cross-fade.
#[derive(Debug)]
struct Fire {
    emission: VdbEmission,
    share: f32,
    summary: Arc<Summary>,
}

impl PartialEq for Fire {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.summary, &other.summary)
            && self.share == other.share
            && self.emission == other.emission
    }
}

/// A volume whose fire lights its surroundings.
#[derive(QueryData)]
pub(super) struct Burning {
    entity: Entity,
    volume: &'static VdbVolume,
    emission: &'static VdbEmission,
    light: &'static VdbEmissionLight,
    material: &'static VdbMaterial,
    layers: Option<&'static RenderLayers>,
    share: Option<&'static Share>,
    children: Option<&'static Children>,
}

/// Records which grids have changed or been removed.
pub(super) fn follow_grids(
    mut summaries: ResMut<Summaries>,
    mut grids: MessageReader<AssetEvent<VdbGrid>>,
    mut vectors: MessageReader<AssetEvent<VdbVectorGrid>>,
) {
    grids.read().for_each(|event| follow(&mut summaries, event));
    vectors.read().for_each(|event| follow(&mut summaries, event));
}

fn follow<A: Asset>(summaries: &mut Summaries, event: &AssetEvent<A>) {
    match event {
        AssetEvent::Modified { id } => summaries.changed(id.untyped()),
        AssetEvent::Removed { id } => summaries.gone(id.untyped()),
        _ => {}
    }
}

/// Sets the lights of all fires.
pub(super) fn update_lights(
    mut commands: Commands,
    mut summaries: ResMut<Summaries>,
    (grids, vectors): (Res<Assets<VdbGrid>>, Res<Assets<VdbVectorGrid>>),
    fires: Query<Burning>,
    mut lit: Local<Lit>,
    next_frames: Query<(&VdbVolume, &VdbEmission, &Share), With<NextFrame>>,
    lights: Query<(Entity, &ChildOf), With<FireLight>>,
    transforms: TransformHelper,
) {
    let assets = (&*grids, &*vectors);
    for fire in &fires {
        let children = || fire.children.into_iter().flatten();
        let share = fire.share.map_or(1.0, |share| share.0);
        let next = children().filter_map(|child| next_frames.get(*child).ok());
        let next = next.map(|(volume, emission, share)| (volume, emission, share.0));
        let all = [(fire.volume, fire.emission, share)].into_iter().chain(next);
        // A frame of a sequence that has no fire.
        let all: Vec<_> = all.filter(|(_, emission, _)| emission.has_grid()).collect();
        let summarised = all.iter().filter_map(|(volume, emission, share)| {
            let summary = summaries.get((emission, volume), assets, When::Now)?;
            Some(Fire { emission: (*emission).clone(), share: *share, summary })
        });
        let parts: Vec<Fire> = summarised.collect();
        if parts.len() < all.len() {
            // Until its light has been computed, a dark one takes its place, so that the first pipelines
            // that are compiled are those for lamps.
            if !children().any(|child| lights.contains(*child)) {
                let dark = PointLight {
                    intensity: 0.0,
                    shadow_maps_enabled: fire.light.shadows,
                    ..default()
                };
                commands.spawn((FireLight, ChildOf(fire.entity), dark));
            }
            continue;
        }
        let Ok(place) = transforms.compute_global_transform(fire.entity) else { continue };
        let inputs = Inputs {
            fires: parts,
            light: fire.light.nearest_valid(),
            material: fire.material.clone(),
            scene_from_local: place.affine().matrix3.as_dmat3(),
            layers: fire.layers.cloned(),
        };
        if lit.get(&fire.entity) == Some(&inputs) {
            continue;
        }
        let mut own = children().copied().filter(|child| lights.contains(*child));
        for (light, transform) in inputs.lights() {
            let light = (light, transform);
            let entity = match own.next() {
                Some(entity) => commands.entity(entity).insert(light).id(),
                None => commands.spawn((FireLight, ChildOf(fire.entity), light)).id(),
            };
            match &inputs.layers {
                Some(layers) => commands.entity(entity).insert(layers.clone()),
                None => commands.entity(entity).remove::<RenderLayers>(),
            };
        }
        own.for_each(|entity| commands.entity(entity).despawn());
        lit.insert(fire.entity, inputs);
    }
    lit.retain(|entity, _| fires.contains(*entity));
    for (light, volume) in &lights {
        if !fires.contains(volume.0) {
            commands.entity(light).despawn();
        }
    }
}

/// Summarises the frames that a player has loaded ahead, so that the lights change with the frame.
pub(super) fn look_ahead(
    mut summaries: ResMut<Summaries>,
    frames: FramesInMemory,
    assets: (Res<Assets<VdbGrid>>, Res<Assets<VdbVectorGrid>>),
    players: Query<
        (&VdbPlayer, &Playback, &VdbEmission),
        (With<VdbEmissionLight>, Changed<VdbPlayerStatus>),
    >,
) {
    for (player, playback, emission) in &players {
        for (emission, volume) in frames.fires(player, playback, emission) {
            summaries.get((&emission, &volume), (&assets.0, &assets.1), When::Later);
        }
    }
}

/// Forgets all summaries when nothing burns any more.
pub(super) fn clear(mut summaries: ResMut<Summaries>) {
    if !summaries.is_empty() {
        summaries.clear();
    }
}

/// The luminance of linear Rec. 709.
const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

impl Inputs {
    /// The lights, with their positions in the volume.
    fn lights(&self) -> Vec<(PointLight, Transform)> {
        let smoke = self.smoke();
        let of = |fire: &Fire| {
            let mut sources = fire.summary.sources(&fire.emission, smoke.as_ref());
            sources.iter_mut().for_each(|source| source.intensity *= fire.share);
            sources
        };
        let sources: Vec<Source> = self.fires.iter().flat_map(of).collect();
        // The emission is per unit of length of the scene, so the light grows with the volume.
        let growth = self.scene_from_local.determinant().abs() as f32;
        let lamps = fit_lamps(&sources, self.light.max_lights as usize);
        lamps.iter().filter_map(|lamp| self.light_of(lamp, growth)).collect()
    }

    /// The smoke that absorbs light, unless shadows account for it.
    fn smoke(&self) -> Option<Smoke> {
        let albedo = LinearRgba::from(self.material.base_color).to_vec3();
        (!self.light.shadows).then_some(Smoke {
            scene_from_world: self.scene_from_local,
            density_scale: self.material.density_scale.max(0.0),
            albedo,
            anisotropy: self.material.anisotropy,
        })
    }

    /// Bevy's light for a lamp.
    fn light_of(&self, lamp: &Lamp, growth: f32) -> Option<(PointLight, Transform)> {
        let candela = lamp.intensity * growth * self.light.intensity;
        let luminous = candela.dot(LUMINANCE);
        let color = candela / luminous;
        let range = (luminous / self.light.min_illuminance).sqrt();
        let radius = (lamp.radius * growth.cbrt()).min(range);
        let is_sound = luminous > 0.0 && luminous.is_finite() && color.is_finite();
        is_sound.then(|| {
            let light = PointLight {
                color: LinearRgba::from_vec3(color).into(),
                intensity: 4.0 * PI * luminous,
                range,
                radius,
                shadow_maps_enabled: self.light.shadows,
                // The smoke in which the fire burns begins at the light.
                shadow_map_near_z: (0.1 * radius)
                    .clamp(1e-3, PointLight::DEFAULT_SHADOW_MAP_NEAR_Z),
                ..default()
            };
            (light, Transform::from_translation(lamp.position))
        })
    }
}
