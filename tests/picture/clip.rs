//! Clip planes: what they leave, its light and its shadows.

use bevy::camera::ScalingMode;
use bevy::light::DirectionalLightShadowMap;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbClipPlane, VdbClippedBy, VdbEmission, VdbMaterial, VdbQuality, VdbRenderMode,
    VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{GREEN, SIZE, SURFACE, glow, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

impl Stage {
    /// A clip plane that cuts away what is on the side of `normal`.
    fn clip_plane(&mut self, point: Vec3, normal: Vec3) -> Entity {
        let turn = Quat::from_rotation_arc(Vec3::Y, normal.normalize());
        let at = Transform::from_translation(point).with_rotation(turn);
        self.world().spawn((VdbClipPlane, at)).id()
    }
}

#[gpu_test]
fn rays_meet_what_clip_planes_leave() {
    check_solids(&PerspectiveProjection::default().into(), |distance| 0.1 / distance);
}

#[gpu_test]
fn parallel_rays_meet_what_clip_planes_leave() {
    let far = 20.0;
    let parallel = OrthographicProjection {
        scaling_mode: ScalingMode::FixedVertical { viewport_height: 5.0 },
        far,
        ..OrthographicProjection::default_3d()
    };
    check_solids(&Projection::Orthographic(parallel), |distance| 1.0 - distance / f64::from(far));
}

/// Planes through solids, one across the line of sight and one along it. `depth_of` is the depth that the projection
/// gives to a distance from the camera's plane.
fn check_solids(projection: &Projection, depth_of: impl Fn(f64) -> f64) {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 3.0, 7.0));
    let camera = stage.camera(&target, view);
    stage.world().entity_mut(camera).insert(projection.clone());
    // A projection takes effect with the next frame, and rays are cast before it.
    stage.update(1);
    let planes = [
        stage.clip_plane(Vec3::new(0.0, 0.2, 0.6), Vec3::new(0.2, 0.1, 1.0)),
        stage.clip_plane(Vec3::new(0.1, 0.3, 0.0), Vec3::new(0.3, 1.0, 0.2)),
    ];
    let normals = planes.map(|plane| *stage.world().get::<Transform>(plane).unwrap().up());
    let grids = [
        (level_set::sphere(DVec3::ZERO, 15.0), SURFACE, Vec3::new(-1.6, 0.0, 0.2)),
        (level_set::torus(DVec3::ZERO, 11.0, 6.3), SMOOTH, Vec3::new(1.6, 0.2, 0.1)),
    ];
    let turn = Quat::from_euler(EulerRot::XYZ, 0.5, 1.1, -0.3);
    let volumes = grids.map(|(tree, kind, at)| {
        let grid = stage.grid(tree, kind, 0.1);
        let scale = Vec3::new(1.0, 0.8, -1.2);
        let at = Transform::from_translation(at).with_rotation(turn).with_scale(scale);
        stage.world().spawn((VdbVolume(grid), at, VdbClippedBy(planes.to_vec()))).id()
    });
    let mut show = |mode| {
        let quality = VdbQuality { smooth_normals: false, ..default() };
        stage.world().entity_mut(camera).insert((VdbCamera { mode, ..default() }, quality));
        stage.picture(&target)
    };
    let (depth, shown) = (show(VdbRenderMode::Depth), show(VdbRenderMode::Normals));
    depth.save("clip_depth");
    shown.save("clip_normals");

    let (mut met, mut caps, mut wrong) = ([0, 0], [[0; 2]; 2], 0);
    for (pixel, (ray, hit)) in stage.cast(camera, f32::INFINITY).into_iter().enumerate() {
        let Some(hit) = hit else {
            wrong += usize::from(depth.pixels[pixel].x > 0.0);
            continue;
        };
        let volume = volumes.iter().position(|volume| *volume == hit.entity).unwrap();
        met[volume] += 1;
        let from_eye = ray.origin + *ray.direction * hit.distance - view.translation;
        let expected = depth_of(f64::from(from_eye.dot(*view.forward())));
        let error = (f64::from(depth.pixels[pixel].x) / expected - 1.0).abs();
        let normal = shown.pixels[pixel].truncate() * 2.0 - 1.0;
        let cap = normals.iter().position(|cap| cap.distance(hit.normal) < 1e-4);
        if let Some(cap) = cap {
            caps[volume][cap] += 1;
        }
        let turned = normal.distance(hit.normal) > 4e-3 && (volume == 1 || cap.is_some());
        wrong += usize::from(error > 1.0 / 1024.0 || turned);
    }
    println!(
        "{met:?} pixels of voxels and smooth surface, {caps:?} of them on caps, {wrong} differ"
    );
    assert!(met.iter().all(|met| *met > 200), "{met:?}");
    assert!(caps.as_flattened().iter().all(|caps| *caps > 20), "{caps:?}");
    assert!(wrong * 200 <= met[0] + met[1], "{wrong} of {met:?} differ");
}

