//! How far a volume is from being visible.

use std::sync::{Arc, Mutex, PoisonError};

use bevy::asset::UntypedAssetId;
use bevy::ecs::entity::EntityHashMap;
use bevy::prelude::*;

use crate::{VdbColorGrid, VdbEmission, VdbGrid, VdbVolume};

/// How far a volume is from being visible, as of the last rendered frame: a component of every
/// [`VdbVolume`].
///
/// A loading screen can end once every volume is settled:
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
/// To be notified of the first frame with a volume, observe [`VdbVolumeDrawn`].
#[derive(Clone, Component, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbVolumeState {
    /// Its grid, or that of a [`VdbEmission`] or [`VdbColorGrid`], is being read, decoded and
    /// packed. See [`VdbLoadProgress`](crate::VdbLoadProgress).
    #[default]
    Loading,
    /// Its grid could not be loaded. Bevy has logged the reason.
    Failed,
    /// Its grids are on their way to the GPU, or a pipeline that a camera needs is being compiled.
    /// Meanwhile, the volume is drawn as far as existing pipelines can.
    Preparing,
    /// It cannot be shown: it does not fit the GPU, or its transform is out of range. A message
    /// gives the reason.
    NotShown,
    /// Its grids are on the GPU, but no camera sees it: it is hidden, empty or out of view, or
    /// there is no renderer.
    Unseen,
    /// It is displayed completely by every camera that sees it.
    Drawn,
}

impl VdbVolumeState {
    /// Whether there is nothing left to wait for: the volume is drawn, or will not be unless
    /// something changes.
    pub fn is_settled(self) -> bool {
        !matches!(self, Self::Loading | Self::Preparing)
    }
}

/// A volume is on screen for the first time: an event of its entity, triggered in the following
/// frame. Triggered again when the volume gets another grid.
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
    /// The entity of the volume.
    pub entity: Entity,
}

/// The grid with which the volume was reported as drawn.
#[derive(Clone, Component, Debug, Default)]
pub(crate) struct ToldDrawn(Option<AssetId<VdbGrid>>);

/// The state of volumes in the last rendered frame, with their grids. A resource of both worlds.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct DrawnVolumes(Arc<Mutex<EntityHashMap<(UntypedAssetId, VdbVolumeState)>>>);

impl DrawnVolumes {
    /// Takes the states of a frame, and returns the memory of older ones.
    pub fn set(&self, volumes: &mut EntityHashMap<(UntypedAssetId, VdbVolumeState)>) {
        std::mem::swap(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner), volumes);
    }

    fn get(&self, volume: Entity, grid: UntypedAssetId) -> VdbVolumeState {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = all.get(&volume).filter(|(of, _)| *of == grid);
        own.map_or(VdbVolumeState::Preparing, |(_, state)| *state)
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
