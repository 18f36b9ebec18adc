//! Cross-fades from each frame to the next. Extinctions of overlapping volumes add up, so a
//! cross-fade consists of two volumes, each with its share of extinction and emission.

use bevy::camera::visibility::RenderLayers;
use bevy::ecs::query::QueryData;
use bevy::light::{NotShadowCaster, NotShadowReceiver};
use bevy::prelude::*;
use vdb_core::pack::PackKind;

use super::component::{VdbFrameBlend, VdbPlayer};
use super::frames::Frames;
use super::playback::Playback;
use super::show::{color_of, emission_of, grid_of};
use crate::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbMaterial, VdbVolume};

/// The fraction of a volume's extinction and emission that is displayed, from 0 to 1. Without this
/// component, all of it is.
#[derive(Clone, Copy, Component, Debug, PartialEq)]
pub(crate) struct Share(pub f32);

/// The volume with the next frame of a player: a child of the player's entity.
#[derive(Clone, Copy, Component, Debug)]
pub(crate) struct NextFrame;

/// The components that the next frame copies from the one on screen.
#[derive(QueryData)]
pub(super) struct Look {
    volume: &'static VdbVolume,
    material: &'static VdbMaterial,
    emission: Option<&'static VdbEmission>,
    color: Option<&'static VdbColorGrid>,
    layers: Option<&'static RenderLayers>,
    place: &'static GlobalTransform,
    casts_no_shadow: Has<NotShadowCaster>,
    receives_no_shadow: Has<NotShadowReceiver>,
}

/// The next frame of a player, and its share.
struct Next {
    grid: Handle<VdbGrid>,
    emission: Option<VdbEmission>,
    color: Option<VdbColorGrid>,
    share: f32,
}

/// Divides extinction and emission between the frame on screen and the next one.
pub(super) fn fade(
    mut commands: Commands,
    (frames, files, grids): (Res<Frames>, Res<Assets<VdbFile>>, Res<Assets<VdbGrid>>),
    mut players: Query<
        (Entity, &VdbPlayer, &mut Playback, Look, Option<&Share>, Option<&Children>),
        Without<NextFrame>,
    >,
    next_frames: Query<(Entity, &ChildOf), With<NextFrame>>,
) {
    for (entity, player, mut playback, look, share, children) in &mut players {
        let fades = player.blend == VdbFrameBlend::CrossFade;
        if !fades && share.is_none() {
            continue;
        }
        let next = if fades {
            let playback = playback.bypass_change_detection();
            next_frame(player, playback, &look, &frames, (&files, &grids))
        } else {
            None
        };
        let mut children = children.into_iter().flatten().copied();
        let child = children.find(|child| next_frames.contains(*child));
        let own = Share(next.as_ref().map_or(1.0, |next| 1.0 - next.share));
        match (next, child) {
            (Some(next), child) => {
                let child = child.unwrap_or_else(|| {
                    commands.spawn((NextFrame, ChildOf(entity), *look.place)).id()
                });
                dress(commands.entity(child), next, &look);
            }
            (None, Some(child)) => commands.entity(child).despawn(),
            (None, None) => {}
        }
        let mut entity = commands.entity(entity);
        if !fades {
            entity.remove::<Share>();
        } else if share != Some(&own) {
            entity.insert(own);
        }
    }
    // Remove what belongs to entities that are no longer players.
    for (child, parent) in &next_frames {
        if !players.contains(parent.0) {
            commands.entity(child).despawn();
            commands.entity(parent.0).try_remove::<Share>();
        }
    }
}

/// The next frame, if it is loaded and has a share: only for fog, and only next to the wanted frame.
fn next_frame(
    player: &VdbPlayer,
    playback: &mut Playback,
    look: &LookItem,
    frames: &Frames,
    (files, grids): (&Assets<VdbFile>, &Assets<VdbGrid>),
) -> Option<Next> {
    let wanted = playback.wanted.filter(|wanted| playback.shown == Some(wanted.index))?;
    let (next, share) = (wanted.next()?, playback.part as f32);
    if share <= 0.0 || playback.lacking.contains(&next.index) {
        return None;
    }
    let file = files.get(frames.loaded((playback.sequence, next.index))?)?;
    let grid = grid_of(file, grids, player, &mut playback.labels).ok()?;
    let is_fog =
        |grid: &Handle<VdbGrid>| grids.get(grid).is_some_and(|grid| grid.kind() == PackKind::Fog);
    if !is_fog(&grid) || !is_fog(&look.volume.0) {
        return None;
    }
    let emission = look.emission.map(|emission| match player.sets_roles {
        true => emission_of(emission, file, &playback.labels),
        false => emission.clone(),
    });
    let color = look.color.map(|color| match player.sets_roles {
        true => color_of(color, file, &playback.labels),
        false => color.clone(),
    });
    Some(Next { grid, emission, color, share })
}

/// Makes the next frame look like the one on screen.
fn dress(mut child: EntityCommands, next: Next, look: &LookItem) {
    child.insert((VdbVolume(next.grid), look.material.clone(), Share(next.share)));
    match next.emission {
        Some(emission) => child.insert(emission),
        None => child.remove::<VdbEmission>(),
    };
    match next.color {
        Some(color) => child.insert(color),
        None => child.remove::<VdbColorGrid>(),
    };
    match look.layers {
        Some(layers) => child.insert(layers.clone()),
        None => child.remove::<RenderLayers>(),
    };
    match look.casts_no_shadow {
        true => child.insert(NotShadowCaster),
        false => child.remove::<NotShadowCaster>(),
    };
    match look.receives_no_shadow {
        true => child.insert(NotShadowReceiver),
        false => child.remove::<NotShadowReceiver>(),
    };
}
