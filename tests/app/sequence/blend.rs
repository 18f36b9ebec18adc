//! What is shown between two frames.

use bevy::camera::visibility::RenderLayers;
use bevy::light::NotShadowCaster;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use vdb_core::synth::level_set;
use vdb_core::{AnyTree, Grid, GridClass};

use super::stage::{FRAME, Stage, file, frame_of, name};

/// A stage with a sequence that is in memory, and a player of it that fades.
fn fading(test: &str, numbers: &[u64]) -> (Stage, Entity) {
    let mut stage = Stage::new(test);
    stage.write(numbers.iter().copied());
    let sequence = stage.sequence("", numbers.iter().copied());
    let player = stage.spawn(VdbPlayer::new(sequence).with_blend(VdbFrameBlend::CrossFade));
    stage.until_loaded(player, numbers.len());
    (stage, player)
}

/// The volumes in which next frames fade in.
fn next_volumes(stage: &mut Stage) -> Vec<Entity> {
    let world = stage.app.world_mut();
    let mut volumes = world.query_filtered::<Entity, (With<VdbVolume>, Without<VdbPlayer>)>();
    volumes.iter(world).collect()
}

/// The frame that fades in.
fn next(stage: &mut Stage) -> Option<u64> {
    let volumes = next_volumes(stage);
    assert!(volumes.len() < 2, "{volumes:?}");
    let volume = *volumes.first()?;
    Some(frame_of(stage.grid(volume).unwrap()))
}

/// The frames that are shown and fade in, in steps of half a frame.
fn pairs(stage: &mut Stage, player: Entity, count: usize) -> Vec<(u64, Option<u64>)> {
    let mut pairs = vec![(stage.shown(player).unwrap(), next(stage))];
    while pairs.len() < count {
        stage.step(FRAME / 2);
        pairs.push((stage.shown(player).unwrap(), next(stage)));
    }
    pairs
}

#[test]
fn the_frame_that_follows_fades_in() {
    let (mut stage, player) = fading("fade", &[1, 2, 4]);
    // Nothing at the time of a frame; through the gap of the third, and to the first one again.
    let forwards = [
        (1, None),
        (1, Some(2)),
        (2, None),
        (2, Some(4)),
        (2, Some(4)),
        (2, Some(4)),
        (4, None),
        (4, Some(1)),
        (1, None),
    ];
    assert_eq!(pairs(&mut stage, player, 9), forwards);
    stage.player(player).speed = -1.0;
    stage.player(player).replay();
    stage.step(std::time::Duration::ZERO);
    let backwards = [(4, None), (4, Some(2)), (2, None), (2, Some(1)), (2, Some(1))];
    assert_eq!(pairs(&mut stage, player, 5), backwards);
    // The last frame of a sequence that ends stays as it is.
    stage.player(player).repeat = Some(VdbRepeat::Once);
    stage.player(player).speed = 1.0;
    stage.player(player).seek(4);
    stage.step(std::time::Duration::ZERO);
    assert_eq!(pairs(&mut stage, player, 3), [(4, None); 3]);
}

#[test]
fn what_fades_in_looks_like_what_is_shown() {
    let (mut stage, player) = fading("fade_look", &[1, 2]);
    let look = VdbMaterial { density_scale: 3.0, anisotropy: 0.4, ..default() };
    let layers = RenderLayers::layer(3);
    stage.app.world_mut().entity_mut(player).insert((
        look.clone(),
        layers.clone(),
        NotShadowCaster,
        VdbColorGrid::default(),
    ));
    stage.step(FRAME / 2);
    let next = next_volumes(&mut stage)[0];
    let world = stage.app.world();
    assert_eq!(world.get::<VdbMaterial>(next), Some(&look));
    assert_eq!(world.get::<RenderLayers>(next), Some(&layers));
    assert!(world.entity(next).contains::<NotShadowCaster>());
    assert!(world.entity(next).contains::<VdbColorGrid>());
    assert_eq!(world.get::<ChildOf>(next).unwrap().0, player);
    let mut shown = stage.app.world_mut().entity_mut(player);
    shown.remove::<(RenderLayers, NotShadowCaster, VdbColorGrid)>();
    stage.step(FRAME / 8);
    let world = stage.app.world();
    assert!(!world.entity(next).contains::<RenderLayers>());
    assert!(!world.entity(next).contains::<NotShadowCaster>());
    assert!(!world.entity(next).contains::<VdbColorGrid>());
}

#[test]
fn nothing_fades_in_where_nothing_is_to_fade() {
    let (mut stage, player) = fading("fade_off", &[1, 2]);
    stage.step(FRAME / 2);
    assert_eq!(next(&mut stage), Some(2));
    stage.player(player).blend = VdbFrameBlend::Hold;
    stage.step(FRAME / 8);
    assert_eq!(next(&mut stage), None);
    stage.player(player).blend = VdbFrameBlend::CrossFade;
    stage.step(FRAME / 8);
    assert_eq!(next(&mut stage), Some(2));
    stage.app.world_mut().entity_mut(player).remove::<VdbPlayer>();
    stage.step(FRAME / 8);
    let world = stage.app.world_mut();
    let mut volumes = world.query::<&VdbVolume>();
    assert_eq!(volumes.iter(world).count(), 1);
}

#[test]
fn surfaces_do_not_fade() {
    let mut stage = Stage::new("fade_surface");
    for number in 1..=2 {
        let tree = level_set::sphere(bevy::math::DVec3::ZERO, 5.0 + number as f64);
        let mut grid = Grid::new("distance", AnyTree::Float(tree.into()));
        grid.class = GridClass::LevelSet;
        stage.write_file(&name(number), &file(vec![grid]));
    }
    let sequence = stage.sequence("", 1..=2);
    let player = stage.spawn(VdbPlayer::new(sequence).with_blend(VdbFrameBlend::CrossFade));
    stage.until_loaded(player, 2);
    stage.step(FRAME / 2);
    assert_eq!(stage.status(player).frame(), Some(1));
    assert!(next_volumes(&mut stage).is_empty());
}
