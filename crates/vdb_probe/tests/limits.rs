//! Rays at the limits of the conventions in `docs/reference/accuracy.md`, in the shaders.

use glam::{DVec3, IVec3, Vec3};
use vdb_core::pack::{PackKind, PackedGrid, traverse};
use vdb_core::query::{GridQuery, IndexRay};
use vdb_core::reference::{Blocky, Occupied, Ray, first_root};
use vdb_core::synth::{Random, fog};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeHit, ProbeKind, ProbeRay};

const SURFACE: PackKind = PackKind::Surface { iso: 0.0 };
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

fn cube(min: i32, max: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) }
}

/// Solid voxels in a background of 1.
fn solid(bbox: CoordBox) -> Vdb543<f32> {
    solid_of(bbox, -1.0)
}

/// Voxels of a value in a background of 1.
fn solid_of(bbox: CoordBox, value: f32) -> Vdb543<f32> {
    let mut tree = Vdb543::new(1.0);
    for x in bbox.min.x..=bbox.max.x {
        for y in bbox.min.y..=bbox.max.y {
            (bbox.min.z..=bbox.max.z).for_each(|z| tree.set(IVec3::new(x, y, z), value));
        }
    }
    tree
}

fn send(gpu: &Gpu, grid: &PackedGrid, rays: &[traverse::Ray], defs: &[&str]) -> Vec<ProbeHit> {
    let kind = match grid.kind {
        PackKind::Surface { .. } => ProbeKind::Voxels,
        PackKind::Smooth { .. } => ProbeKind::Smooth,
        PackKind::Fog => ProbeKind::Fog,
    };
    let rays: Vec<ProbeRay> = rays.iter().map(|&ray| ray.into()).collect();
    Probe::with_defs(gpu, kind, defs).send(&GpuGrid::new(gpu, grid), &rays)
}

fn ray(grid: &PackedGrid, cell: IVec3, dir: Vec3, span: (f32, f32)) -> traverse::Ray {
    let ray = traverse::Ray::from_index(grid, cell, Vec3::splat(0.25), dir);
    traverse::Ray { t_min: span.0, t_max: span.1, ..ray }
}

#[test]
fn directions_and_ends_at_their_limits() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = solid(cube(-4, 5));
    let grid = PackedGrid::new(&tree, SURFACE).unwrap();
    let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
    let (nan, endless) = (f32::NAN, f32::INFINITY);
    let mut rays = Vec::new();
    for size in [-40, -31, -30, -29, 0, 29, 30, 31, 60] {
        let dir = Vec3::new(-1.0, 0.01, 0.0) * 2.0_f32.powi(size);
        rays.push(ray(&grid, IVec3::new(50, 0, 0), dir, (0.0, endless)));
    }
    for dir in [Vec3::ZERO, Vec3::splat(1e-40)] {
        rays.push(ray(&grid, IVec3::ZERO, dir, (0.0, endless)));
    }
    for t_min in [0.0, -0.0, -1e-45, 1e-45, -7.0, 3.0, 100.0, 1e38, nan, endless, -endless] {
        for t_max in [0.0, -0.0, -1e-45, 1e-45, -7.0, 2.0, 3.0, 1e38, nan, endless, -endless] {
            for from in [0, 5, 7] {
                rays.push(ray(&grid, IVec3::new(from, 0, 0), Vec3::NEG_X, (t_min, t_max)));
            }
        }
    }
    let hits = send(&gpu, &grid, &rays, &[]);
    for (ray, hit) in rays.iter().zip(hits) {
        let cell = ray.cell + grid.base;
        let exact = Ray::new(cell, ray.frac - 0.5, ray.dir).with_span(ray.t_min, ray.t_max);
        let expected = oracle.first_voxel(&exact.flushed());
        let expected = expected.map(|hit| (hit.ijk, hit.face.map_or(3, |face| face.axis.into())));
        let found = (hit.hit != 0).then(|| (IVec3::from_array(hit.cell) + grid.base, hit.axis));
        assert_eq!(found, expected, "{ray:?}");
        let on_cpu = traverse::first_hit(&grid, ray).map(|hit| (hit.cell + grid.base, hit.axis));
        assert_eq!(on_cpu, expected, "{ray:?}");
    }
}

