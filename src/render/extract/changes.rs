//! Detection of changes in the scene that the data prepared for a view does not contain: grids,
//! lights, and meshes that cast shadows. Runs only while a camera averages frames or reflections.

use bevy::asset::AssetEvent;
use bevy::ecs::entity::EntityHashMap;
use bevy::ecs::system::SystemParam;
use bevy::light::{IrradianceVolume, ParallaxCorrection};
use bevy::mesh::morph::MeshMorphWeights;
use bevy::mesh::skinning::SkinnedMesh;
use bevy::pbr::DistanceFog;
use bevy::prelude::*;
use bevy::render::Extract;

use super::hash::{HashValue, hash_of};
use crate::{VdbGrid, VdbQuality, VdbVectorGrid};

/// The numbers of frames in which parts of the scene have changed.
#[derive(Clone, Copy, Debug, Default, Resource)]
pub(crate) struct SceneChanges {
    pub grids: u64,
    pub lights: u64,
    /// Changes of meshes that cast shadows.
    pub casters: u64,
}

type IsLight = Or<(With<DirectionalLight>, With<PointLight>, With<SpotLight>, With<RectLight>)>;
type LightChanged = Or<(
    Changed<DirectionalLight>,
    Changed<PointLight>,
    Changed<SpotLight>,
    Changed<RectLight>,
    Changed<GlobalTransform>,
    Changed<InheritedVisibility>,
)>;
type LightData<'a> = (
    Entity,
    (
        Option<&'a DirectionalLight>,
        Option<&'a PointLight>,
        Option<&'a SpotLight>,
        Option<&'a RectLight>,
    ),
    (&'a GlobalTransform, &'a InheritedVisibility),
);
type MeshChanged = Or<(
    Changed<Mesh3d>,
    Changed<MeshMorphWeights>,
    Changed<GlobalTransform>,
    Changed<InheritedVisibility>,
)>;
type MeshData<'a> = (
    Entity,
    (&'a Mesh3d, Option<&'a MeshMorphWeights>),
    (&'a GlobalTransform, &'a InheritedVisibility),
);
type ProbeData<'a> = (
    (Entity, &'a LightProbe, Option<&'a ParallaxCorrection>),
    (Option<&'a EnvironmentMapLight>, Option<&'a IrradianceVolume>),
    (&'a GlobalTransform, &'a InheritedVisibility),
);
type Surroundings<'a> =
    (Entity, Option<&'a EnvironmentMapLight>, Option<&'a AmbientLight>, Option<&'a DistanceFog>);

/// The parts of the app's world that are watched for changes.
#[derive(SystemParam)]
pub(crate) struct Scene<'w, 's> {
    qualities: Query<'w, 's, &'static VdbQuality>,
    lights: Query<'w, 's, LightData<'static>, (IsLight, LightChanged)>,
    meshes: Query<'w, 's, MeshData<'static>, MeshChanged>,
    skins: Query<'w, 's, &'static SkinnedMesh>,
    moved: Query<'w, 's, (), Changed<GlobalTransform>>,
    cameras: Query<'w, 's, Surroundings<'static>, With<Camera3d>>,
    probes: Query<'w, 's, ProbeData<'static>>,
    ambient: Option<Res<'w, GlobalAmbientLight>>,
    events: (
        MessageReader<'w, 's, AssetEvent<VdbGrid>>,
        MessageReader<'w, 's, AssetEvent<VdbVectorGrid>>,
        MessageReader<'w, 's, AssetEvent<Mesh>>,
    ),
    gone: (
        RemovedComponents<'w, 's, DirectionalLight>,
        RemovedComponents<'w, 's, PointLight>,
        RemovedComponents<'w, 's, SpotLight>,
        RemovedComponents<'w, 's, RectLight>,
        RemovedComponents<'w, 's, Mesh3d>,
    ),
}

/// Hashes of entities, because Bevy's change detection also reports writes of equal values.
#[derive(Default)]
pub(crate) struct Known(EntityHashMap<u64>);

impl Known {
    /// Stores the hash of an entity's components; returns whether it is new or has changed.
    fn differs(&mut self, entity: Entity, what: impl HashValue) -> bool {
        let number = hash_of(&what);
        self.0.insert(entity, number) != Some(number)
    }
}

pub(crate) fn extract_changes(
    mut scene: Extract<Scene>,
    mut known: Local<Known>,
    mut around: Local<u64>,
    mut changes: ResMut<SceneChanges>,
) {
    let scene = &mut *scene;
    let (grids, vectors, meshes) = &mut scene.events;
    let grid_events = grids.read().count() + vectors.read().count();
    let mesh_events =
        meshes.read().filter(|event| matches!(event, AssetEvent::Modified { .. })).count();
    let (suns, points, spots, panes, shapes) = &mut scene.gone;
    let lamps_gone = points.read().count() + spots.read().count() + panes.read().count();
    let lights_gone = suns.read().count() + lamps_gone;
    let meshes_gone = shapes.read().count();
    let averages = |quality: &VdbQuality| {
        quality.accumulate > 1 || (quality.denoise && quality.reflections > 0)
    };
    if !scene.qualities.iter().any(averages) {
        known.0.clear();
        return;
    }
    let mut lights = lights_gone > 0;
    for (entity, kind, place) in &scene.lights {
        lights |= known.differs(entity, (kind, place));
    }
    let cameras: Vec<_> = scene.cameras.iter().collect();
    let probes: Vec<_> = scene.probes.iter().collect();
    let now = hash_of(&(cameras, probes, scene.ambient.as_deref()));
    lights |= std::mem::replace(&mut *around, now) != now;
    let mut casters = meshes_gone + mesh_events > 0;
    for (entity, shape, place) in &scene.meshes {
        casters |= known.differs(entity, (shape, place));
    }
    casters |= scene.skins.iter().flat_map(|skin| &skin.joints).any(|at| scene.moved.contains(*at));
    changes.grids += u64::from(grid_events > 0);
    changes.lights += u64::from(lights);
    changes.casters += u64::from(casters);
}
