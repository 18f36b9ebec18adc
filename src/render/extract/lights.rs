//! Extraction of light properties that Bevy does not extract.

use bevy::camera::visibility::InheritedVisibility;
use bevy::light::NotShadowCaster;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::RenderEntity;

use crate::VdbSun;
use crate::render::gpu::non_negative;
use crate::scene::FireLight;

/// The directional lights that light volumes differently from meshes.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct ExtractedSuns(pub Vec<ExtractedSun>);

#[derive(Clone, Copy, Debug)]
pub(crate) struct ExtractedSun {
    /// The direction to the light in world space, equal to Bevy's bit for bit, so that shaders can
    /// identify the light.
    pub direction: Vec3,
    /// The factor of the light's illuminance on volumes.
    pub factor: f32,
    /// The apparent size in radians; 0 for hard shadows.
    pub angular_diameter: f32,
    pub samples: u32,
}

/// The largest apparent size in radians; the shadow of a larger sun would be nothing but penumbra.
const WIDEST_SUN: f32 = 1.0;
const MAX_SAMPLES: u32 = 256;

pub(crate) fn extract_suns(
    lights: Extract<
        Query<(&GlobalTransform, &VdbSun, &InheritedVisibility), With<DirectionalLight>>,
    >,
    mut extracted: ResMut<ExtractedSuns>,
) {
    let sound = |sun: &VdbSun| {
        (0.0..=WIDEST_SUN).contains(&sun.angular_diameter)
            && (1..=MAX_SAMPLES).contains(&sun.samples)
    };
    if lights.iter().any(|(_, sun, _)| !sound(sun)) {
        warn_once!(
            "a VdbSun is used with the nearest valid values: give it an angular_diameter from 0 to \
             1 and samples from 1 to 256"
        );
    }
    let suns = lights.iter().filter(|(_, sun, visible)| {
        visible.get() && (sun.intensity != 1.0 || sun.angular_diameter > 0.0)
    });
    extracted.0.clear();
    extracted.0.extend(suns.map(|(transform, sun, _)| ExtractedSun {
        direction: transform.back().into(),
        factor: non_negative(sun.intensity),
        angular_diameter: non_negative(sun.angular_diameter).min(WIDEST_SUN),
        samples: sun.samples.clamp(1, MAX_SAMPLES),
    }));
}

/// The lights of fires, as render entities.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct ExtractedFireLights(pub Vec<Entity>);

pub(crate) fn extract_fire_lights(
    lights: Extract<Query<RenderEntity, With<FireLight>>>,
    mut extracted: ResMut<ExtractedFireLights>,
) {
    extracted.0.clear();
    extracted.0.extend(&lights);
}

/// Whether any mesh may cast shadows.
#[derive(Clone, Copy, Debug, Default, Resource)]
pub(crate) struct MeshCasters(pub bool);

pub(crate) fn extract_mesh_casters(
    meshes: Extract<Query<&InheritedVisibility, (With<Mesh3d>, Without<NotShadowCaster>)>>,
    mut casters: ResMut<MeshCasters>,
) {
    casters.0 = meshes.iter().any(|visible| visible.get());
}

/// The environment maps of a camera: a component of render entities.
#[derive(Clone, Copy, Component, Debug, PartialEq)]
pub(crate) struct ExtractedEnvironment {
    pub diffuse: AssetId<Image>,
    pub specular: AssetId<Image>,
}

pub(crate) fn extract_environments(
    mut commands: Commands,
    cameras: Extract<Query<(RenderEntity, Option<&EnvironmentMapLight>), With<Camera3d>>>,
) {
    for (entity, maps) in &cameras {
        let mut entity = commands.entity(entity);
        match maps {
            Some(maps) => entity.insert(ExtractedEnvironment {
                diffuse: maps.diffuse_map.id(),
                specular: maps.specular_map.id(),
            }),
            None => entity.remove::<ExtractedEnvironment>(),
        };
    }
}
