//! Verdicts on answers that are right, wrong and excusable.

use glam::{DVec3, Vec3};
use vdb_core::{
    reference::{Blocky, Face, Occupied, Ray, Smooth, SurfaceVerdict, VoxelVerdict},
    synth,
    tree::{CoordBox, IVec3},
};

#[test]
fn voxels() {
    let tree = synth::sparse::voxels(&[IVec3::new(4, 0, 0), IVec3::new(4, -1, 0)]);
    let blocky = Blocky::new(&tree, Occupied::Active);
    let hit = |y, axis, sign| Some((IVec3::new(4, y, 0), Some(Face { axis, sign })));
    let ray = Ray::new(IVec3::ZERO, Vec3::ZERO, Vec3::X);
    assert_eq!(blocky.judge(&ray, hit(0, 0, -1)), VoxelVerdict::Right);
    assert_eq!(blocky.judge(&ray, hit(0, 1, -1)), VoxelVerdict::WrongFace);
    assert_eq!(blocky.judge(&ray, hit(-1, 0, -1)), VoxelVerdict::WrongVoxel);
    assert_eq!(blocky.judge(&ray, None), VoxelVerdict::WrongVoxel);
    // From the lower face of y = 0, downward by less than anything: the plane is crossed at t = 0.
    let down = Ray::new(IVec3::ZERO, Vec3::new(0.0, -0.5, 0.0), Vec3::new(1.0, -1e-45, 0.0));
    assert_eq!(blocky.judge(&down, hit(-1, 0, -1)), VoxelVerdict::Right);
    assert_eq!(blocky.judge(&down, hit(0, 0, -1)), VoxelVerdict::RightWhenFlushed);
}

#[test]
fn surfaces() {
    let sphere = synth::level_set::sphere(DVec3::ZERO, 20.0);
    let smooth = Smooth::new(&sphere, 0.0);
    let ray = Ray::new(IVec3::new(-30, 0, 0), Vec3::ZERO, Vec3::new(2.0, 0.0, 0.0));
    let noise = 1e-6;
    // t = 5, at two voxels a unit.
    let judge = |answer| smooth.judge(&ray, answer, noise);
    assert!(matches!(judge(Some(5.001)), SurfaceVerdict::Off(off) if (off - 0.002).abs() < 1e-9));
    assert_eq!(judge(None), SurfaceVerdict::Missed);
    assert_eq!(judge(Some(25.0)), SurfaceVerdict::Missed);
    assert_eq!(judge(Some(4.0)), SurfaceVerdict::Invented);
    let away = Ray { dir: Vec3::NEG_X, ..ray };
    assert_eq!(smooth.judge(&away, None, noise), SurfaceVerdict::BothMiss);
    assert_eq!(smooth.judge(&away, Some(1.0), noise), SurfaceVerdict::Invented);
}

#[test]
fn near_double_roots_are_excused_up_to_the_noise() {
    // (x - 1/2)² + lift along x = y, as in `smooth.rs`.
    let verdict = |lift: f64, answer, noise| {
        let bbox = CoordBox { min: IVec3::ZERO, max: IVec3::ONE };
        let tree = synth::fog::from_values(bbox, |ijk| {
            let (x, y) = (f64::from(ijk.x), f64::from(ijk.y));
            (x * y - (x + y) / 2.0 + 0.25 + lift) as f32
        });
        let dir = Vec3::new(1.0, 1.0, 0.0);
        let ray = Ray::new(IVec3::ZERO, Vec3::splat(0.125), dir).with_span(0.0, 0.75);
        // The noise is in parts of the greatest corner, a quarter.
        Smooth::new(&tree, 0.0).judge(&ray, answer, 4.0 * noise)
    };
    let lift = 2.0_f64.powi(-14);
    // A graze: a hit there is excused by a noise above its distance.
    assert_eq!(verdict(lift, Some(0.375), 2.0 * lift), SurfaceVerdict::NearDouble);
    assert_eq!(verdict(lift, Some(0.375), 0.5 * lift), SurfaceVerdict::Invented);
    // A dip: to miss it is excused by a noise above its depth.
    assert_eq!(verdict(-lift, None, 2.0 * lift), SurfaceVerdict::NearDouble);
    assert_eq!(verdict(-lift, None, 0.5 * lift), SurfaceVerdict::Missed);
    // To see the far side of the dip alone, too.
    let far = 0.375 + lift.sqrt();
    assert_eq!(verdict(-lift, Some(far + 0.6), 2.0 * lift), SurfaceVerdict::Invented);
    assert!(matches!(verdict(-lift, Some(far), 0.5 * lift), SurfaceVerdict::Off(_)));
}
