//! Fires that burn: a sequence of 32 files, played by three players at different times.
//!
//! `cargo run --example sequence` opens a window. Space pauses, left and right step through the
//! frames, up and down change the speed, which may be negative, and R changes what comes after the
//! last frame. `cargo run --example sequence picture.png 480x270` writes an image without a window.

use bevy::camera::Hdr;
use bevy::light::DirectionalLightShadowMap;
use bevy::post_process::bloom::Bloom;
use bevy::prelude::*;
use bevy_vdb::prelude::*;

mod helpers;

/// Where the fires are, and their sizes.
const PLACES: [(Vec3, f32); 3] =
    [(Vec3::ZERO, 1.25), (Vec3::new(-1.9, 0.0, -1.6), 0.95), (Vec3::new(2.2, 0.0, -2.0), 1.0)];

fn main() -> AppExit {
    helpers::app()
        .insert_resource(ClearColor(Color::srgb(0.01, 0.013, 0.03)))
        .insert_resource(GlobalAmbientLight { brightness: 25.0, ..default() })
        .insert_resource(DirectionalLightShadowMap { size: helpers::shadow_map_size(2048) })
        .add_systems(Startup, (fires, camp, camera))
        .add_systems(Update, (keys, tell))
        .run()
}

/// The text about the fire in front.
#[derive(Component)]
struct Shown;

/// The fire in front, which the keys control.
#[derive(Component)]
struct Front;

fn fires(mut commands: Commands, assets: Res<AssetServer>) {
    // A few lines of text: the files, the rate, the grids. Players of one sequence share its frames.
    let fire: Handle<VdbSequence> = assets.load("models/fire/fire.vdbseq");
    // Seconds: all three burn brightly at first.
    let starts = [1.0, 0.1, 0.2];
    for (number, ((place, scale), start)) in PLACES.into_iter().zip(starts).enumerate() {
        let mut player = VdbPlayer::new(fire.clone());
        player.seek_time(start);
        let mut entity = commands.spawn((
            player,
            // The player gives it the grid of each frame.
            VdbEmission::Temperature {
                grid: default(),
                scale: 1_200.0,
                offset: 800.0,
                strength: 0.5,
            },
            VdbMaterial {
                base_color: Color::srgb(0.35, 0.33, 0.32),
                density_scale: 7.0,
                ..default()
            },
            Transform::from_translation(place).with_scale(Vec3::splat(scale)),
            VdbEmissionLight::default(),
        ));
        if number == 0 {
            entity.insert(Front);
        }
    }
}

/// The ground, and around each fire stones and logs.
fn camp(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut material = |color: Color| {
        materials.add(StandardMaterial {
            base_color: color,
            perceptual_roughness: 0.95,
            ..default()
        })
    };
    let (earth, stone, wood) = (
        material(Color::srgb(0.21, 0.19, 0.16)),
        material(Color::srgb(0.34, 0.33, 0.32)),
        material(Color::srgb(0.24, 0.14, 0.08)),
    );
    let ground = meshes.add(Plane3d::default().mesh().size(40.0, 40.0));
    commands.spawn((Mesh3d(ground), MeshMaterial3d(earth)));
    let ball = meshes.add(Sphere::new(0.16).mesh().ico(4).expect("a small number"));
    let log = meshes.add(Cylinder::new(0.07, 0.9));
    for (middle, scale) in PLACES {
        for i in 0..11 {
            let angle = std::f32::consts::TAU * i as f32 / 11.0;
            let size = 0.8 + 0.35 * (5.0 * angle + middle.x).sin();
            let around = Vec3::new(angle.cos(), 0.0, angle.sin()) * 0.62;
            commands.spawn((
                Mesh3d(ball.clone()),
                MeshMaterial3d(stone.clone()),
                Transform::from_translation(middle + scale * (around + 0.06 * Vec3::Y))
                    .with_rotation(Quat::from_rotation_y(3.0 * angle))
                    .with_scale(scale * size * Vec3::new(1.2, 0.75, 0.9)),
            ));
        }
        for i in 0..3 {
            let turn = Quat::from_rotation_y(2.1 * i as f32 + middle.z);
            let lean = Quat::from_rotation_z(1.25);
            commands.spawn((
                Mesh3d(log.clone()),
                MeshMaterial3d(wood.clone()),
                Transform::from_translation(
                    middle + scale * (turn * Vec3::X * 0.2 + 0.12 * Vec3::Y),
                )
                .with_rotation(turn * lean)
                .with_scale(Vec3::splat(scale)),
            ));
        }
    }
}

fn camera(mut commands: Commands) {
    commands.spawn((
        Camera3d::default(),
        Hdr,
        Bloom::NATURAL,
        Transform::from_xyz(0.35, 1.0, 3.3).looking_at(Vec3::new(0.1, 0.8, 0.0), Vec3::Y),
    ));
    // The moon.
    commands.spawn((
        DirectionalLight {
            color: Color::srgb(0.6, 0.7, 1.0),
            illuminance: 150.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(-3.0, 6.0, -2.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    commands.spawn((Shown, Text::default(), Node { margin: UiRect::all(px(12)), ..default() }));
}

fn keys(
    keys: Res<ButtonInput<KeyCode>>,
    sequences: Res<Assets<VdbSequence>>,
    front: Single<(&mut VdbPlayer, &VdbPlayerStatus), With<Front>>,
) {
    let (mut player, status) = front.into_inner();
    if keys.just_pressed(KeyCode::Space) {
        if player.is_paused() { player.play() } else { player.pause() }
    }
    let step = i64::from(keys.just_pressed(KeyCode::ArrowRight))
        - i64::from(keys.just_pressed(KeyCode::ArrowLeft));
    if let (Some(frame), Some((first, last))) = (status.frame(), status.range())
        && step != 0
    {
        player.pause();
        player.seek(frame.saturating_add_signed(step).clamp(first, last));
    }
    let faster = f32::from(i8::from(keys.just_pressed(KeyCode::ArrowUp)))
        - f32::from(i8::from(keys.just_pressed(KeyCode::ArrowDown)));
    if faster != 0.0 {
        player.speed = (player.speed + 0.25 * faster).clamp(-4.0, 4.0);
    }
    if keys.just_pressed(KeyCode::KeyR) {
        let own = sequences.get(&player.sequence).map_or(VdbRepeat::Loop, |own| own.repeat);
        player.repeat = Some(match player.repeat.unwrap_or(own) {
            VdbRepeat::Once => VdbRepeat::Loop,
            VdbRepeat::Loop => VdbRepeat::PingPong,
            VdbRepeat::PingPong => VdbRepeat::Once,
        });
        player.replay();
    }
}

fn tell(
    front: Single<(&VdbPlayer, &VdbPlayerStatus), With<Front>>,
    mut text: Single<&mut Text, With<Shown>>,
) {
    let (player, status) = *front;
    let (Some(frame), Some((_, last))) = (status.frame(), status.range()) else { return };
    let (loaded, late) = (status.loaded().len(), status.late());
    let state = if player.is_paused() { "paused" } else { "playing" };
    text.0 = format!(
        "frame {frame} of {last}, {state} at {} x; {loaded} frames in memory, {late} late",
        player.speed
    );
}
