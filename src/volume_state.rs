//! How far a volume is on its way into the picture.

use std::sync::{Arc, Mutex, PoisonError};

use bevy::asset::UntypedAssetId;
use bevy::ecs::entity::EntityHashMap;
use bevy::prelude::*;

use crate::{VdbColorGrid, VdbEmission, VdbGrid, VdbVolume};

/// How far a volume is on its way into the picture: a component of every [`VdbVolume`], as of the last frame
/// that was drawn.
///
/// A loading screen ends when nothing is on its way any more:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # #[derive(Component)] struct LoadingScreen;
/// fn end_loading(
///     mut commands: Commands,
///     volumes: Query<&VdbVolumeState>,
///     screen: Single<Entity, With<LoadingScreen>>,
/// ) {
///     if volumes.iter().all(|state| state.is_settled()) {
///         commands.entity(*screen).despawn();
///     }
/// }
/// ```
///
/// [`VdbVolumeDrawn`] tells of the first frame with a volume.
#[derive(Clone, Component, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbVolumeState {
    /// Its grid, or one of its [`VdbEmission`] or [`VdbColorGrid`], is being read, decoded and packed:
    /// [`VdbLoadProgress`](crate::VdbLoadProgress) says how far it is.
    #[default]
    Loading,
    /// Its grid could not be loaded. Bevy has logged why.
    Failed,
    /// Its grids are on their way to the GPU, or a pipeline is being compiled that a camera needs for all of
    /// what it is to show. What earlier pipelines can show is in the picture meanwhile.
    Preparing,
    /// It cannot be shown: it does not fit the GPU, or cameras that see it cannot compute with its numbers.
    /// A message says why.
    NotShown,
    /// Its grids are on the GPU, and no camera sees it: it is hidden, empty or out of the picture, or there
    /// is no renderer.
    Unseen,
    /// It is in the picture, with all that it is to have, of every camera that sees it.
    Drawn,
}

impl VdbVolumeState {
    /// Whether nothing is left to wait for: it is drawn, or will not be as things are.
    pub fn is_settled(self) -> bool {
        !matches!(self, Self::Loading | Self::Preparing)
    }
}

/// A volume is in the picture for the first time: an event of its entity, triggered in the frame after that
/// picture. Of every volume, and again of one that has got another grid.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// let smoke = VdbVolume(assets.load("smoke.vdb"));
/// commands.spawn(smoke).observe(|drawn: On<VdbVolumeDrawn>| println!("{} is there", drawn.entity));
/// # }
/// ```
#[derive(Clone, Copy, Debug, EntityEvent, PartialEq, Eq)]
pub struct VdbVolumeDrawn {
    /// The volume's.
    pub entity: Entity,
}

/// With which grid it has been told that a volume is drawn.
#[derive(Clone, Component, Debug, Default)]
pub(crate) struct ToldDrawn(Option<AssetId<VdbGrid>>);

/// What has become of volumes in the last frame that was drawn: with which grid, and how far they got.
/// A resource of both worlds.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct DrawnVolumes(Arc<Mutex<EntityHashMap<(UntypedAssetId, VdbVolumeState)>>>);

impl DrawnVolumes {
    /// Takes what a frame tells, and gives back the memory of an older one's.
    pub fn set(&self, volumes: &mut EntityHashMap<(UntypedAssetId, VdbVolumeState)>) {
        std::mem::swap(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner), volumes);
    }

    fn get(&self, volume: Entity, grid: UntypedAssetId) -> VdbVolumeState {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = all.get(&volume).filter(|(of, _)| *of == grid);
        own.map_or(VdbVolumeState::Preparing, |(_, state)| *state)
    }
}

/// Brings the states up to date with what the renderer tells.
pub(crate) fn update_states(
    mut commands: Commands,
    mut volumes: Query<(
        Entity,
        &VdbVolume,
        Option<&VdbEmission>,
        Option<&VdbColorGrid>,
        &mut VdbVolumeState,
        &mut ToldDrawn,
    )>,
    assets: Res<AssetServer>,
    grids: Res<Assets<VdbGrid>>,
    drawn: Option<Res<DrawnVolumes>>,
) {
    for (entity, volume, emission, color, mut state, mut told) in &mut volumes {
        let id = volume.0.id();
        let further = further_grids(emission, color);
        let is_coming = |id| assets.get_load_state(id).is_some_and(|state| state.is_loading());
        let now = if !grids.contains(id) {
            let failed = assets.get_load_state(id).is_some_and(|state| state.is_failed());
            if failed { VdbVolumeState::Failed } else { VdbVolumeState::Loading }
        } else if further.into_iter().flatten().any(is_coming) {
            VdbVolumeState::Loading
        } else {
            drawn.as_ref().map_or(VdbVolumeState::Unseen, |drawn| drawn.get(entity, id.untyped()))
        };
        state.set_if_neq(now);
        if now == VdbVolumeState::Drawn && told.0 != Some(id) {
            told.0 = Some(id);
            commands.trigger(VdbVolumeDrawn { entity });
        }
    }
}

/// The grids of a volume besides its own.
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
