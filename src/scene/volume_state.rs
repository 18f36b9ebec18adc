//! The states of volumes, from loading to being drawn.

use bevy::prelude::*;

use crate::VdbGrid;

/// The state of a volume, from loading to being drawn, as of the last rendered frame: a component
/// of every [`VdbVolume`](crate::VdbVolume).
///
/// A loading screen can end once every volume is settled, which includes those that have failed:
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
///         for reason in volumes.iter().filter_map(|state| state.reason()) {
///             println!("a volume is missing: {reason}");
///         }
///         commands.entity(*screen).despawn();
///     }
/// }
/// ```
///
/// To be notified of the first frame with a volume, observe [`VdbVolumeDrawn`].
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq, Hash)]
#[non_exhaustive]
pub enum VdbVolumeState {
    /// Its grid, or the grid of its [`VdbEmission`](crate::VdbEmission) or
    /// [`VdbColorGrid`](crate::VdbColorGrid), is being read, decoded and packed, or its
    /// [`VdbPlayer`](crate::VdbPlayer) has not shown a frame yet. See
    /// [`VdbLoadProgress`](crate::VdbLoadProgress).
    #[default]
    Loading,
    /// Its grid could not be loaded, for this reason. If loading failed, Bevy has logged the reason
    /// with the file path; a default handle or a sequence without frames is reported only here.
    Failed(String),
    /// Its grids are being uploaded to the GPU, or a pipeline that a camera needs is being
    /// compiled. Until then, the volume is drawn as far as existing pipelines allow.
    Preparing,
    /// It cannot be shown, for this reason: it does not fit the GPU, or its transform is out of
    /// range. A log message says the same, with the name of the grid and the entity.
    NotShown(String),
    /// Its grids are on the GPU, but no camera sees it: it is hidden, empty or out of view, the
    /// camera's image has no pixels, or there is no renderer.
    Unseen,
    /// It is displayed completely by every camera that sees it.
    Drawn,
}

impl VdbVolumeState {
    /// Whether there is nothing left to wait for: the volume is drawn, or will not be drawn unless
    /// something changes.
    pub fn is_settled(&self) -> bool {
        !matches!(self, Self::Loading | Self::Preparing)
    }

    /// The reason why the volume could not be loaded or cannot be shown.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Failed(reason) | Self::NotShown(reason) => Some(reason),
            Self::Loading | Self::Preparing | Self::Unseen | Self::Drawn => None,
        }
    }
}

/// An event of a volume's entity, triggered in the frame after the volume first appears on screen,
/// and again after its grid has been replaced by another; for a [`VdbPlayer`](crate::VdbPlayer), only
/// with the first frame of a sequence.
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
pub(crate) struct ToldDrawn(pub Option<AssetId<VdbGrid>>);
