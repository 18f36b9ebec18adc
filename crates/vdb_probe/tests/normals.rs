//! Normals of smooth surfaces against those of the shapes that were sampled: the gradient of the trilinear interpolant
//! and the one interpolated between cells by `assets/shaders/traversal/normals.wgsl`.

use std::f64::consts::TAU;

use glam::DVec3;
use vdb_core::pack::{PackKind, PackOptions, PackedGrid, ValueFormat, traverse};
use vdb_core::reference::{Ray, Smooth};
use vdb_core::synth::{Random, level_set};
use vdb_core::tree::Vdb543;
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeHit, ProbeKind, ProbeRay};

/// A shape around the origin.
struct Shape {
    name: &'static str,
    tree: Vdb543<f32>,
    /// Its half extent, in voxels.
    extent: f64,
    /// A vector along the normal at a point of its surface; `None` where it has none.
    normal: Box<dyn Fn(DVec3) -> Option<DVec3>>,
}

/// Beside the origin, so that no sample lies at a place of symmetry.
const CENTER: DVec3 = DVec3::new(0.31, 0.57, 0.12);

fn sphere(radius: f64) -> Shape {
    let tree = level_set::sphere(CENTER, radius);
    Shape { name: "sphere", tree, extent: radius, normal: Box::new(|p| Some(p - CENTER)) }
}

fn torus(ring: f64) -> Shape {
    let tube = ring / 2.0;
    let normal = move |p: DVec3| {
        let p = p - CENTER;
        let along = p.truncate().normalize_or_zero();
        Some((p.truncate() - ring * along).extend(p.z))
    };
    let tree = level_set::torus(CENTER, ring, tube);
    Shape { name: "torus", tree, extent: ring + tube, normal: Box::new(normal) }
}

fn gyroid(period: f64) -> Shape {
    let radius = 0.8 * period;
    let normal = move |p: DVec3| {
        let p = p - CENTER;
        let (s, c) = ((p * TAU / period).map(f64::sin), (p * TAU / period).map(f64::cos));
        let value = s.x * c.y + s.y * c.z + s.z * c.x;
        let gradient =
            DVec3::new(c.x * c.y - s.z * s.x, c.y * c.z - s.x * s.y, c.z * c.x - s.y * s.z);
        // Where the ball ends that holds it, the surface is that of the ball.
        (p.length() < radius - 4.0 && value.abs() < 0.1).then_some(gradient)
    };
    let tree = level_set::gyroid(CENTER, radius, period);
    Shape { name: "gyroid", tree, extent: radius, normal: Box::new(normal) }
}

/// The three shapes, at `2^doublings` times the lowest resolution.
fn shapes(doublings: i32) -> [Shape; 3] {
    let scale = f64::from(1 << doublings);
    [sphere(8.0 * scale), torus(8.0 * scale), gyroid(16.0 * scale)]
}

/// Rays through a shape, and the points where they begin, in index space.
fn rays(shape: &Shape, grid: &PackedGrid, count: usize) -> Vec<(DVec3, traverse::Ray)> {
    let mut random = Random::new(7);
    let mut vector = || DVec3::from_array([0; 3].map(|_| random.range(-1.0, 1.0)));
    let mut ray = || {
        let origin = CENTER + vector().normalize_or_zero() * 2.0 * shape.extent;
        let dir = (CENTER + vector() * shape.extent - origin).normalize();
        let cell = origin.floor();
        let (frac, dir) = ((origin - cell).as_vec3(), dir.as_vec3());
        let ray = traverse::Ray::from_index(grid, cell.as_ivec3(), frac, dir);
        (cell + ray.frac.as_dvec3(), ray)
    };
    (0..count).map(|_| ray()).collect()
}

fn send(
    gpu: &Gpu,
    grid: &PackedGrid,
    rays: &[(DVec3, traverse::Ray)],
    defs: &[&str],
) -> Vec<ProbeHit> {
    let rays: Vec<ProbeRay> = rays.iter().map(|(_, ray)| (*ray).into()).collect();
    Probe::with_defs(gpu, ProbeKind::Smooth, defs).send(&GpuGrid::new(gpu, grid), &rays)
}

