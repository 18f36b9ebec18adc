//! Surfaces and fog are where the reference tracer sees them, by every traversal and in every mode.

use super::*;

#[gpu_test]
fn a_level_set_is_where_the_reference_tracer_sees_it() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(3.0, 4.0, 6.0));
    stage.camera(&target, view);
    let placement = Transform {
        translation: Vec3::new(0.3, -0.2, 0.4),
        rotation: Quat::from_euler(EulerRot::XYZ, 0.5, 1.1, -0.3),
        // Not even, and a mirror.
        scale: Vec3::new(1.0, 0.6, -1.4),
    };
    let tree = level_set::torus(DVec3::ZERO, 14.0, 6.3);
    let volume = VdbVolume(stage.grid(tree.clone(), SURFACE, 0.1));
    let material = VdbMaterial {
        perceptual_roughness: 0.6,
        reflectance: 0.0,
        emissive: LinearRgba::rgb(0.25, 0.25, 0.25),
        ..default()
    };
    stage.world().spawn((volume, material, placement));
    let light = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
    let illuminance = 3.0;
    stage.world().spawn((DirectionalLight { illuminance, ..default() }, light));
    let picture = stage.picture(&target);
    picture.save("level_set");

    let world_from_index = DAffine3::from_scale_rotation_translation(
        placement.scale.as_dvec3(),
        placement.rotation.as_dquat(),
        placement.translation.as_dvec3(),
    ) * DAffine3::from_scale(DVec3::splat(0.1));
    let index_from_world = world_from_index.inverse();
    let sun = -light.forward().as_dvec3();
    let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
    let (mut hits, mut wrong, mut worst) = (0, 0, 0.0_f64);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, ray) = pixel_ray(view, x, y);
            let origin = index_from_world.transform_point3(origin);
            let dir = index_from_world.transform_vector3(ray);
            let pixel = picture.at(x, y);
            let Some(hit) = oracle.first_voxel(&Ray::from_f64(origin, dir)) else {
                wrong += usize::from(pixel.w > 0.5 && pixel.truncate() != Vec3::ZERO);
                continue;
            };
            hits += 1;
            let Some(face) = hit.face else { panic!("the camera is not in a voxel") };
            let normal = (index_from_world.matrix3.transpose() * face.normal()).normalize();
            let scattered = burley(normal, -ray.normalize(), sun, 0.6 * 0.6);
            let expected = f64::from(illuminance) * normal.dot(sun).max(0.0) * scattered + 0.25;
            let error = (f64::from(pixel.x) - expected).abs() / expected;
            // Rays between two voxels may choose the other one; 16-bit floats hold 1 part in 2,048.
            if error > 2e-3 { wrong += 1 } else { worst = worst.max(error) }
        }
    }
    println!("{hits} hits, {wrong} pixels differ, radiance to {worst:.2e}");
    assert!(hits > 800, "{hits} hits");
    assert!(wrong * 500 <= hits, "{wrong} of {hits} differ");
}

#[gpu_test]
fn a_smooth_surface_is_where_the_reference_tracer_sees_it() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(3.0, 4.0, 6.0));
    let camera = stage.camera(&target, view);
    let tree = level_set::gyroid(DVec3::ZERO, 20.0, 15.0);
    let kind = PackKind::Smooth { iso: 0.0 };
    let volume = VdbVolume(stage.grid(tree.clone(), kind, 0.1));
    stage.world().spawn(volume);
    // Voxels beside it, in the same picture.
    stage.green_sphere(Transform::from_xyz(0.0, 0.0, -30.0));
    let oracle = Smooth::new(&tree, 0.0);
    for smooth_normals in [false, true] {
        let mode = VdbRenderMode::Normals;
        let quality = VdbQuality { smooth_normals, ..default() };
        stage.world().entity_mut(camera).insert((VdbCamera { mode, ..default() }, quality));
        let picture = stage.picture(&target);
        picture.save(if smooth_normals { "smooth" } else { "faceted" });
        let (mut hits, mut wrong) = (0, 0);
        for y in 0..SIZE.y {
            for x in 0..SIZE.x {
                let (origin, dir) = pixel_ray(view, x, y);
                let hit = oracle.first_root(&Ray::from_f64(origin * 10.0, dir * 10.0));
                let of = |hit: SurfaceHit| match smooth_normals {
                    true => oracle.shading_gradient(&hit).try_normalize(),
                    false => hit.normal(),
                };
                let Some(normal) = hit.and_then(of) else { continue };
                hits += 1;
                let shown = picture.at(x, y).truncate().as_dvec3() * 2.0 - 1.0;
                // 16-bit floats hold a normal to about a thousandth.
                wrong += usize::from((shown - normal).abs().max_element() > 4e-3);
            }
        }
        println!("smooth {smooth_normals}: {hits} hits, {wrong} normals differ");
        assert!(hits > 1000, "{hits} hits");
        // A ray that just passes an edge in one may meet it in the other.
        assert!(wrong * 500 <= hits, "{wrong} of {hits} differ");
    }
}

