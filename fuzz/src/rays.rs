//! Rays and points, both ordinary and extreme.

use glam::{DAffine3, DMat4, DVec3, Vec2};
use vdb_core::Transform;
use vdb_core::pack::{PackKind, PackedGrid, traverse};
use vdb_core::query::{GridQuery, IndexHit, IndexRay};
use vdb_core::reference::{Blocky, Occupied, Ray};
use vdb_core::synth::{Random, rays};
use vdb_core::tree::{CoordBox, IVec3, Vdb543};
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};

use super::{CORNERS, FLOATS, pick};

/// Rays of each kind per grid.
const RAYS: usize = 6;

/// Queries a grid with rays and points, and views it through a camera.
pub(super) fn check(
    tree: &Vdb543<f32>,
    packed: &PackedGrid,
    transform: &Transform,
    random: &mut Random,
) {
    let query = GridQuery::new(tree, packed);
    let bounds = bounds(packed).unwrap_or(CoordBox::voxel(IVec3::ZERO));
    for _ in 0..RAYS {
        let point = self::point(random, bounds);
        let _ = (query.contains(point), query.nearest(point));
        let value = query.trilinear(point).expect("a tree has a value everywhere");
        assert!(!value.is_nan() || !point.is_finite(), "NaN at {point}");
        let ray =
            IndexRay { origin: point, dir: direction(random, point, bounds), t_max: end(random) };
        let enough = pick(random, &[0.0, 0.5, 1.0, 1e30, f64::INFINITY, -1.0, f64::NAN]);
        if let Some(hit) = query.first_hit(&ray, enough) {
            check_hit(&query, packed.kind, &ray, &hit);
        }
    }
    if let PackKind::Surface { iso } = packed.kind {
        judge(tree, &query, iso, bounds, random);
    }
    dda(packed, random);
    view(packed, transform, random);
}

/// Queries a grid without its tree.
pub(super) fn check_packed(packed: &PackedGrid, random: &mut Random) {
    let query = GridQuery::of_packed(packed);
    let bounds = bounds(packed).unwrap_or(CoordBox::voxel(IVec3::ZERO));
    for _ in 0..RAYS {
        let point = self::point(random, bounds);
        let _ = (query.contains(point), query.nearest(point), query.trilinear(point));
        let ray =
            IndexRay { origin: point, dir: direction(random, point, bounds), t_max: end(random) };
        let _ = query.first_hit(&ray, 0.5);
    }
}

/// The cells that can stop or dim a ray, in index space.
pub(super) fn bounds(packed: &PackedGrid) -> Option<CoordBox> {
    let own = packed.occupied?;
    let [min, max] = [own.min, own.max].map(|corner| corner.wrapping_add(packed.base));
    Some(CoordBox { min, max })
}

fn check_hit(query: &GridQuery, kind: PackKind, ray: &IndexRay, hit: &IndexHit) {
    assert!(hit.t >= 0.0 && hit.t <= ray.t_max && hit.t.is_finite(), "{hit:?} of {ray:?}");
    assert!(!hit.normal.is_nan(), "{hit:?} of {ray:?}");
    match kind {
        PackKind::Surface { iso } => {
            let value = query.nearest(hit.ijk.as_dvec3()).expect("a tree has a value everywhere");
            assert!(value < iso, "{value} is hit: {hit:?} of {ray:?}");
        }
        PackKind::Smooth { .. } | PackKind::Fog => assert!(!hit.begins_inside),
    }
}

/// Compares voxels with the exact tracer, for rays that neither has to round.
fn judge(tree: &Vdb543<f32>, query: &GridQuery, iso: f32, bounds: CoordBox, random: &mut Random) {
    let oracle = Blocky::new(tree, Occupied::BelowIso(iso));
    for _ in 0..RAYS {
        let units = f64::from(1 << 20);
        let origin = (inside(random, bounds) * units).round() / units;
        let target = inside(random, bounds) + random.unit();
        let mut dir = target - origin;
        if random.below(4) == 0 {
            dir[random.below(3) as usize] = 0.0;
        }
        let dir = (dir / dir.abs().max_element()).as_vec3();
        if !dir.is_finite() {
            continue;
        }
        let ray = Ray::from_f64(origin, dir.as_dvec3());
        if ray.at(0.0) != origin {
            continue;
        }
        let index_ray = IndexRay { origin, dir: dir.as_dvec3(), t_max: f64::INFINITY };
        let found = query.first_hit(&index_ray, 0.0).map(|hit| (hit.ijk, hit.begins_inside));
        let expected = oracle.first_voxel(&ray).map(|hit| (hit.ijk, hit.face.is_none()));
        let flushed = oracle.first_voxel(&ray.flushed()).map(|hit| (hit.ijk, hit.face.is_none()));
        assert!(found == expected || found == flushed, "{found:?} for {expected:?}: {ray:?}");
    }
}

