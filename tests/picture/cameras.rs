//! Several cameras, viewports, projections, and sizes of a target.

use bevy::light::DirectionalLightShadowMap;

use super::*;

/// Two cameras in viewports of this size beside one another.
fn side_by_side(
    stage: &mut Stage,
    target: &Handle<Image>,
    size: UVec2,
    views: [Transform; 2],
) -> [Entity; 2] {
    let cameras = views.map(|view| stage.camera(target, view));
    for (i, camera) in cameras.into_iter().enumerate() {
        let mut settings = stage.world().get_mut::<Camera>(camera).expect("a camera");
        settings.order = i as isize;
        settings.viewport = Some(Viewport {
            physical_position: UVec2::new(i as u32 * size.x, 0),
            physical_size: size,
            ..default()
        });
        if i == 1 {
            settings.clear_color = ClearColorConfig::None;
        }
    }
    cameras
}

#[gpu_test]
fn several_cameras_and_viewports_share_a_target() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    side_by_side(&mut stage, &target, half, [Vec3::Z * 8.0, Vec3::X * 30.0].map(looking));
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

/// In a viewport beside another, a camera shows what it shows in a target of its own. The scene has a floor in the
/// shadow of a cloud, and a ball of rough metal that reflects a ball of voxels; the settings turn on whatever is done
/// for each pixel.
#[gpu_test]
fn a_viewport_shows_what_a_picture_of_its_own_does() {
    let mut stage = Stage::new();
    let wide = stage.target(SIZE * UVec2::new(2, 1));
    let views = [Vec3::new(1.0, 5.0, 7.0), Vec3::new(-3.0, 4.0, 6.0)].map(looking);
    let alone = [(); 2].map(|()| stage.target(SIZE));
    let whole = [0, 1].map(|i| stage.camera(&alone[i], views[i]));
    let parts = side_by_side(&mut stage, &wide, SIZE, views);
    let world = stage.world();
    world.insert_resource(DirectionalLightShadowMap { size: 128 });
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    world.spawn((sun, looking(Vec3::new(1.0, 3.0, 0.5))));
    stage.matt_plane(30.0, -1.5);
    let cloud = stage.ball_of_fog(15.0, 10.0);
    let thin = VdbMaterial { density_scale: 0.7, ..default() };
    stage.world().spawn((VdbVolume(cloud), thin, Transform::from_xyz(-1.5, 2.0, 0.0)));
    let ball = stage.grid(level_set::sphere(DVec3::ZERO, 14.0), PackKind::Smooth { iso: 0.0 }, 0.1);
    let rough = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.35, ..default() };
    stage.world().spawn((VdbVolume(ball), rough, Transform::from_xyz(1.3, 0.0, 0.5)));
    stage.green_sphere(Transform::from_xyz(-1.2, -0.5, 1.0).with_scale(Vec3::splat(0.4)));
    let full = VdbQuality { reflections: 1, edge_samples: 4, ..VdbQuality::HIGH };
    let half = VdbQuality { resolution: 0.5, edge_samples: 0, ..full };
    for (name, quality, feature) in
        [("full", full, "rays on edges"), ("half", half, "fewer rays than pixels")]
    {
        for camera in whole.into_iter().chain(parts) {
            stage.world().entity_mut(camera).insert(quality);
        }
        let pictures = stage.pictures([&alone[0], &alone[1], &wide]);
        pictures[2].save(&format!("viewport_{name}"));
        let report = stage.report(parts[1]).expect("volumes in view");
        for feature in [feature, "denoised reflections", "shadows", "fog"] {
            assert!(report.has(feature), "{name}: {feature}: {report:?}");
        }
        assert!(report.passes.iter().any(|pass| pass.name == "vdb_fog_shadows"), "{report:?}");
        assert!(pictures[0] != pictures[1], "{name}: the views are the same");
        let lit = pictures[1].count(|pixel| pixel.truncate().max_element() > 0.05);
        assert!(lit > 3000, "{name}: {lit} pixels show something");
        for (i, expected) in pictures[..2].iter().enumerate() {
            let all = (0..SIZE.y).flat_map(|y| (0..SIZE.x).map(move |x| (x, y)));
            let differences = all.map(|(x, y)| {
                let found = pictures[2].at(x + i as u32 * SIZE.x, y);
                (found - expected.at(x, y)).abs().max_element()
            });
            let differences: Vec<f32> = differences.filter(|off| *off > 0.0).collect();
            println!("{name}, viewport {i}: {differences:?}");
            // The position of a mesh is rounded differently beside another viewport.
            assert!(differences.len() < 10, "{name}, viewport {i}: {}", differences.len());
        }
    }
}

#[gpu_test]
fn orthographic_cameras_see_true_sizes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 5.0, 5.0)));
    stage.world().entity_mut(camera).insert(parallel(8.0));
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