#[gpu_test]
fn fog_dims_and_glows_as_the_reference_tracer_says() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 2.0, 6.0));
    stage.camera(&target, view);
    let tree = fog::sphere(DVec3::new(0.2, 0.0, -3.0), 18.0, 9.0);
    let volume = VdbVolume(stage.grid(tree.clone(), PackKind::Fog, 0.1));
    let material = VdbMaterial {
        base_color: Color::BLACK,
        emissive: LinearRgba::rgb(0.8, 0.4, 0.2),
        density_scale: 0.7,
        ..default()
    };
    stage.world().spawn((volume, material));
    let picture = stage.picture(&target);
    picture.save("fog");
    let oracle = Fog::new(&tree);
    let (mut met, mut worst) = (0, 0.0_f64);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let ray = Ray::from_f64(origin * 10.0, dir * 10.0);
            // Per unit of t, which is as long as `dir` in world space.
            let depth = oracle.optical_depth(&ray).value * dir.length() * 0.7;
            let expected = 0.8 * (1.0 - (-depth).exp());
            met += usize::from(expected > 0.01);
            worst = worst.max((f64::from(picture.at(x, y).x) - expected).abs());
        }
    }
    println!("{met} pixels of fog, radiance to {worst:.2e}");
    assert!(met > 1000, "{met} pixels of fog");
    assert!(worst < 1e-3, "radiance is off by {worst}");
}

#[gpu_test]
fn modes_show_what_they_say() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let mut show = |mode: VdbRenderMode| -> Picture {
        stage.world().entity_mut(camera).insert(VdbCamera { mode, ..default() });
        let picture = stage.picture(&target);
        picture.save(&format!("mode_{mode:?}"));
        picture
    };
    let normal = show(VdbRenderMode::Normals).center().truncate();
    assert!((normal - Vec3::new(0.5, 0.5, 1.0)).abs().max_element() < 0.1, "{normal}");
    let depth = show(VdbRenderMode::Depth).center().x;
    let expected = 0.1 / 6.0;
    assert!((depth / expected - 1.0).abs() < 0.02, "{depth}, not {expected}");
    let steps = show(VdbRenderMode::Steps);
    assert!(steps.center().x > 0.5, "{}", steps.center());
    assert_eq!(steps.at(0, 0).truncate(), Vec3::ZERO, "no steps where there is no volume");
}

#[gpu_test]
fn every_exact_traversal_shows_the_same() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(3.0, 4.0, 7.0)));
    stage.world().spawn((DirectionalLight::default(), looking(Vec3::new(1.0, 2.0, 3.0))));
    stage.green_sphere(Transform::from_xyz(-1.0, 0.0, 0.0));
    let tree = level_set::gyroid(DVec3::ZERO, 18.0, 9.0);
    let grid = stage.grid(tree, PackKind::Smooth { iso: 0.0 }, 0.1);
    stage.world().spawn((VdbVolume(grid), Transform::from_xyz(1.5, 0.0, 0.0)));
    let tree = fog::sphere(DVec3::ZERO, 15.0, 5.0);
    let grid = stage.grid(tree, PackKind::Fog, 0.1);
    stage.world().spawn((VdbVolume(grid), Transform::from_xyz(0.0, 0.5, 1.0)));
    let mut show = |traversal: VdbTraversal| {
        stage.world().entity_mut(camera).insert(VdbQuality { traversal, ..default() });
        stage.picture(&target)
    };
    let leaps = show(VdbTraversal::HddaSkip);
    assert!(leaps.count(|pixel| pixel.max_element() > 0.0) > 200, "hardly anything is seen");
    for traversal in [VdbTraversal::Hdda, VdbTraversal::Dda] {
        let other = show(traversal);
        let pairs = leaps.pixels.iter().zip(&other.pixels);
        let differ = pairs.filter(|(a, b)| a != b).count();
        assert_eq!(differ, 0, "pixels of {traversal:?}");
    }
    // It passes over corners and finds surfaces late, but it is the same scene.
    let marched = show(VdbTraversal::March);
    let close = |(a, b): &(&Vec4, &Vec4)| (**a - **b).abs().max_element() < 0.05;
    let alike = leaps.pixels.iter().zip(&marched.pixels).filter(close).count();
    assert!(alike * 10 > leaps.pixels.len() * 9, "{alike} of {}", leaps.pixels.len());
}