fn degrees(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b)).to_degrees()
}

fn gradient(hit: &ProbeHit) -> DVec3 {
    DVec3::from_array(hit.gradient.map(f64::from))
}

/// The median and the 99th percentile.
fn percentiles(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_unstable_by(f64::total_cmp);
    [0.5, 0.99].map(|part| values[(part * (values.len() - 1) as f64) as usize])
}

fn packed(shape: &Shape, format: ValueFormat) -> PackedGrid {
    let options = PackOptions { format, ..PackOptions::default() };
    PackedGrid::with_options(&shape.tree, PackKind::Smooth { iso: 0.0 }, &options).unwrap()
}

/// Angles to the true normals; those of smooth gradients are at most a quarter of those of trilinear ones.
#[test]
fn smooth_gradients_are_closer_to_the_true_normals() {
    let Some(gpu) = Gpu::find() else { return };
    println!("| shape | voxels across | trilinear: median, p99 | smooth: median, p99 | ratio |");
    for doublings in 0..4 {
        for shape in shapes(doublings) {
            let grid = packed(&shape, ValueFormat::Exact);
            let rays = rays(&shape, &grid, 40_000);
            let errors = [&[][..], &["SMOOTH_NORMALS"]].map(|defs| {
                let hits = send(&gpu, &grid, &rays, defs);
                let angles = hits.iter().zip(&rays).filter_map(|(hit, (origin, ray))| {
                    let point = origin + f64::from(hit.t) * ray.dir.as_dvec3();
                    let truth = (hit.hit != 0).then(|| (shape.normal)(point)).flatten()?;
                    Some(degrees(gradient(hit), truth))
                });
                let angles: Vec<f64> = angles.collect();
                assert!(angles.len() > 4000, "{}: {} hits", shape.name, angles.len());
                percentiles(angles)
            });
            let [[p50, p99], [own_p50, own_p99]] = errors;
            let ratios = [own_p50 / p50, own_p99 / p99];
            println!(
                "| {} | {:.0} | {p50:.3}°, {p99:.3}° | {own_p50:.4}°, {own_p99:.4}° | {:.3}, {:.3} |",
                shape.name,
                2.0 * shape.extent,
                ratios[0],
                ratios[1],
            );
            assert!(ratios.iter().all(|ratio| *ratio <= 0.25), "{}: {errors:?}", shape.name);
        }
    }
}

/// Between parallel rays a fiftieth of a voxel apart, smooth normals turn at most a quarter as far as trilinear ones,
/// which jump at the faces of cells.
#[test]
fn smooth_gradients_do_not_jump() {
    let Some(gpu) = Gpu::find() else { return };
    for shape in shapes(1) {
        let grid = packed(&shape, ValueFormat::Exact);
        let rays = rays(&shape, &grid, 60_000);
        let shifted: Vec<_> = rays
            .iter()
            .map(|(origin, ray)| {
                let side = ray.dir.as_dvec3().any_orthonormal_vector();
                let at = origin + 0.02 * side;
                let (cell, dir) = (at.floor(), ray.dir);
                let frac = (at - cell).as_vec3();
                (at, traverse::Ray::from_index(&grid, cell.as_ivec3(), frac, dir))
            })
            .collect();
        let worst = [&[][..], &["SMOOTH_NORMALS"]].map(|defs| {
            let [here, there] = [&rays, &shifted].map(|rays| send(&gpu, &grid, rays, defs));
            let turns = here.iter().zip(&there).zip(&rays).filter_map(|((a, b), (origin, ray))| {
                // Not where the rays pass an edge, or the end of the gyroid's ball.
                let point = origin + f64::from(a.t) * ray.dir.as_dvec3();
                (a.hit != 0 && b.hit != 0 && (a.t - b.t).abs() < 0.05)
                    .then(|| (shape.normal)(point))
                    .flatten()
                    .map(|_| degrees(gradient(a), gradient(b)))
            });
            turns.fold(0.0, f64::max)
        });
        println!(
            "{}: trilinear normals turn by up to {:.2}°, smooth ones by {:.2}°",
            shape.name, worst[0], worst[1]
        );
        assert!(worst[1] <= 0.25 * worst[0], "{}: {worst:?}", shape.name);
    }
}

