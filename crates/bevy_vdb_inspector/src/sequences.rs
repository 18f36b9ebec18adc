//! The timeline at the bottom of the window.

use bevy::prelude::*;
use bevy_egui::{EguiContext, PrimaryEguiContext};
use bevy_vdb::{VdbPlayer, VdbPlayerStatus, VdbSequence};

use super::state::VdbInspector;
use super::timeline::VdbTimeline;

/// Shows the timeline of the selected volume's player, or of the first one.
pub(super) fn show(
    inspector: Res<VdbInspector>,
    mut contexts: Query<&mut EguiContext, With<PrimaryEguiContext>>,
    sequences: Res<Assets<VdbSequence>>,
    mut players: Query<(Entity, &mut VdbPlayer, &VdbPlayerStatus)>,
) {
    if !inspector.open || !inspector.timeline {
        return;
    }
    let chosen = inspector.volume.filter(|volume| players.contains(*volume));
    let chosen = chosen.or_else(|| players.iter().map(|(entity, ..)| entity).min());
    let (Some(chosen), Ok(mut context)) = (chosen, contexts.single_mut()) else { return };
    let Ok((_, player, status)) = players.get_mut(chosen) else { return };
    // Until it is loaded, there is nothing to show.
    let Some(sequence) = sequences.get(&player.sequence) else { return };
    VdbTimeline::new(&mut [player], status, sequence).show_at_bottom(context.get_mut());
}