/// Along each axis, beginning where the ray comes into the box, a step in the last place beside that, and
/// a cell before it and behind it: nothing that is ahead is lost.
#[test]
fn no_ray_is_lost_that_begins_at_the_box() {
    let Some(gpu) = Gpu::find() else { return };
    // No face is a border of leaves: a boundary tile there has one density when it is sampled.
    let (surface, dense) = (solid(cube(-37, 37)), fog::block(cube(-37, 37), 0.5));
    for (tree, kind, defs) in [
        (&surface, SURFACE, &[][..]),
        (&surface, SMOOTH, &[]),
        (&dense, PackKind::Fog, &[]),
        (&dense, PackKind::Fog, &["STEP=1"]),
    ] {
        let grid = PackedGrid::new(tree, kind).unwrap();
        let bounds = grid.occupied.unwrap();
        let mut rays = Vec::new();
        let mut ends = Vec::new();
        for axis in 0..3 {
            for sign in [1.0_f32, -1.0] {
                for (away, speed) in [(77, 0.1_f32), (1_000_003, 0.3), (30_001, 1.0), (5, 3.0)] {
                    let mut dir = Vec3::splat(1e-9);
                    dir[axis] = sign * speed;
                    let mut cell = IVec3::splat(3);
                    cell[axis] = (sign * -(away + 41) as f32) as i32;
                    let ray = ray(&grid, cell, dir, (0.0, f32::INFINITY));
                    let plane = if sign > 0.0 { bounds.min } else { bounds.max + 1 }[axis];
                    let way = f64::from(plane - ray.cell[axis]) - f64::from(ray.frac[axis]);
                    let t = way / f64::from(dir[axis]);
                    for cells in [-1.0, 0.0, 0.25] {
                        let t_min = (t + cells / f64::from(speed)) as f32;
                        for t_min in [t_min.next_down(), t_min, t_min.next_up()] {
                            rays.push(traverse::Ray { t_min, ..ray });
                            // Where that is, along the axis, from the middle of the grid on.
                            let way = f64::from(t_min) * f64::from(dir[axis]);
                            let cell = f64::from(ray.cell[axis] + grid.base[axis]);
                            ends.push((cell + f64::from(ray.frac[axis]) + way) * f64::from(sign));
                        }
                    }
                }
            }
        }
        for ((ray, hit), begin) in rays.iter().zip(send(&gpu, &grid, &rays, defs)).zip(ends) {
            let speed = ray.dir.abs().max_element();
            if kind == PackKind::Fog {
                // 74 voxels between the outermost samples, and half of one on either side.
                let all = 0.5 * 75.0;
                let depth = f64::from(hit.optical_length) * f64::from(speed);
                // Of a sample each quarter of a voxel, one may stand before the beginning.
                let off = if defs.is_empty() { 1e-3 } else { 0.13 };
                let rest = all - 0.25 * (begin + 38.0).clamp(0.0, 1.0).powi(2);
                assert!((depth - rest).abs() < off, "{depth} for {rest}, {defs:?}: {ray:?}");
            } else {
                assert_eq!(hit.hit, 1, "{kind:?} {ray:?}");
            }
        }
    }
}

#[test]
fn the_greatest_optical_depth_is_finite() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = fog::block(cube(-60, 60), f32::INFINITY);
    let grid = PackedGrid::new(&tree, PackKind::Fog).unwrap();
    let slowest = 2.0_f32.powi(-29);
    let rays = [Vec3::X, Vec3::new(-0.3, 1.0, 0.1)]
        .map(|dir| ray(&grid, IVec3::new(2, 1, 0), dir * slowest, (0.0, f32::INFINITY)));
    for defs in [&[][..], &["STEP=4"]] {
        for hit in send(&gpu, &grid, &rays, defs) {
            assert_eq!(hit.optical_length, 3e38, "{defs:?}");
        }
    }
    assert_eq!(traverse::optical_length(&grid, &rays[0]), 3e38);
}

