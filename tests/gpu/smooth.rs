//! Smooth surfaces.

use glam::{DVec3, Vec3};
use vdb_core::pack::{PackKind, PackedGrid, walk};
use vdb_core::reference::{Ray, Smooth, SurfaceVerdict};
use vdb_core::synth::{Random, level_set};
use vdb_core::tree::{IVec3, Vdb543};

use vdb_probe::{Gpu, ProbeKind, ProbeRay};

use crate::{probe, ray_count};

/// A dip past the surface that is shallower than this (in voxels of a level set) may be overlooked:
/// a few roundings of an f32 interpolant with values up to three.
const NOISE: f64 = 3e-6;

fn check(gpu: &Gpu, tree: &Vdb543<f32>, seed: u64, far: f64) {
    let grid = PackedGrid::new(tree, PackKind::Smooth { iso: 0.0 }).unwrap();
    let bounds = grid.occupied.unwrap();
    let center = (bounds.min + bounds.max).as_dvec3() * 0.5;
    let radius = (bounds.max - bounds.min).as_dvec3().length() * 0.5 + 1.0;
    let mut random = Random::new(seed);
    let mut vector = || DVec3::from_array(std::array::from_fn(|_| random.range(-1.0, 1.0)));
    let rays: Vec<(ProbeRay, Ray)> = (0..ray_count(10_000))
        .map(|i| {
            let origin = center + vector().normalize() * radius * far;
            let mut dir = (center + vector() * radius * 0.6 - origin).normalize().as_vec3();
            if i % 5 == 0 {
                dir = Vec3::AXES[i % 3] * dir.x.signum();
            }
            let cell = origin.floor();
            let frac = ((origin - cell) * f64::from(1 << 24)).floor() / f64::from(1 << 24);
            let ray = walk::Ray {
                cell: cell.as_ivec3(),
                frac: frac.as_vec3(),
                dir,
                t_min: 0.0,
                t_max: 1e30,
            };
            (ray.into(), Ray::new(ray.cell + grid.base, ray.frac, dir))
        })
        .collect();
    let probes: Vec<ProbeRay> = rays.iter().map(|(probe, _)| *probe).collect();
    let hits = probe(gpu, ProbeKind::Smooth, &grid, &probes);
    let oracle = Smooth::new(tree, 0.0);
    let (mut errors, mut angles, mut doubles) = (Vec::new(), Vec::new(), 0);
    for ((_, ray), hit) in rays.iter().zip(&hits) {
        let found = (hit.hit != 0).then_some(f64::from(hit.t));
        match oracle.judge(ray, found, NOISE) {
            SurfaceVerdict::Off(error) => {
                errors.push(error);
                if let Some(normal) = oracle.first_root(ray).and_then(|hit| hit.normal()) {
                    let own = Vec3::from_array(hit.gradient).as_dvec3().normalize();
                    angles.push(own.dot(normal).clamp(-1.0, 1.0).acos().to_degrees());
                }
            }
            SurfaceVerdict::NearDouble => doubles += 1,
            SurfaceVerdict::BothMiss => {}
            wrong => panic!("{wrong:?}: {hit:?} for {ray:?}, {:?}", oracle.first_root(ray)),
        }
    }
    errors.sort_by(f64::total_cmp);
    angles.sort_by(f64::total_cmp);
    let at = |sorted: &[f64], part: f64| sorted[((sorted.len() - 1) as f64 * part) as usize];
    println!(
        "{} rays, {} roots, position p50 {:.1e} p99.99 {:.1e} max {:.1e} voxels, normals p99.99 \
         {:.1e} max {:.1e} degrees, {doubles} near-double",
        rays.len(),
        errors.len(),
        at(&errors, 0.5),
        at(&errors, 0.9999),
        at(&errors, 1.0),
        at(&angles, 0.9999),
        at(&angles, 1.0),
    );
    assert!(errors.len() * 5 > rays.len(), "hardly a ray met anything");
    assert!(at(&errors, 0.9999) < 1e-3 && at(&errors, 1.0) < 1e-2, "positions are off");
    assert!(at(&angles, 0.9999) < 0.1, "normals are off");
}

#[test]
fn roots_are_those_of_the_reference_tracer() {
    let Some(gpu) = Gpu::find() else { return };
    check(&gpu, &level_set::sphere(DVec3::new(3.3, -200.7, 40.1), 30.3), 1, 3.0);
    check(&gpu, &level_set::torus(DVec3::splat(1e6), 40.0, 12.5), 2, 3.0);
    check(&gpu, &level_set::gyroid(DVec3::ZERO, 40.0, 18.0), 3, 3.0);
    check(&gpu, &level_set::cuboid(DVec3::splat(-20.5), DVec3::new(30.2, 7.7, 15.1)), 4, 3.0);
    // Noise of both signs: every cell crosses.
    let mut noise = Random::new(9);
    let mut tree = Vdb543::new(1.0);
    for x in -20..=20 {
        for y in -20..=20 {
            for z in -20..=20 {
                tree.set(IVec3::new(x, y, z), noise.range(-1.0, 1.0) as f32);
            }
        }
    }
    check(&gpu, &tree, 5, 3.0);
}