/// What is left of a ray through fog, and what a slice of a solid is to a camera within the part that is cut away.
#[gpu_test]
fn fog_and_solids_end_at_clip_planes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    let cube = stage.cube_of_fog(10, 0.1);
    let cube = stage.world().spawn((VdbVolume(cube), glow(GREEN))).id();
    let left = |picture: &Picture| 1.0 - picture.center().y;
    let whole = left(&stage.picture(&target));
    // Voxels are about whole numbers: the middle of the cube is half a voxel below.
    let planes = [
        stage.clip_plane(Vec3::Z * -0.05, Vec3::Z),
        stage.clip_plane(Vec3::Z * -0.55, Vec3::NEG_Z),
    ];
    for (planes, share) in [(&planes[..1], 0.5), (&planes[..], 0.25)] {
        stage.world().entity_mut(cube).insert(VdbClippedBy(planes.to_vec()));
        let cut = left(&stage.picture(&target));
        let expected = whole.powf(share);
        assert!((cut / expected - 1.0).abs() < 4e-3, "{cut} in place of {expected}");
    }
    // Two fogs in one place, one of them whole.
    let handle = stage.world().get::<VdbVolume>(cube).unwrap().clone();
    let other = stage.world().spawn((handle.clone(), glow(GREEN))).id();
    let cut = left(&stage.picture(&target));
    let expected = whole.powf(1.25);
    assert!((cut / expected - 1.0).abs() < 0.02, "{cut} in place of {expected} for two fogs");
    stage.world().despawn(other);
    // The light of a fire that attenuates nothing.
    let clear = VdbMaterial { density_scale: 0.0, ..default() };
    let fire = VdbEmission::Scalar { grid: handle.0, color: 0.1 * GREEN };
    stage.world().entity_mut(cube).insert((clear, fire));
    let cut = stage.picture(&target).center().y;
    stage.world().entity_mut(cube).remove::<VdbClippedBy>();
    let whole = stage.picture(&target).center().y;
    assert!((4.0 * cut / whole - 1.0).abs() < 4e-3, "{cut} of {whole} for a fire");
    stage.world().despawn(cube);

    let ball = stage.grid(level_set::sphere(DVec3::ZERO, 20.0), SMOOTH, 0.1);
    let ball = (VdbVolume(ball), glow(GREEN), VdbClippedBy(planes.to_vec()));
    stage.world().spawn((ball, Transform::from_scale(Vec3::splat(5.0))));
    // The eye is in the half that is cut away, and nothing of the ball but the cap is in front of it.
    let view = Transform::from_xyz(0.3, 0.2, 1.0).looking_at(Vec3::new(-0.4, -0.7, -1.0), Vec3::Y);
    let depths = VdbCamera { mode: VdbRenderMode::Depth, ..default() };
    stage.world().entity_mut(camera).insert((view, depths));
    let expected = 0.1 / (1.05 / -view.forward().z);
    let depth = stage.picture(&target).center().x;
    assert!((depth / expected - 1.0).abs() < 2e-3, "{depth} in place of {expected}");
    // A mesh within the solid is behind the cap.
    stage.red_cube(0.3, Transform::from_translation(view.translation + 1.5 * view.forward()));
    let depth = stage.picture(&target).center().x;
    assert!((depth / expected - 1.0).abs() < 2e-3, "{depth} in place of {expected}, before a mesh");
}

/// Half a cube of fog that a plane cuts, and one of half the voxels, with the sun behind the plane and before it.
#[gpu_test]
fn cut_fog_is_lit_as_fog_that_ends_there() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(1.0, 2.0, 7.0)));
    let half = CoordBox { min: IVec3::splat(-12), max: IVec3::new(-1, 11, 11) };
    let half = stage.grid(fog::block(half, 1.0), PackKind::Fog, 0.1);
    let whole = stage.cube_of_fog(12, 0.1);
    // The density of the half falls from 1 to 0 within a voxel about this plane.
    let plane = stage.clip_plane(Vec3::X * -0.05, Vec3::X);
    let turn = stage.world().get::<Transform>(plane).unwrap().rotation;
    let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
    let sun = stage.world().spawn(sun).id();
    let fog = stage.world().spawn((VdbVolume(half.clone()), VdbMaterial::default())).id();
    for quality in [VdbQuality::HIGH, VdbQuality { fog_light_error: 0.0, ..VdbQuality::HIGH }] {
        stage.world().entity_mut(camera).insert(quality);
        for from in [Vec3::new(4.0, 1.0, 1.0), Vec3::new(-4.0, 1.0, 1.0)] {
            let at = Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y);
            stage.world().entity_mut(sun).insert(at);
            stage.world().entity_mut(fog).insert(VdbVolume(half.clone())).remove::<VdbClippedBy>();
            let expected = stage.picture(&target);
            let cut = (VdbVolume(whole.clone()), VdbClippedBy(vec![plane]));
            stage.world().entity_mut(fog).insert(cut);
            // The light that is cached there is not that of another cut.
            let to = |x| Transform::from_xyz(x, 0.0, 0.0).with_rotation(turn);
            stage.world().entity_mut(plane).insert(to(0.8));
            stage.picture(&target);
            stage.world().entity_mut(plane).insert(to(-0.05));
            let cut = stage.picture(&target);
            cut.save("clip_fog");
            let sum = |picture: &Picture| picture.pixels.iter().map(|pixel| pixel.y).sum::<f32>();
            let (cut, expected) = (sum(&cut), sum(&expected));
            println!("{from}: {cut}, {expected}");
            assert!(expected > 1.0);
            assert!((cut / expected - 1.0).abs() < 0.015, "{from}: {cut} in place of {expected}");
        }
    }
}

