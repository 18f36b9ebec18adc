//! Several cameras, viewports, projections, and sizes of a target.

use super::*;

#[gpu_test]
fn several_cameras_and_viewports_share_a_target() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    for (i, from) in [Vec3::Z * 8.0, Vec3::X * 30.0].into_iter().enumerate() {
        let camera = stage.camera(&target, looking(from));
        let mut camera = stage.world().entity_mut(camera);
        let mut settings = camera.get_mut::<Camera>().unwrap();
        settings.order = i as isize;
        settings.viewport = Some(Viewport {
            physical_position: UVec2::new(i as u32 * half.x, 0),
            physical_size: half,
            ..default()
        });
        if i == 1 {
            settings.clear_color = ClearColorConfig::None;
        }
    }
    stage.green_sphere(Transform::default());
    let picture = stage.picture(&target);
    picture.save("viewports");
    let count = |from: u32, to: u32| {
        let at = |x: u32| (0..SIZE.y).filter(|&y| is_green(picture.at(x, y))).count();
        (from..to).map(at).sum::<usize>()
    };
    let (near, far) = (count(0, half.x), count(half.x, SIZE.x));
    assert!(is_green(picture.at(half.x / 2, half.y / 2)), "left, in its middle");
    assert!(is_green(picture.at(half.x * 3 / 2, half.y / 2)), "right, in its middle");
    assert!(near > 6 * far && far > 10, "{near} pixels near, {far} far");
}

#[gpu_test]
fn orthographic_cameras_see_true_sizes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 5.0, 5.0)));
    let projection = OrthographicProjection {
        scaling_mode: ScalingMode::FixedVertical { viewport_height: 8.0 },
        ..OrthographicProjection::default_3d()
    };
    stage.world().entity_mut(camera).insert(Projection::Orthographic(projection));
    stage.green_sphere(Transform::default());
    let cube = stage.red_cube(1.0, Transform::from_xyz(0.0, 2.2, 2.2));
    let picture = stage.picture(&target);
    picture.save("orthographic");
    assert!(is_red(picture.center()));
    stage.world().entity_mut(cube).insert(Transform::from_xyz(0.0, -2.2, -2.2));
    let picture = stage.picture(&target);
    let pixels = picture.count(is_green) as f32;
    let expected = std::f32::consts::PI * 2.0 * 2.0 * (SIZE.y as f32 / 8.0).powi(2);
    assert!((pixels / expected - 1.0).abs() < 0.05, "{pixels} pixels, not {expected}");
    assert_eq!(picture.count(is_red), 0);
}

#[gpu_test]
fn a_target_may_change_its_size() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let small = stage.picture(&target).count(is_green);
    let mut larger = Image::new_target_texture(
        SIZE.x * 2,
        SIZE.y * 2,
        bevy::render::render_resource::TextureFormat::Rgba32Float,
        None,
    );
    larger.texture_descriptor.usage |= bevy::render::render_resource::TextureUsages::COPY_SRC;
    stage.world().resource_mut::<Assets<Image>>().insert(&target, larger).unwrap();
    let large = stage.picture(&target).count(is_green);
    assert!((large as f32 / small as f32 / 4.0 - 1.0).abs() < 0.05, "{small} and {large} pixels");
}
