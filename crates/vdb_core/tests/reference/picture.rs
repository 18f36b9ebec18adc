//! Whole pictures: closed forms, pixel by pixel.

use glam::{DAffine3, DMat3, DQuat, DVec3, UVec2, Vec3, Vec4};
use vdb_core::{
    reference::{
        Occupied,
        picture::{Camera, Look, Projection, Scene, SunLight, Volume, VolumeKind, render},
    },
    synth,
    tree::{CoordBox, IVec3, Vdb543},
};

const SIZE: UVec2 = UVec2::new(33, 21);

fn scene<'a>(
    volumes: &[(&'a Vdb543<f32>, DAffine3, VolumeKind)],
) -> Scene<
    'a,
    vdb_core::tree::InternalNode<
        vdb_core::tree::InternalNode<vdb_core::tree::LeafNode<f32, 3>, 4>,
        5,
    >,
> {
    let volumes = volumes.iter().map(|&(tree, world_from_index, kind)| Volume {
        tree,
        world_from_index,
        kind,
    });
    Scene {
        volumes: volumes.collect(),
        sun: SunLight { direction: DVec3::new(0.2, -1.0, 0.4), radiance: Vec3::ONE },
        ambient: Vec3::ZERO,
        background: Vec4::ZERO,
        shadows: false,
        look: Look::Lambert,
    }
}

fn camera(distance: f64, projection: Projection) -> Camera {
    let eye = DVec3::new(0.3, -1.0, 0.2).normalize() * distance;
    Camera { eye, target: DVec3::ZERO, up: DVec3::Z, projection }
}

fn projections(distance: f64, height: f64) -> [Camera; 2] {
    let fov_y = 2.0 * (height / 2.0 / distance).atan();
    [
        camera(distance, Projection::Perspective { fov_y }),
        camera(distance, Projection::Orthographic { height }),
    ]
}

/// An ellipsoid, from a sphere in index space by rotation, anisotropic scale and a mirror: depth and
/// Lambert's cosine in world space, for both projections.
#[test]
fn an_ellipsoid_has_its_depth_and_its_shading() {
    let radius = 40.0;
    let tree = synth::level_set::sphere(DVec3::ZERO, radius);
    let matrix = DMat3::from_quat(DQuat::from_rotation_z(0.7))
        * DMat3::from_diagonal(DVec3::new(-0.02, 0.01, 0.05));
    let world_from_index = DAffine3::from_mat3(matrix);
    let kind = VolumeKind::Smooth { iso: 0.0, albedo: Vec3::ONE };
    let scene = scene(&[(&tree, world_from_index, kind)]);
    let inverse = matrix.inverse();
    for camera in projections(8.0, 2.0) {
        let picture = render(&scene, &camera, SIZE);
        let (mut hits, mut misses) = (0, 0);
        for (i, (color, depth)) in picture.color.iter().zip(&picture.depth).enumerate() {
            let pixel = UVec2::new(i as u32 % SIZE.x, i as u32 / SIZE.x);
            let (origin, direction) = camera.ray(pixel, SIZE);
            // |M⁻¹ (o + t d)| = radius.
            let (o, d) = (inverse * origin, inverse * direction);
            let (a, b, c) = (d.dot(d), o.dot(d), o.dot(o) - radius * radius);
            // Interpolation is off by 1 / (4 · 38) voxels along the normal (see `smooth.rs`), the
            // direction by 2⁻²⁴ over 8 / 0.01 voxels: so much more along the ray where it grazes.
            let voxels = 1.0 / 152.0 + 800.0 * 2.0_f64.powi(-24);
            let closest = (o.dot(o) - b * b / a).sqrt();
            if closest > radius + voxels {
                assert!(depth.is_infinite() && *color == Vec4::ZERO, "{pixel} {depth} {color}");
                misses += 1;
                continue;
            }
            let facing = (1.0 - (closest / radius).powi(2)).max(0.0).sqrt();
            if facing < 0.3 {
                continue;
            }
            let exact = (-b - (b * b - a * c).sqrt()) / a;
            let out = o + exact * d;
            let bound = voxels / facing / d.length() * 1.1;
            assert!((f64::from(*depth) - exact).abs() < bound, "{pixel} {depth} {exact} {bound}");
            let normal = (inverse.transpose() * out).normalize();
            let lambert = normal.dot(scene.sun.direction.normalize()).max(0.0);
            // A tilt of 0.0193 (see `smooth.rs`) in index space, at most 5 times that by the scales.
            assert!((f64::from(color.x) - lambert).abs() < 0.1, "{pixel} {color} {lambert}");
            hits += 1;
        }
        assert!(hits > 80 && misses > 80, "{hits} {misses}");
    }
}

#[test]
fn a_box_of_voxels_has_flat_depth() {
    let bbox = CoordBox { min: IVec3::splat(-8), max: IVec3::splat(7) };
    let tree = synth::fog::block(bbox, 1.0);
    let kind = VolumeKind::Blocky { occupied: Occupied::Active, albedo: Vec3::ONE };
    let at = DAffine3::from_scale(DVec3::splat(0.25));
    let scene = scene(&[(&tree, at, kind)]);
    let camera = Camera {
        eye: DVec3::new(0.0, -10.0, 0.0),
        target: DVec3::ZERO,
        up: DVec3::Z,
        projection: Projection::Orthographic { height: 3.0 },
    };
    let picture = render(&scene, &camera, SIZE);
    // The lower face lies at -8.5 voxels of 0.25. Every ray that meets the box meets that face.
    assert!(picture.depth.iter().all(|depth| depth.is_infinite() || *depth == 10.0 - 8.5 * 0.25));
    assert!(picture.depth.iter().filter(|depth| depth.is_finite()).count() > 400);
}

/// In a furnace, where light comes equally from everywhere and everything reflects, scatters or
/// glows as brightly, there is nothing to see.
#[test]
fn a_white_furnace_shows_nothing() {
    let sphere = synth::level_set::sphere(DVec3::ZERO, 20.0);
    let truss =
        synth::sparse::truss(CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) }, 9, 2);
    let fog = synth::fog::sphere(DVec3::new(5.0, -30.0, 0.0), 25.0, 9.0);
    let (white, half, none) = (Vec3::ONE, Vec3::splat(0.5), Vec3::ZERO);
    let at = DAffine3::from_scale(DVec3::splat(0.1));
    let beside = DAffine3::from_translation(DVec3::new(1.5, 0.0, 0.0)) * at;
    let mut scene = scene(&[
        (&sphere, at, VolumeKind::Smooth { iso: 0.0, albedo: white }),
        (&truss, beside, VolumeKind::Blocky { occupied: Occupied::Active, albedo: white }),
        // Two that overlap: one scatters all, one scatters half and glows with the other half.
        (
            &fog,
            at,
            VolumeKind::Fog { extinction: 0.7, albedo: white, emission: none, anisotropy: 0.0 },
        ),
        (
            &fog,
            beside,
            VolumeKind::Fog { extinction: 3.0, albedo: half, emission: half, anisotropy: 0.0 },
        ),
    ]);
    scene.sun.radiance = none;
    scene.ambient = white;
    scene.background = Vec4::ONE;
    for camera in projections(10.0, 7.0) {
        let picture = render(&scene, &camera, SIZE);
        assert!(picture.depth.iter().any(|depth| depth.is_finite()));
        for color in &picture.color {
            assert!((*color - Vec4::ONE).abs().max_element() < 1e-5, "{color}");
        }
    }
}

