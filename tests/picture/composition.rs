//! Volumes among meshes, and fogs that overlap.

use super::*;

#[gpu_test]
fn meshes_hide_and_are_hidden() {
    let mut stage = Stage::new();
    for msaa in [Msaa::Off, Msaa::Sample4] {
        for hdr in [true, false] {
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
            stage.world().entity_mut(camera).insert(msaa);
            if !hdr {
                stage.world().entity_mut(camera).remove::<Hdr>();
            }
            stage.green_sphere(Transform::default());
            let cube = stage.red_cube(1.0, Transform::from_xyz(0.0, 0.0, 4.0));
            let name = |place: &str| format!("{place}_{msaa:?}_hdr_{hdr}");

            let front = stage.picture(&target);
            front.save(&name("front"));
            assert!(is_red(front.center()), "in front: {} {msaa:?} {hdr}", front.center());
            assert!(front.count(is_green) > 100, "the sphere shows around the cube");

            stage.world().entity_mut(cube).insert(Transform::from_xyz(0.0, 0.0, -4.0));
            let behind = stage.picture(&target);
            assert!(is_green(behind.center()), "behind: {}", behind.center());
            assert_eq!(behind.count(is_red), 0, "the cube is hidden whole");

            // A cube whose corners stand out of the sphere.
            let rotated = Transform::from_rotation(Quat::from_rotation_y(0.7));
            stage.world().entity_mut(cube).insert(rotated.with_scale(Vec3::splat(3.2)));
            let inside = stage.picture(&target);
            inside.save(&name("inside"));
            assert!(inside.count(is_red) > 50, "corners of the cube stand out");
            assert!(inside.count(is_green) > 50, "the sphere shows between them");
        }
    }
}

#[gpu_test]
fn transparent_meshes_sort_with_surfaces() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let cube = stage.red_cube(1.0, Transform::from_xyz(0.0, 0.0, -4.0));
    let material = stage.world().get::<MeshMaterial3d<StandardMaterial>>(cube).unwrap().0.clone();
    let mut materials = stage.world().resource_mut::<Assets<StandardMaterial>>();
    let mut material = materials.get_mut(&material).unwrap();
    material.alpha_mode = AlphaMode::Blend;
    material.base_color = Color::LinearRgba(LinearRgba::new(1.0, 0.0, 0.0, 0.5));
    drop(material);
    let behind = stage.picture(&target);
    assert!(is_green(behind.center()), "glass behind a surface is hidden: {}", behind.center());
    stage.world().entity_mut(cube).insert(Transform::from_xyz(0.0, 0.0, 4.0));
    let front = stage.picture(&target).center();
    assert!((0.4..0.6).contains(&front.x) && (0.4..0.6).contains(&front.y), "{front}");
}

#[gpu_test]
fn fog_ends_at_meshes() {
    let block = fog::block(CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) }, 1.0);
    let mut stage = Stage::new();
    for msaa in [Msaa::Off, Msaa::Sample4] {
        stage.clear();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
        stage.world().entity_mut(camera).insert(msaa);
        let grid = stage.grid(block.clone(), PackKind::Fog, 0.1);
        let material = VdbMaterial { density_scale: 0.5, ..glow(GREEN) };
        stage.world().spawn((VdbVolume(grid), material));
        // Its front stands in the middle of the fog: 2.05 world units of fog before it.
        stage.red_cube(1.0, Transform::from_xyz(0.0, 0.0, -0.5));
        let pixel = stage.picture(&target).center();
        let dimmed = (-0.5_f32 * 2.05).exp();
        assert!((pixel.x - dimmed).abs() < 2e-3, "{msaa:?}: {pixel}, not {dimmed}");
        assert!((pixel.y - (1.0 - dimmed)).abs() < 2e-3, "{msaa:?}: {pixel}");
    }
}

#[gpu_test]
fn overlapping_fogs_mix() {
    // The same block twice in the same place is a block of twice the density.
    let block = fog::block(CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) }, 1.0);
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let grid = stage.grid(block, PackKind::Fog, 0.1);
    let material = |color| VdbMaterial { density_scale: 0.2, ..glow(color) };
    stage.world().spawn((VdbVolume(grid.clone()), material(GREEN)));
    stage.world().spawn((VdbVolume(grid), material(LinearRgba::RED)));
    let pixel = stage.picture(&target).center();
    let half = 0.5 * (1.0 - (-0.4_f32 * 4.1).exp());
    assert!((pixel.x - half).abs() < 2e-3 && (pixel.y - half).abs() < 2e-3, "{pixel}, not {half}");
}
