//! What cameras show besides the picture.

use bevy::ecs::system::SystemState;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbOverlays, VdbRenderMode, VdbSpatialQuery, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Tree};

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking, parallel, pixel_ray};

#[gpu_test]
fn faces_and_voxels_are_told_apart() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    // Three faces of a cube, seen from a corner.
    let camera = stage.camera(&target, looking(Vec3::new(3.0, 4.0, 5.0)));
    let bbox = CoordBox { min: IVec3::splat(-10), max: IVec3::splat(9) };
    let grid = stage.grid(fog::block(bbox, -1.0), SURFACE, 0.1);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default()));
    let mut show = |mode: VdbRenderMode| {
        stage.world().entity_mut(camera).insert(VdbCamera { mode, ..default() });
        let picture = stage.picture(&target);
        picture.save(&format!("mode_{mode:?}"));
        picture
    };
    let axes = show(VdbRenderMode::Rgb);
    let faces = [Vec3::X, Vec3::Y, Vec3::Z];
    let counts = faces.map(|face| axes.count(|p| p.truncate() == face));
    assert!(counts.iter().all(|&count| count > 100), "{counts:?}");
    let all = axes.count(|p| p.truncate() != Vec3::ZERO);
    assert_eq!(counts.iter().sum::<usize>(), all, "each pixel is on one face");

    let gray = show(VdbRenderMode::Gray);
    let brightness = faces.map(|face| {
        let pairs = axes.pixels.iter().zip(&gray.pixels);
        let on_face: Vec<f32> =
            pairs.filter(|(a, _)| a.truncate() == face).map(|(_, gray)| gray.x).collect();
        assert!(on_face.iter().all(|&x| x == on_face[0]), "a face is of one gray");
        on_face[0]
    });
    let [x, y, z] = brightness;
    assert!(y > x + 0.1 && x > z + 0.1, "{brightness:?}");

    // Each voxel's face has a colour of its own: about 400 on each of three sides.
    let voxels = show(VdbRenderMode::HitVoxel);
    let mut colors: Vec<[u32; 3]> = voxels
        .pixels
        .iter()
        .map(|p| p.truncate().to_array().map(f32::to_bits))
        .filter(|color| *color != [0; 3])
        .collect();
    colors.sort_unstable();
    colors.dedup();
    assert!((600..=1200).contains(&colors.len()), "{} colours of {all} pixels", colors.len());
}

/// Lines at every eighth voxel, 1.5 pixels wide, however large voxels are in the picture.
#[gpu_test]
fn borders_of_nodes_are_where_they_are_and_evenly_wide() {
    let bbox = CoordBox { min: IVec3::new(-160, -160, -8), max: IVec3::new(159, 159, -1) };
    let mut stage = Stage::new();
    for (height, tilt) in [(2.0, 0.0), (1.0, 0.0), (2.0, 0.8), (8.0, 0.0)] {
        stage.clear();
        let target = stage.target(SIZE);
        let from = Quat::from_rotation_y(tilt) * (Vec3::Z * 8.0);
        let camera = stage.camera(&target, looking(from));
        stage.world().entity_mut(camera).insert(parallel(height));
        let grid = stage.grid(fog::block(bbox, -1.0), SURFACE, 0.05);
        // A column of voxels begins at its lower face: half a voxel before its sample.
        let shifted = Transform::from_xyz(0.025, 0.025, 0.025);
        stage.world().spawn((VdbVolume(grid), VdbMaterial::default(), shifted));
        let mut show = |overlays: VdbOverlays| {
            let mode = VdbRenderMode::Depth;
            stage.world().entity_mut(camera).insert(VdbCamera { mode, overlays, ..default() });
            let picture = stage.picture(&target);
            picture.save(&format!("overlay_{height}_{tilt}_{}", overlays.lower));
            picture
        };
        let plain = show(VdbOverlays::default());
        let leaves = show(VdbOverlays { leaves: true, ..default() });
        let lower = show(VdbOverlays { lower: true, ..default() });

        // Along a row in the middle of leaves, how much of it lines cover: 1.5 pixels for each.
        let cover = |picture: &Picture, row: u32, toward: Vec3| {
            let at = |x: u32| {
                let (a, b) = (plain.at(x, row).truncate(), picture.at(x, row).truncate());
                (b - a).dot(toward - a) / (toward - a).length_squared()
            };
            (0..SIZE.x).map(at).sum::<f32>()
        };
        let width = height * SIZE.x as f32 / SIZE.y as f32 / tilt.cos();
        let row = (0..SIZE.y)
            .min_by_key(|&row| {
                let y = height * (0.5 - (row as f32 + 0.5) / SIZE.y as f32);
                ((y / 0.4).rem_euclid(1.0) * 1000.0 - 500.0).abs() as u32
            })
            .unwrap();
        // One in the middle, and so many to either side.
        let lines = if height > 4.0 { 0.0 } else { 1.0 + 2.0 * (width / 2.0 / 0.4).floor() };
        let covered = cover(&leaves, row, Vec3::new(0.0, 1.0, 1.0));
        println!("height {height}, tilt {tilt}: {covered} pixels for {lines} lines");
        assert!((covered - 1.5 * lines).abs() <= 0.05 * lines, "{covered} pixels, {lines} lines");
        // Nodes of 128 voxels: the one border at 0, in the middle, in sight.
        let covered = cover(&lower, row, Vec3::X);
        assert!((covered - 1.5).abs() < 0.1, "{covered} pixels for one line");
    }
}