/// Blocks store the samples of their own cells alone; where blocks begin must not matter.
#[test]
fn smooth_gradients_do_not_depend_on_the_place_of_blocks() {
    let Some(gpu) = Gpu::find() else { return };
    let at = |shift: i32| {
        let center = DVec3::new(0.25, -0.5, 0.125) + f64::from(shift);
        let tree = level_set::torus(center, 12.0, 5.3);
        let grid = PackedGrid::new(&tree, PackKind::Smooth { iso: 0.0 }).unwrap();
        let mut random = Random::new(3);
        let mut vector = || DVec3::from_array([0; 3].map(|_| random.range(-18.0, 18.0).round()));
        let rays: Vec<_> = (0..20_000)
            .map(|_| {
                let (cell, dir) = (vector(), (vector() - vector()).as_vec3());
                let dir = dir + glam::Vec3::new(0.25, 0.125, 0.5);
                let cell = (cell + f64::from(shift)).as_ivec3();
                let ray = traverse::Ray::from_index(&grid, cell, glam::Vec3::splat(0.25), dir);
                (DVec3::ZERO, ray)
            })
            .collect();
        send(&gpu, &grid, &rays, &["SMOOTH_NORMALS"])
    };
    let here = at(0);
    let hits = here.iter().filter(|hit| hit.hit != 0).count();
    assert!(hits > 5000, "{hits} hits");
    for shift in 1..8 {
        let differ = here.iter().zip(&at(shift)).filter(|(a, b)| a.gradient != b.gradient).count();
        assert_eq!(differ, 0, "of {hits}, shifted by {shift}");
    }
}

/// The shader computes the gradients of the reference, which uses f64.
#[test]
fn smooth_gradients_are_those_of_the_reference() {
    let Some(gpu) = Gpu::find() else { return };
    for shape in shapes(1) {
        let grid = packed(&shape, ValueFormat::Exact);
        let rays = rays(&shape, &grid, 20_000);
        let reference = Smooth::new(&shape.tree, 0.0);
        let hits = send(&gpu, &grid, &rays, &["SMOOTH_NORMALS"]);
        let angles = hits.iter().zip(&rays).filter_map(|(hit, (origin, ray))| {
            let cell = origin.floor();
            let frac = (origin - cell).as_vec3();
            let own = reference.first_root(&Ray::new(cell.as_ivec3(), frac, ray.dir))?;
            (hit.hit != 0).then(|| degrees(gradient(hit), reference.shading_gradient(&own)))
        });
        let [p50, p99] = percentiles(angles.collect());
        println!("{}: off by {p50:.6}° in the median, 99 % within {p99:.6}°", shape.name);
        assert!(p50 < 1e-4 && p99 < 1e-2, "{}: {p50} and {p99}", shape.name);
    }
}

/// Gradients from 16-bit and 8-bit samples agree with those from exact samples.
#[test]
fn smooth_gradients_are_alike_in_every_format() {
    let Some(gpu) = Gpu::find() else { return };
    let shape = torus(24.0);
    let [exact, half, byte] =
        [ValueFormat::Exact, ValueFormat::Half, ValueFormat::Byte].map(|format| {
            let grid = packed(&shape, format);
            let rays = rays(&shape, &grid, 5000);
            send(&gpu, &grid, &rays, &["SMOOTH_NORMALS"])
        });
    for (name, own, most) in [("16 bits", half, 0.1), ("8 bits", byte, 1.5)] {
        let both = exact.iter().zip(&own).filter(|(a, b)| a.hit != 0 && b.hit != 0);
        let angles: Vec<f64> = both.map(|(a, b)| degrees(gradient(a), gradient(b))).collect();
        assert!(angles.len() > 1000, "{} hits", angles.len());
        let [p50, p99] = percentiles(angles);
        println!("{name}: {p50:.3}° in the median, 99 % within {p99:.3}°");
        assert!(p99 < most, "{name}: {p99}");
    }
}