/// A surface in the faces of cells, behind which values are hardly below the iso-value: the next cell has no surface, so
/// the sign in the face decides.
#[test]
fn surfaces_in_faces_of_cells_have_no_holes() {
    let Some(gpu) = Gpu::find() else { return };
    let grid = PackedGrid::new(&solid_of(cube(-9, 9), -1e-9), SMOOTH).unwrap();
    let mut random = Random::new(7);
    let mut rays = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            for _ in 0..500 {
                let mut dir = Vec3::from_array([0; 3].map(|_| random.range(-0.1, 0.1) as f32));
                dir[axis] = sign * random.range(0.3, 3.0) as f32;
                let mut cell = IVec3::ZERO;
                cell[axis] = -20 * sign as i32;
                rays.push((axis, sign, ray(&grid, cell, dir, (0.0, f32::INFINITY))));
            }
        }
    }
    let all: Vec<_> = rays.iter().map(|(_, _, ray)| *ray).collect();
    for ((axis, sign, ray), hit) in rays.into_iter().zip(send(&gpu, &grid, &all, &[])) {
        assert_eq!(hit.hit, 1, "{ray:?}");
        let at = (ray.cell + grid.base)[axis] as f32 + ray.frac[axis] + hit.t * ray.dir[axis];
        assert!((at + sign * 9.0).abs() < 1e-3, "{at}: {ray:?}");
    }
}

/// A corner that is infinite or NaN: in the shaders and on the CPU, neither a hole nor a surface
/// that the reference tracer does not see.
#[test]
fn odd_samples_beside_a_surface_are_clamped_alike() {
    let Some(gpu) = Gpu::find() else { return };
    let iso = 0.5;
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN] {
        let mut tree = fog::ramp(cube(-10, 10), DVec3::X, 0.0);
        // Without it, the surface lies at x = 1/2.
        tree.set(IVec3::ONE, odd);
        let grid = PackedGrid::new(&tree, PackKind::Smooth { iso }).unwrap();
        let (cell, frac) = (IVec3::new(-8, 0, 0), Vec3::splat(0.5));
        let exact = Ray::new(cell, frac, Vec3::X).with_span(0.0, 15.0);
        let expected = first_root(&tree, iso, &exact).expect("a change of sign").t;
        let local = traverse::Ray::from_index(&grid, cell, frac, Vec3::X);
        for hit in send(&gpu, &grid, &[traverse::Ray { t_max: 15.0, ..local }], &[]) {
            assert_eq!(hit.hit, 1, "{odd}");
            assert!((f64::from(hit.t) - expected).abs() < 1e-3, "{odd}: {hit:?}, not {expected}");
            assert!(hit.gradient.iter().all(|part| part.is_finite()), "{odd}: {hit:?}");
        }
        let ray = IndexRay { origin: DVec3::new(-7.5, 0.5, 0.5), dir: DVec3::X, t_max: 15.0 };
        let on_cpu = GridQuery::new(&tree, &grid).first_hit(&ray, 0.0).map(|hit| hit.t);
        assert!(on_cpu.is_some_and(|t| (t - expected).abs() < 1e-3), "{odd}: {on_cpu:?}");
    }
}

