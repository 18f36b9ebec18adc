//! The loading screen. It disappears once every volume is in the picture or has failed, and in any
//! case after [`PATIENCE`] without progress.

use std::time::Duration;

use bevy::prelude::*;
use bevy_vdb::prelude::*;

use crate::GameState;

/// The time without progress after which the game starts with what there is. Drivers can take many
/// seconds to compile shaders, above all at the first start after an update.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// How long the notice about missing volumes is shown.
const NOTICE_TIME: Duration = Duration::from_secs(20);

/// The share of the bar that belongs to reading, decoding and packing. The rest is for uploading to
/// the GPU and compiling shaders, which report no progress.
const LOADED: f32 = 0.8;

const BACKGROUND: Color = Color::srgb(0.05, 0.06, 0.08);
const BAR: Color = Color::srgb(0.35, 0.65, 0.95);
const BAR_BACKGROUND: Color = Color::srgb(0.16, 0.18, 0.22);
const NOTICE_BACKGROUND: Color = Color::srgba(0.25, 0.05, 0.04, 0.9);

pub struct LoadingPlugin;

impl Plugin for LoadingPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(OnEnter(GameState::Loading), spawn_screen)
            .add_systems(
                Update,
                (measure, draw, finish).chain().run_if(in_state(GameState::Loading)),
            )
            .add_systems(Update, despawn_notices);
    }
}

/// Loading progress.
#[derive(Resource)]
struct Progress {
    /// The length of the bar, from 0 to 1: the largest fraction so far.
    shown: f32,
    /// The current fraction, from 0 to 1.
    fraction: f32,
    /// The time of the last change of the fraction, since the start of the app.
    last: Duration,
}

/// The filled part of the bar.
#[derive(Component)]
struct Bar;

/// The text above the bar.
#[derive(Component)]
struct Stage;

/// A text that disappears after a while.
#[derive(Component)]
struct Notice(Timer);

fn spawn_screen(mut commands: Commands, time: Res<Time<Real>>) {
    commands.insert_resource(Progress { shown: 0.0, fraction: 0.0, last: time.elapsed() });
    let whole_window = Node {
        width: percent(100),
        height: percent(100),
        flex_direction: FlexDirection::Column,
        align_items: AlignItems::Center,
        justify_content: JustifyContent::Center,
        row_gap: px(12),
        ..default()
    };
    let frame = Node { width: px(320), height: px(8), ..default() };
    let bar = Node { width: percent(0), height: percent(100), ..default() };
    commands.spawn((
        DespawnOnExit(GameState::Loading),
        // In front of any other user interface.
        GlobalZIndex(1),
        BackgroundColor(BACKGROUND),
        whole_window,
        children![
            (Stage, Text::default()),
            (frame, BackgroundColor(BAR_BACKGROUND), children![(Bar, bar, BackgroundColor(BAR))]),
        ],
    ));
}

fn measure(
    volumes: Query<&VdbVolumeState>,
    files: Res<VdbLoadProgress>,
    time: Res<Time<Real>>,
    mut progress: ResMut<Progress>,
) {
    let loaded = LOADED * files.fraction().unwrap_or(0.0);
    let shares = volumes.iter().map(|state| match state {
        VdbVolumeState::Loading => loaded,
        VdbVolumeState::Preparing => LOADED,
        _ => 1.0,
    });
    let fraction = shares.sum::<f32>() / volumes.count().max(1) as f32;
    // Files that join later lower the fraction. The bar never goes back, but the way up again is
    // progress as well.
    if fraction != progress.fraction {
        let shown = progress.shown.max(fraction);
        *progress = Progress { shown, fraction, last: time.elapsed() };
    }
}

fn draw(
    progress: Res<Progress>,
    volumes: Query<&VdbVolumeState>,
    mut bar: Single<&mut Node, With<Bar>>,
    mut stage: Single<&mut Text, With<Stage>>,
) {
    bar.width = percent(100.0 * progress.shown);
    let is_reading = volumes.iter().any(|state| *state == VdbVolumeState::Loading);
    let text = if is_reading { "Loading models" } else { "Compiling shaders" };
    stage.set_if_neq(Text::new(text));
}

fn finish(
    mut commands: Commands,
    volumes: Query<(&VdbVolume, &VdbVolumeState)>,
    server: Res<AssetServer>,
    progress: Res<Progress>,
    time: Res<Time<Real>>,
    mut next: ResMut<NextState<GameState>>,
) {
    let is_complete = volumes.iter().all(|(_, state)| state.is_settled());
    let is_stuck = time.elapsed().saturating_sub(progress.last) > PATIENCE;
    if !is_complete && !is_stuck {
        return;
    }
    let missing: Vec<String> =
        volumes.iter().filter_map(|(volume, state)| why_missing(volume, state, &server)).collect();
    if !missing.is_empty() {
        commands.spawn(notice(missing.join("\n")));
    }
    next.set(GameState::Playing);
}

/// A sentence for the player if a volume is not in the picture.
fn why_missing(volume: &VdbVolume, state: &VdbVolumeState, server: &AssetServer) -> Option<String> {
    let path = server.get_path(&volume.0);
    let name = path.map_or_else(|| "A volume".to_owned(), |path| path.to_string());
    match state {
        VdbVolumeState::Failed(why) => Some(format!("{name} could not be loaded: {why}")),
        VdbVolumeState::NotShown(why) => Some(format!("{name} cannot be shown: {why}")),
        VdbVolumeState::Loading | VdbVolumeState::Preparing => {
            Some(format!("{name} is not ready yet. It will appear as soon as it is."))
        }
        _ => None,
    }
}

/// A text in Bevy's own font, which has only ASCII characters; other languages need a font file.
fn notice(text: String) -> impl Bundle {
    (
        Notice(Timer::new(NOTICE_TIME, TimerMode::Once)),
        Text::new(text),
        TextFont::from_font_size(14.0),
        BackgroundColor(NOTICE_BACKGROUND),
        Node {
            position_type: PositionType::Absolute,
            left: px(16),
            bottom: px(16),
            max_width: percent(60),
            padding: UiRect::all(px(8)),
            ..default()
        },
    )
}

fn despawn_notices(
    mut commands: Commands,
    time: Res<Time<Real>>,
    mut notices: Query<(Entity, &mut Notice)>,
) {
    for (entity, mut notice) in &mut notices {
        if notice.0.tick(time.delta()).is_finished() {
            commands.entity(entity).despawn();
        }
    }
}