/// A thin slice of a ball under the sun, which meets no surface of the ball within the slice: on a mesh and on
/// another volume.
#[gpu_test]
fn a_slice_casts_its_own_shadow() {
    let mut stage = Stage::new();
    stage.world().insert_resource(DirectionalLightShadowMap { size: 1024 });
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(0.0, 5.0, 8.0));
    stage.camera(&target, view);
    let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
    let down = Transform::from_xyz(0.0, 9.0, 0.0).looking_at(Vec3::ZERO, Vec3::Z);
    stage.world().spawn((sun, down));
    let planes = [
        stage.clip_plane(Vec3::Y * 0.13, Vec3::Y),
        stage.clip_plane(Vec3::Y * -0.13, Vec3::NEG_Y),
        // Half of the slice.
        stage.clip_plane(Vec3::ZERO, Vec3::X),
    ];
    let white = VdbMaterial { reflectance: 0.0, perceptual_roughness: 1.0, ..default() };
    let clipped = VdbClippedBy(planes.to_vec());
    let (under, beside) = (Vec3::new(-0.4, -2.0, 0.2), Vec3::new(0.4, -2.0, 0.2));
    let slab = CoordBox { min: IVec3::new(-40, -30, -40), max: IVec3::new(40, -21, 40) };
    let floor = stage.grid(fog::block(slab, 1.0), PackKind::Smooth { iso: 0.5 }, 0.1);
    let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(8.0, 1.0, 8.0));
    let lambert = StandardMaterial { reflectance: 0.0, perceptual_roughness: 1.0, ..default() };
    let lambert = stage.world().resource_mut::<Assets<StandardMaterial>>().add(lambert);
    for (is_mesh, kind) in [(true, SMOOTH), (false, SMOOTH), (true, SURFACE), (false, SURFACE)] {
        let ball = stage.grid(level_set::sphere(DVec3::ZERO, 10.0), kind, 0.1);
        let ball = stage.world().spawn((VdbVolume(ball), white.clone(), clipped.clone())).id();
        let floor = match is_mesh {
            true => {
                let at = Transform::from_xyz(0.0, -2.5, 0.0);
                stage
                    .world()
                    .spawn((Mesh3d(mesh.clone()), MeshMaterial3d(lambert.clone()), at))
                    .id()
            }
            false => stage.world().spawn((VdbVolume(floor.clone()), white.clone())).id(),
        };
        let picture = stage.picture(&target);
        let what = format!("{kind:?}, on a mesh: {is_mesh}");
        picture.save(&format!("clip_slice_{what}"));
        let [dark, lit] = [under, beside].map(|at| brightness(&picture, view, at));
        assert!(lit > 0.1, "{what}: {lit}");
        assert!(dark < 0.05 * lit, "{what}: {dark} under the slice, {lit} beside it");
        // The sun lights all of the cap as it does any level surface.
        for (x, z) in (1..7).flat_map(|x| (-6..7).map(move |z| (-0.1 * x as f32, 0.1 * z as f32))) {
            let cap = brightness(&picture, view, Vec3::new(x, 0.13, z));
            assert!(
                (cap / lit - 1.0).abs() < 0.05,
                "{what}: {cap} at {x}, {z}, {lit} on the floor"
            );
        }
        stage.world().despawn(ball);
        stage.world().despawn(floor);
    }
}

/// The green of the pixel that shows a point.
fn brightness(picture: &Picture, view: Transform, point: Vec3) -> f32 {
    let at = view.compute_affine().inverse().transform_point3(point);
    let half = 22.5_f32.to_radians().tan() * -at.z;
    let size = SIZE.as_vec2();
    let x = (0.5 + 0.5 * at.x / half * size.y / size.x) * size.x;
    let y = (0.5 - 0.5 * at.y / half) * size.y;
    picture.at(x as u32, y as u32).y
}