/// From one end of index space to the other: every traversal ends, and meets what the one on the CPU meets.
#[test]
fn through_all_of_index_space() {
    let Some(gpu) = Gpu::find() else { return };
    let (low, high) = (IVec3::splat(i32::MIN), IVec3::splat(i32::MAX));
    let ends = [low, high, IVec3::new(i32::MAX, i32::MIN, i32::MIN)];
    let tree_of = |value: f32, background: f32| {
        let mut tree = Vdb543::new(background);
        ends.iter().for_each(|&end| tree.set(end, value));
        tree
    };
    let rays: Vec<traverse::Ray> = [low, high, low + 1, high - 1, IVec3::ZERO]
        .into_iter()
        .flat_map(|cell| {
            let dirs = [Vec3::ONE, Vec3::NEG_ONE, Vec3::X, Vec3::NEG_Y, Vec3::new(1.0, 1e-9, 0.5)];
            dirs.into_iter().flat_map(move |dir| {
                [0.0, 1.0, 4e9].map(|t_min| {
                    let frac = Vec3::splat(0.5);
                    traverse::Ray { cell, frac, dir, t_min, t_max: f32::INFINITY }
                })
            })
        })
        .collect();
    let grid = PackedGrid::new(&tree_of(-1.0, 1.0), SURFACE).unwrap();
    for (ray, hit) in rays.iter().zip(send(&gpu, &grid, &rays, &[])) {
        let found = (hit.hit != 0).then(|| (IVec3::from_array(hit.cell), hit.axis));
        let on_cpu = traverse::first_hit(&grid, ray).map(|hit| (hit.cell, hit.axis));
        assert_eq!(found, on_cpu, "{ray:?}");
        assert!(hit.steps < 10_000, "{} steps: {ray:?}", hit.steps);
    }
    let grid = PackedGrid::new(&tree_of(1.0, 0.0), PackKind::Fog).unwrap();
    for (ray, hit) in rays.iter().zip(send(&gpu, &grid, &rays, &[])) {
        let on_cpu = traverse::optical_length(&grid, ray);
        assert!((hit.optical_length - on_cpu).abs() < 1e-3, "{hit:?}, not {on_cpu}: {ray:?}");
    }
    for hit in send(&gpu, &grid, &rays, &["STEP=1"]) {
        assert!(hit.optical_length < 10.0 && hit.steps < 10_000, "{hit:?}");
    }
}

/// Grids on either side of the width from which shaders look out for the end of the index space, with rays
/// that skip over all of it.
#[test]
fn rays_cross_the_widest_grids() {
    let Some(gpu) = Gpu::find() else { return };
    let mut are_wide = Vec::new();
    for bits in [20, 22, 23, 32] {
        let half = 1_i64 << (bits - 1);
        let ends = [-half as i32, (half - 1) as i32];
        let mut tree = Vdb543::new(1.0);
        for i in 0..8 {
            tree.set(
                IVec3::from_array([4, 2, 1].map(|axis| ends[usize::from(i & axis != 0)])),
                -1.0,
            );
        }
        let grid = PackedGrid::new(&tree, SURFACE).unwrap();
        are_wide.push(grid.is_wide());
        let mut rays = Vec::new();
        for from in [i32::MIN, ends[0], -77, 3, ends[1], i32::MAX] {
            for (axis, sign) in [0, 1, 2].into_iter().flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
                for other in ends {
                    let mut cell = IVec3::splat(other);
                    cell[axis] = from;
                    let mut dir = Vec3::ZERO;
                    dir[axis] = sign;
                    rays.push(ray(&grid, cell, dir, (0.0, f32::INFINITY)));
                    // Past the voxels, through nothing.
                    cell[(axis + 1) % 3] ^= 1 << 12;
                    rays.push(ray(&grid, cell, dir, (0.0, f32::INFINITY)));
                    dir[(axis + 1) % 3] = 1e-3;
                    rays.push(ray(&grid, cell, dir, (0.0, f32::INFINITY)));
                }
            }
        }
        let mut met = 0;
        for (ray, hit) in rays.iter().zip(send(&gpu, &grid, &rays, &[])) {
            let expected =
                traverse::first_hit(&grid, ray).map(|hit| (hit.cell.to_array(), hit.axis));
            met += usize::from(expected.is_some());
            assert_eq!(
                (hit.hit != 0).then_some((hit.cell, hit.axis)),
                expected,
                "2^{bits}: {ray:?}"
            );
        }
        assert!(met > rays.len() / 9, "2^{bits}: {met} of {} rays meet a voxel", rays.len());
    }
    assert_eq!(are_wide, [false, false, true, true]);
}