/// Runs the traversal itself, which reads words as the shader does: none may be out of bounds.
pub(super) fn dda(packed: &PackedGrid, random: &mut Random) {
    let Some(bounds) = bounds(packed) else { return };
    for _ in 0..RAYS {
        if let Some(ray) = near(packed, bounds, random) {
            let _ = traverse::first_hit(packed, &ray);
            if packed.kind == PackKind::Fog {
                let depth = traverse::optical_length(packed, &ray);
                assert!(!depth.is_nan(), "{depth}: {ray:?}");
            }
        }
        let at = inside(random, bounds).as_ivec3().clamp(bounds.min, bounds.max);
        let cell = at.wrapping_sub(packed.base);
        let span = traverse::locate(packed, cell, random.below(8) as u32);
        let samples = !matches!(packed.kind, PackKind::Surface { .. });
        if samples && span.occupied() && !span.constant() {
            assert!(traverse::corners(packed, span, cell).iter().all(|value| value.is_finite()));
        }
    }
}

/// A ray in the form that shaders get, near the grid's box; `None` if the box is too large or too
/// far away.
pub(super) fn near(
    packed: &PackedGrid,
    bounds: CoordBox,
    random: &mut Random,
) -> Option<traverse::Ray> {
    let edge = bounds.dim().into_iter().max().unwrap_or(0);
    let far = |corner: IVec3| corner.to_array().iter().any(|c| c.unsigned_abs() >= 1 << 29);
    if edge >= 1 << 29 || far(bounds.min) || far(bounds.max) {
        return None;
    }
    let ray = rays::adversarial(random, bounds);
    Some(traverse::Ray::from_index(packed, ray.cell, ray.frac, rays::normalized(ray.dir)?))
}

/// Views the grid through a camera, where its transform places it.
fn view(packed: &PackedGrid, transform: &Transform, random: &mut Random) {
    let projection = DMat4::perspective_infinite_reverse_rh(0.8, 1.7, 0.1);
    let (Some(rays), Some(world)) = (ViewRays::new(projection), transform.linear()) else { return };
    let middle = bounds(packed).map_or(DVec3::ZERO, |bounds| inside(random, bounds));
    let eye = transform.world_from_index(middle) + pick(random, &[0.0, 1.0, 1e6, 1e300]);
    let _ = (transform.index_from_world(eye), transform.voxel_size());
    let view = DAffine3::from_translation(eye);
    let Ok(lattice) = LatticeRays::new(&rays, view, world, packed) else { return };
    let _ = lattice.is_coarse(1920);
    let gpu = GpuRays::from(&lattice);
    for ndc in [Vec2::ZERO, Vec2::new(0.3, -0.9), Vec2::ONE] {
        let ray = gpu.ray_through(ndc, rays.t_near as f32, rays.t_far as f32);
        let _ = traverse::first_hit(packed, &ray);
    }
}

/// A random point in a box.
fn inside(random: &mut Random, bounds: CoordBox) -> DVec3 {
    let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    low + (high - low) * DVec3::new(random.unit(), random.unit(), random.unit())
}

fn point(random: &mut Random, bounds: CoordBox) -> DVec3 {
    let special =
        [0.0, -0.5, 0.5, 1e9, -3e9, 2_147_483_647.5, 1e18, -1e300, 5e-324, f64::INFINITY, f64::NAN];
    let mut point = inside(random, bounds);
    match random.below(4) {
        0 => {
            for axis in 0..3 {
                if random.below(2) == 0 {
                    point[axis] = pick(random, &special);
                }
            }
        }
        1 => point = point.round() + pick(random, &[0.0, 0.5, -0.5, 1e-9]),
        2 => {
            let corner = DVec3::from_array([0; 3].map(|_| pick(random, &CORNERS).into()));
            point = corner + pick(random, &[0.0, 0.5, -1.0, 1e5]);
        }
        _ => {}
    }
    point
}

fn direction(random: &mut Random, from: DVec3, bounds: CoordBox) -> DVec3 {
    let special = [0.0, -0.0, 1.0, -1.0, 1e-300, -1e300, 5e-324, 1e-30, f64::INFINITY, f64::NAN];
    let aimed = inside(random, bounds) - from;
    let along = DVec3::from_array([0; 3].map(|_| pick(random, &special)));
    match random.below(4) {
        0 => along,
        1 => DVec3::AXES[random.below(3) as usize] * pick(random, &[1.0, -1.0, 1e-9]),
        2 => aimed * f64::from(pick(random, &FLOATS)),
        _ => aimed.normalize_or(DVec3::X),
    }
}

fn end(random: &mut Random) -> f64 {
    let special = [f64::INFINITY, f64::INFINITY, 0.0, -1.0, 1e-300, 1e300, f64::NAN, 1e9];
    if random.below(4) == 0 { 1000.0 * random.unit() } else { pick(random, &special) }
}
