//! Updates of the states of volumes, from assets and the renderer.

use std::sync::{Arc, Mutex, PoisonError};

use bevy::asset::{AssetLoadError, LoadState, UntypedAssetId};
use bevy::ecs::entity::EntityHashMap;
use bevy::prelude::*;

use super::player::{NextFrame, Playback};
use super::volume_state::{ToldDrawn, VdbVolumeDrawn, VdbVolumeState};
use crate::{VdbColorGrid, VdbEmission, VdbGrid, VdbLoaderError, VdbVolume};

/// The state of volumes in the last rendered frame, with their grids. A resource of both worlds.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct DrawnVolumes(Arc<Mutex<EntityHashMap<(UntypedAssetId, VdbVolumeState)>>>);

impl DrawnVolumes {
    /// Sets the states of a frame; `volumes` gets the map of an earlier frame, to reuse its memory.
    pub fn set(&self, volumes: &mut EntityHashMap<(UntypedAssetId, VdbVolumeState)>) {
        std::mem::swap(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner), volumes);
    }

    /// The state of a volume, with one of its grids or with any.
    fn get(&self, volume: Entity, grid: Option<UntypedAssetId>) -> VdbVolumeState {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = all.get(&volume).filter(|(of, _)| grid.is_none_or(|grid| grid == *of));
        own.map_or(VdbVolumeState::Preparing, |(_, state)| state.clone())
    }
}

/// Updates the states from the renderer's report.
pub(crate) fn update_states(
    mut commands: Commands,
    mut volumes: Query<(
        Entity,
        &VdbVolume,
        Option<&VdbEmission>,
        Option<&VdbColorGrid>,
        Option<&Playback>,
        &mut VdbVolumeState,
        &mut ToldDrawn,
        Has<NextFrame>,
    )>,
    assets: Res<AssetServer>,
    grids: Res<Assets<VdbGrid>>,
    drawn: Option<Res<DrawnVolumes>>,
) {
    for (entity, volume, emission, color, player, mut state, mut told, is_next) in &mut volumes {
        let id = volume.0.id();
        let further = further_grids(emission, color);
        let is_coming = |id| assets.get_load_state(id).is_some_and(|state| state.is_loading());
        let now = if !grids.contains(id) {
            match (assets.get_load_state(id), player) {
                // Before the first frame.
                (None, Some(player)) => match player.reason() {
                    Some(reason) => VdbVolumeState::Failed(reason.to_owned()),
                    None => VdbVolumeState::Loading,
                },
                (Some(LoadState::Failed(error)), _) => VdbVolumeState::Failed(reason(&error)),
                (None, None) if id == AssetId::default() => VdbVolumeState::Failed(NO_FILE.into()),
                _ => VdbVolumeState::Loading,
            }
        } else if further.into_iter().flatten().any(is_coming) {
            VdbVolumeState::Loading
        } else {
            // The last rendered image has the frame before, which is not yet to be prepared.
            let grid = player.is_none().then_some(id.untyped());
            drawn.as_ref().map_or(VdbVolumeState::Unseen, |drawn| drawn.get(entity, grid))
        };
        let is_drawn = now == VdbVolumeState::Drawn;
        state.set_if_neq(now);
        // A player is told of with its first frame, and what fades in belongs to it.
        if is_drawn && !is_next && told.0 != Some(id) && (player.is_none() || told.0.is_none()) {
            told.0 = Some(id);
            commands.trigger(VdbVolumeDrawn { entity });
        }
    }
}

/// The reason reported for a volume with a default handle, for which nothing will ever be loaded.
const NO_FILE: &str = "no file is loaded for it: its handle is the default one, which \
                       AssetServer::load also returns for a path that it refuses";

/// The reason why a grid was not loaded, in the words of Bevy's message, without Bevy's additions
/// to errors of loaders.
fn reason(error: &AssetLoadError) -> String {
    let own = match error {
        AssetLoadError::AssetLoaderError(error) => {
            error.error().downcast_ref::<VdbLoaderError>().map(ToString::to_string)
        }
        _ => None,
    };
    own.unwrap_or_else(|| error.to_string()).trim_end().to_owned()
}

/// The auxiliary grids of a volume.
fn further_grids(
    emission: Option<&VdbEmission>,
    color: Option<&VdbColorGrid>,
) -> [Option<UntypedAssetId>; 2] {
    let emission = emission.map(|emission| match emission {
        VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
            grid.id().untyped()
        }
        VdbEmission::Color { grid, .. } => grid.id().untyped(),
    });
    [emission, color.map(|VdbColorGrid(grid)| grid.id().untyped())]
}

#[cfg(test)]
mod tests {
    use bevy::math::DAffine3;
    use vdb_core::pack::PackKind;
    use vdb_core::tree::Vdb543;

    use super::*;

    #[derive(Default, Resource)]
    struct Told(Vec<Entity>);

    /// A frame of a sequence is not another volume, while another grid of a volume is.
    #[test]
    fn a_player_is_drawn_once_and_stays_drawn() {
        let mut app = App::new();
        app.add_plugins((MinimalPlugins, AssetPlugin::default(), crate::VdbRenderPlugin));
        let drawn = DrawnVolumes::default();
        app.insert_resource(drawn.clone()).init_resource::<Told>();
        app.add_observer(|event: On<VdbVolumeDrawn>, mut told: ResMut<Told>| {
            told.0.push(event.entity);
        });
        let mut add = || {
            let tree = Vdb543::new(0.0);
            let grid = VdbGrid::new("fog", tree, DAffine3::IDENTITY, PackKind::Fog).unwrap();
            app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid)
        };
        let grids = [add(), add(), add()];
        let volume = |grid: &Handle<VdbGrid>| VdbVolume(grid.clone());
        let player = app.world_mut().spawn((volume(&grids[0]), Playback::default())).id();
        let plain = app.world_mut().spawn(volume(&grids[0])).id();
        let mut states = Vec::new();
        for (shown, rendered) in [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2)] {
            for entity in [player, plain] {
                app.world_mut().entity_mut(entity).insert(volume(&grids[shown]));
            }
            let state = (grids[rendered].id().untyped(), VdbVolumeState::Drawn);
            drawn.set(&mut [(player, state.clone()), (plain, state)].into_iter().collect());
            app.update();
            let state = |entity| app.world().get::<VdbVolumeState>(entity).unwrap().clone();
            states.push((state(player), state(plain)));
        }
        let (done, wait) = (VdbVolumeState::Drawn, VdbVolumeState::Preparing);
        let expected =
            [&done, &wait, &done, &wait, &done].map(|plain| (done.clone(), plain.clone()));
        assert_eq!(states, expected);
        let told =
            |entity| app.world().resource::<Told>().0.iter().filter(|own| **own == entity).count();
        assert_eq!((told(player), told(plain)), (1, 3));
    }
}
