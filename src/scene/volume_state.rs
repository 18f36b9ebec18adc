//! How far a volume is on its way into the picture.

use bevy::prelude::*;

use crate::VdbGrid;

/// How far a volume is on its way into the picture: a component of every [`VdbVolume`](crate::VdbVolume), as of the last frame
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
    /// Its grid, or one of its [`VdbEmission`](crate::VdbEmission) or
    /// [`VdbColorGrid`](crate::VdbColorGrid), is being read, decoded and packed:
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
pub(crate) struct ToldDrawn(pub Option<AssetId<VdbGrid>>);
