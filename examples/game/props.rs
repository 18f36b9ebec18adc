//! Ordinary meshes around and on the island: the sea, trees, a hut and a lighthouse.

use bevy::math::{DVec2, FloatExt};
use bevy::prelude::*;

use crate::island::height;

/// The point of the ground at x and z.
fn ground(x: f32, z: f32) -> Vec3 {
    Vec3::new(x, height(DVec2::new(x.into(), z.into())) as f32, z)
}

pub fn spawn(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut matte = |r, g, b| {
        materials.add(StandardMaterial {
            base_color: Color::srgb(r, g, b),
            perceptual_roughness: 0.9,
            reflectance: 0.2,
            ..default()
        })
    };
    let [bark, green, dark_green] =
        [matte(0.3, 0.2, 0.12), matte(0.14, 0.32, 0.1), matte(0.09, 0.25, 0.12)];
    let [white, red, wood] =
        [matte(0.85, 0.83, 0.8), matte(0.65, 0.1, 0.08), matte(0.4, 0.26, 0.15)];
    let mut put = |mesh: &Handle<Mesh>, material: &Handle<StandardMaterial>, at: Transform| {
        commands.spawn((Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()), at));
    };

    let trunk = meshes.add(Cylinder::new(0.12, 1.2));
    let crown = meshes.add(Cone { radius: 0.8, height: 1.5 });
    for i in 0..110 {
        // On the slopes of the volcano, and along the shore.
        let angle = i as f32 * 2.399_963_2;
        let from_to = if i % 3 == 0 { [25.0, 26.5] } else { [9.0, 13.0] };
        let radius = from_to[0].lerp(from_to[1], (i as f32 * 0.618_034).fract());
        let foot = ground(radius * angle.cos(), radius * angle.sin());
        if foot.y < 0.5 {
            continue;
        }
        let size = 0.8 + 0.6 * (i as f32 * 0.414_214).fract();
        let at = |up: f32, wide: f32| {
            Transform::from_translation(foot + Vec3::Y * up * size)
                .with_scale(Vec3::splat(size * wide))
        };
        put(&trunk, &bark, at(0.5, 1.0));
        let leaves = if i % 2 == 0 { &green } else { &dark_green };
        put(&crown, leaves, at(1.6, 1.0));
        put(&crown, leaves, at(2.3, 0.72));
    }

    let foot = ground(10.5, 9.0);
    let hut = Transform::from_translation(foot).with_rotation(Quat::from_rotation_y(0.8));
    put(&meshes.add(Cuboid::new(2.6, 2.2, 2.0)), &wood, hut * Transform::from_xyz(0.0, 0.8, 0.0));
    let roof = Transform::from_xyz(0.0, 2.4, 0.0).with_rotation(Quat::from_rotation_y(0.785));
    let pyramid = meshes.add(Cone { radius: 2.2, height: 1.2 }.mesh().resolution(4));
    put(&pyramid, &red, hut * roof);

    let foot = ground(-21.5, 14.5);
    for i in 0..5 {
        let ring = Cylinder::new(1.0 - 0.09 * i as f32, 1.3);
        let at = Transform::from_translation(foot + Vec3::Y * (0.4 + 1.3 * i as f32));
        put(&meshes.add(ring), if i % 2 == 0 { &white } else { &red }, at);
    }

    let sea = materials.add(StandardMaterial {
        base_color: Color::srgba(0.03, 0.16, 0.22, 0.8),
        alpha_mode: AlphaMode::Blend,
        perceptual_roughness: 0.15,
        ..default()
    });
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::new(Vec3::Y, Vec2::splat(400.0)))),
        MeshMaterial3d(sea),
    ));
}