#[test]
fn surfaces_hide_fog_and_fog_dims_surfaces() {
    let block = synth::fog::block(CoordBox { min: IVec3::splat(-8), max: IVec3::splat(7) }, 1.0);
    let sphere = synth::level_set::sphere(DVec3::ZERO, 20.0);
    let fog = VolumeKind::Fog {
        extinction: 0.1,
        albedo: Vec3::ZERO,
        emission: Vec3::ONE,
        anisotropy: 0.0,
    };
    let surface = VolumeKind::Smooth { iso: 0.0, albedo: Vec3::ZERO };
    let camera = Camera {
        eye: DVec3::new(0.0, -100.0, 0.0),
        target: DVec3::ZERO,
        up: DVec3::Z,
        projection: Projection::Orthographic { height: 4.0 },
    };
    let light = |y: f64| {
        let moved = DAffine3::from_translation(DVec3::new(0.0, y, 0.0));
        let scene = scene(&[(&sphere, DAffine3::IDENTITY, surface), (&block, moved, fog)]);
        render(&scene, &camera, UVec2::ONE).color[0].x
    };
    let all = 1.0 - (-1.6_f32).exp();
    assert!((light(-40.0) - all).abs() < 1e-6, "before");
    assert!(light(5.0).abs() < 1e-6, "inside and behind");
    // The middle of the block lies at -1/2, so the sphere's face at -20 halves it. The surface of
    // the interpolant lies 1/72 of a voxel off at most.
    let half = 1.0 - (-0.8_f32).exp();
    assert!((light(-19.5) - half).abs() < 0.1 / 72.0, "cut in halves");
}

#[test]
fn shadows_fall() {
    let sphere = synth::level_set::sphere(DVec3::ZERO, 10.0);
    let fog = synth::fog::block(CoordBox { min: IVec3::splat(-16), max: IVec3::splat(15) }, 1.0);
    let surface = VolumeKind::Smooth { iso: 0.0, albedo: Vec3::ONE };
    let camera = Camera {
        eye: DVec3::new(0.0, -100.0, 0.0),
        target: DVec3::ZERO,
        up: DVec3::Z,
        projection: Projection::Orthographic { height: 2.0 },
    };
    let light = |kind: VolumeKind, tree, shadows| {
        // Between the surface, at y = -10, and the sun.
        let above = DAffine3::from_translation(DVec3::new(0.0, -60.0, 60.0));
        let mut scene = scene(&[(&sphere, DAffine3::IDENTITY, surface), (tree, above, kind)]);
        scene.sun.direction = DVec3::new(0.0, -1.0, 1.0);
        scene.shadows = shadows;
        render(&scene, &camera, UVec2::ONE).color[0].x
    };
    let open = light(surface, &sphere, false);
    // A sphere of 10 voxels tilts by at most 0.104 (see `smooth.rs`).
    assert!((open - 0.5_f32.sqrt()).abs() < 0.104, "{open}");
    assert_eq!(light(surface, &sphere, true), 0.0);
    let smoke = VolumeKind::Fog {
        extinction: 0.01,
        albedo: Vec3::ZERO,
        emission: Vec3::ZERO,
        anisotropy: 0.0,
    };
    // From (0, -10, 0) towards the sun, in the block's index space: y = 50 - s, z = s - 60. Between
    // z = -16 and y = -16 lie 22 voxels, and two ramps of half a voxel. Interpolation and bias move
    // the start by a thirtieth of a voxel at most.
    let passed = light(smoke, &fog, true) / open;
    let depth = |voxels: f32| 0.01 * voxels * 2.0_f32.sqrt();
    assert!((passed - (-depth(23.0)).exp()).abs() < depth(1.0 / 30.0), "{passed}");
}
