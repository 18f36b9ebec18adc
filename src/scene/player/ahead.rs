//! The frames that players have in memory, for systems that prepare for them.

use bevy::ecs::system::SystemParam;
use bevy::prelude::*;

use super::component::VdbPlayer;
use super::frames::Frames;
use super::playback::Playback;
use super::show::{emission_of, grid_of};
use crate::{VdbEmission, VdbFile, VdbGrid, VdbVolume};

/// The frames that players have in memory.
#[derive(SystemParam)]
pub(crate) struct FramesInMemory<'w> {
    frames: Res<'w, Frames>,
    files: Res<'w, Assets<VdbFile>>,
    grids: Res<'w, Assets<VdbGrid>>,
}

impl FramesInMemory<'_> {
    /// The fires of a player's frames: the future grids of its emission and its volume.
    pub fn fires(
        &self,
        player: &VdbPlayer,
        playback: &Playback,
        emission: &VdbEmission,
    ) -> Vec<(VdbEmission, VdbVolume)> {
        let sequence = playback.sequence;
        let loaded = self.frames.of(sequence).filter_map(|(index, _)| {
            let file = self.files.get(self.frames.loaded((sequence, index))?)?;
            let mut labels = playback.labels.clone();
            let grid = grid_of(file, &self.grids, player, &mut labels).ok()?;
            let emission = match player.sets_roles {
                true => emission_of(emission, file, &labels),
                false => emission.clone(),
            };
            emission.has_grid().then_some((emission, VdbVolume(grid)))
        });
        loaded.collect()
    }
}