/// The picture beside the borders stays as it is, smooth surfaces have them, too.
#[gpu_test]
#[ignore = "slow: pipelines of every mode"]
fn borders_are_shown_in_any_mode() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
    let tree = level_set::sphere(DVec3::ZERO, 20.0);
    let grid = stage.grid(tree, PackKind::Smooth { iso: 0.0 }, 0.1);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default()));
    stage.world().spawn((DirectionalLight { illuminance: 3.0, ..default() }, looking(Vec3::ONE)));
    // Depth is in the test above, and a maximum shows no surface.
    let without = [VdbRenderMode::Depth, VdbRenderMode::Maximum];
    for mode in VdbRenderMode::ALL.iter().copied().filter(|mode| !without.contains(mode)) {
        let mut show = |leaves: bool| {
            let overlays = VdbOverlays { leaves, ..default() };
            stage.world().entity_mut(camera).insert(VdbCamera { mode, overlays, ..default() });
            stage.picture(&target)
        };
        let (without, with) = (show(false), show(true));
        with.save(&format!("overlay_{mode:?}"));
        let pairs = without.pixels.iter().zip(&with.pixels);
        let differ = pairs.filter(|(a, b)| (**a - **b).abs().max_element() > 1e-3).count();
        let seen = without.count(|p| p.truncate() != Vec3::ZERO);
        assert!((100..1500).contains(&differ), "{mode:?}: {differ} pixels differ of {seen}");
    }
}

/// What a maximum intensity projection shows is the largest value along the ray, of whichever fog.
#[gpu_test]
fn the_largest_value_along_a_ray_is_shown() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 2.0, 7.0));
    let scale = 1.25;
    let camera = stage.camera(&target, view);
    let mode = VdbCamera { mode: VdbRenderMode::Maximum, maximum_scale: scale, ..default() };
    stage.world().entity_mut(camera).insert(mode);
    let waves = |x: IVec3| {
        let waves = (x.as_dvec3() * DVec3::new(0.9, 0.7, 1.1)).to_array().map(f64::sin);
        (waves.iter().product::<f64>() + 0.1).max(0.0) as f32
    };
    let mut noise = Tree::new(0.0);
    for (x, y, z) in (0..24 * 24 * 24).map(|i| (i / 576, i / 24 % 24, i % 24)) {
        let at = IVec3::new(x, y, z) - 12;
        noise.set(at, waves(at));
    }
    let noise = stage.grid(noise, PackKind::Fog, 0.1);
    let block = CoordBox { min: IVec3::splat(-5), max: IVec3::splat(5) };
    let block = stage.grid(fog::block(block, 0.6), PackKind::Fog, 0.1);
    let turned = Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, 0.5, 1.1, -0.3));
    let beside = Transform::from_xyz(0.8, 0.5, 1.0);
    let volumes = [(noise, turned), (block, beside)]
        .map(|(grid, at)| stage.world().spawn((VdbVolume(grid), at)).id());
    // Behind this surface would be nothing else; rays go through it.
    stage.green_sphere(Transform::from_xyz(0.0, 0.0, 3.0).with_scale(Vec3::splat(0.3)));
    let picture = stage.picture(&target);
    picture.save("maximum");
    let mut state = SystemState::<VdbSpatialQuery>::new(stage.world());
    let query = state.get(stage.world()).unwrap();
    let (mut seen, mut worst) = ([0; 2], 0.0_f32);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let value = |volume: Entity, t: f64| {
                query.trilinear(volume, (origin + dir * t).as_vec3()).unwrap().max(0.0)
            };
            // Maxima are often where the ray passes from cell to cell, so the second pass is 200 times finer.
            let largest = |volume| {
                let pass = |from: f64, step: f64, count: i32| {
                    let at = (0..count).map(|i| from + f64::from(i) * step);
                    at.map(|t| (value(volume, t), t)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
                };
                let (_, t) = pass(3.0, 0.008, 1000);
                pass(t - 0.008, 0.000_04, 400).0
            };
            let both = volumes.map(largest);
            let expected = both[0].max(both[1]);
            if expected > 0.0 {
                seen[usize::from(both[1] > both[0])] += 1;
            }
            let shown = scale * picture.at(x, y).y;
            // 16-bit floats hold 11 bits.
            worst = worst.max((shown - expected).abs());
        }
    }
    println!("{seen:?} pixels of both fogs, {worst} off");
    assert!(seen.iter().all(|seen| *seen > 100), "{seen:?}");
    assert!(worst < 1e-3, "{worst}");
}
