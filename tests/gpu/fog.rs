//! Optical depth.

use glam::{DVec3, IVec3, Vec3};
use vdb_core::pack::{PackKind, PackedGrid, walk};
use vdb_core::reference::{Fog, Ray};
use vdb_core::synth::Random;
use vdb_core::synth::{fog, sparse};
use vdb_core::tree::{CoordBox, Vdb543};

use vdb_probe::{Gpu, ProbeKind, ProbeRay};

use crate::probe;

fn check(gpu: &Gpu, tree: &Vdb543<f32>, seed: u64, count: usize) {
    /// Of ∫ density dt, in voxels at density 1: relative to the largest depth the grid can have.
    const TOLERANCE: f64 = 1e-4;
    let grid = PackedGrid::new(tree, PackKind::Fog).unwrap();
    let bounds = grid.occupied.unwrap();
    let center = (bounds.min + bounds.max).as_dvec3() * 0.5;
    let radius = (bounds.max - bounds.min).as_dvec3().length() * 0.5 + 1.0;
    let mut random = Random::new(seed);
    let mut vector = || DVec3::from_array(std::array::from_fn(|_| random.range(-1.0, 1.0)));
    let rays: Vec<(ProbeRay, Ray)> = (0..count)
        .map(|i| {
            // Every fifth starts inside, every seventh runs along an axis.
            let from = if i % 5 == 0 { 0.3 } else { 3.0 };
            let origin = center + vector() * radius * from;
            let mut dir = (center + vector() * radius * 0.6 - origin).normalize();
            if i % 7 == 0 {
                dir = DVec3::AXES[i % 3] * dir.x.signum();
            }
            let cell = origin.floor().as_ivec3();
            let frac = (origin - origin.floor()).as_vec3();
            let dir = dir.as_vec3();
            let probe = walk::Ray { cell, frac, dir, t_min: 0.0, t_max: 1e30 };
            (probe.into(), Ray::new(cell + grid.base, frac, dir))
        })
        .collect();
    let probes: Vec<ProbeRay> = rays.iter().map(|(probe, _)| *probe).collect();
    let hits = probe(gpu, ProbeKind::Fog, &grid, &probes);
    let oracle = Fog::new(tree);
    let (mut met, mut worst) = (0, 0.0_f64);
    let scale = f64::from(grid.majorant) * radius;
    for ((_, ray), hit) in rays.iter().zip(&hits) {
        let expected = oracle.optical_depth(ray);
        met += i32::from(expected.value > 0.0);
        let error = (f64::from(hit.optical_length) - expected.value).abs() / scale;
        assert!(error.is_finite() && error < TOLERANCE, "{ray:?}: {hit:?}, not {expected:?}");
        worst = worst.max(error);
    }
    println!("{count} rays, {met} through fog, optical depth to {worst:.2e} of {scale:.3}");
    assert!(met * 20 > count as i32, "hardly a ray met anything: {met}");
}

#[test]
fn optical_depth_is_that_of_the_reference_tracer() {
    let Some(gpu) = Gpu::find() else { return };
    let cube = |min: i32, max: i32| CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) };
    check(&gpu, &fog::sphere(DVec3::new(10.0, -30.0, 4090.0), 25.0, 6.0), 1, 5000);
    check(&gpu, &fog::ramp(cube(-20, 37), DVec3::new(0.01, 0.02, 0.005), 1.0), 2, 5000);
    check(&gpu, &sparse::random(cube(-20, 20), 0.05, 9), 3, 5000);
}

#[test]
fn tiles_of_every_level_and_their_borders() {
    let Some(gpu) = Gpu::find() else { return };
    let block = fog::block(CoordBox { min: IVec3::splat(-130), max: IVec3::splat(300) }, 0.01);
    assert!(block.active_values().any(|value| value.log2_dim == 7), "no tile of 128³");
    assert!(block.active_values().any(|value| value.log2_dim == 3), "no tile of 8³");
    check(&gpu, &block, 4, 3000);
    let mut root = Vdb543::new(0.0);
    root.insert_tile(IVec3::new(0, -4096, 0), 0.001, true);
    root.set(IVec3::new(-3, -3, -3), 0.5);
    check(&gpu, &root, 5, 500);
}

#[test]
fn a_homogeneous_slab_dims_as_beer_and_lambert_say() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = fog::block(CoordBox { min: IVec3::ZERO, max: IVec3::splat(63) }, 0.25);
    let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
    let cell = IVec3::new(32, 32, -50) - grid.base;
    let ray = walk::Ray { cell, frac: Vec3::splat(0.25), dir: Vec3::Z, t_min: 0.0, t_max: 1e30 };
    let hit = probe(&gpu, ProbeKind::Fog, &grid, &[ray.into()])[0];
    // 63 whole cells between 64 samples, and half a cell of ramp on either side.
    let expected = 0.25 * 64.0;
    assert!((hit.optical_length - expected).abs() < 1e-4, "{hit:?}, not {expected}");
}
