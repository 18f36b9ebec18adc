//! Where a smooth surface is, and its normals.

use glam::{DVec3, Vec3};
use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::standard::{self, Upper};
use vdb_core::reference::{Blocky, Occupied, Ray, Smooth, SurfaceHit, SurfaceVerdict};

use super::scene::{Scene, reproduced};
use super::tally::Tally;
use crate::probe::{ProbeHit, ProbeRay};

/// How far, in voxels, 99.99 % of positions may be off.
pub const USUALLY_OFF: f64 = 1e-3;
/// How far, in voxels, any position may be off.
pub const FARTHEST_OFF: f64 = 1e-2;
/// How far, in degrees, a normal may be off.
pub const NORMAL: f64 = 0.1;
/// A normal must match a true one within this distance of the root, in voxels along the ray: where a
/// gradient is small or jumps from cell to cell, it turns by any angle within the error of a
/// position. A place this near to one where the interpolant is within its noise of the iso-value
/// counts as near-double.
const ROOT_REACH: f64 = 1e-3;
/// Voxels across the ray within which it touches another cell.
const TOUCHING: f64 = 1.0 / (1 << 20) as f64;
/// A dip past the surface, or a distance from it, that may be overlooked or taken for a root, in
/// parts of the greatest distance of a corner of its cell from the iso-value: a few roundings of an f32
/// interpolant.
const NOISE: f64 = 1e-6;
/// The distance from the eye, in voxels, up to which positions are held to their bound as it is.
/// Farther away, an f32 cannot be that precise: 2⁻¹⁹ of the distance is allowed in addition.
const NEAR: f64 = 1000.0;

/// The error allowed in addition at a distance from the eye, both in voxels.
fn allowance(distance: f64) -> f64 {
    if distance <= NEAR { 0.0 } else { distance * f64::from(T_ERROR) }
}

/// What judges the answers about a grid.
pub struct Judge<'a> {
    scene: &'a Scene<'a>,
    roots: Smooth<'a, Upper>,
    gradients: Blocky<'a, Upper>,
}

impl<'a> Judge<'a> {
    /// The judge of a grid.
    pub fn new(scene: &'a Scene<'a>) -> Self {
        let tree = scene.tree;
        Self {
            scene,
            roots: Smooth::new(tree, scene.iso()),
            gradients: Blocky::new(tree, Occupied::Active),
        }
    }

    /// Holds an answer against the reference tracer.
    pub fn judge(&self, ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally) {
        let exact = self.scene.exact(ray);
        let speed = exact.dir.as_dvec3().length();
        let found = (hit.hit != 0).then_some(f64::from(hit.t));
        let granted = found.map_or(0.0, |t| allowance(t * speed));
        let reach = ROOT_REACH + granted;
        let (verdict, root) = standard::judge(&self.roots, &exact, found, NOISE, 0.5 + granted);
        let own = Vec3::from_array(hit.gradient).as_dvec3();
        let is_near = || found.is_some_and(|t| self.is_near(&exact, t, reach, own));
        let is_double = || root.is_some_and(|root| root.depth <= NOISE * root.largest);
        tally.met += u64::from(verdict != SurfaceVerdict::BothMiss);
        let mut wrong = !self.scene.is_sound(hit);
        match (verdict, root) {
            (SurfaceVerdict::BothMiss, _) => {}
            (SurfaceVerdict::NearDouble, _) => tally.near_double += 1,
            // Nobody can say on which side the ray began, or is between the root and the one that was found.
            (SurfaceVerdict::Missed, Some(root))
                if self.is_near_between(&exact, f64::from(exact.begin()), root.t)
                    || found.is_some_and(|t| self.is_near_between(&exact, root.t, t)) =>
            {
                tally.near_double += 1;
            }
            (SurfaceVerdict::Invented, _) if is_near() => tally.near_double += 1,
            (SurfaceVerdict::Missed | SurfaceVerdict::Invented, root)
                if self.is_at_end(&exact, found, root.map(|root| root.t), granted) =>
            {
                tally.at_end += 1;
            }
            (SurfaceVerdict::Missed | SurfaceVerdict::Invented, _) => wrong = true,
            (SurfaceVerdict::Off(off), root) => {
                let error = (off - granted).max(0.0);
                let angle = root.and_then(|root| self.normal_error(&exact, &root, own));
                let doubtful = error > ROOT_REACH || angle.is_some_and(|(angle, _)| angle > NORMAL);
                if doubtful && (is_double() || is_near()) {
                    tally.near_double += 1;
                } else {
                    tally.errors.add(error);
                    wrong |= error > FARTHEST_OFF;
                    if let Some((angle, is_steep)) = angle {
                        tally.angles.add(angle);
                        tally.steep += u64::from(is_steep);
                        tally.wrong_normals += u64::from(angle > NORMAL);
                        wrong |= angle > NORMAL;
                    }
                }
            }
        }
        if wrong {
            tally.wrong += 1;
            tally.show(|| format!("{}: {verdict:?}, {hit:?}, not {root:?}", reproduced(ray)));
        }
    }

    /// Whether an answer is right for the same ray that begins, or ends, a little sooner or later: a root
    /// that is as close to an end as a position is good may be met or not.
    fn is_at_end(&self, ray: &Ray, found: Option<f64>, root: Option<f64>, granted: f64) -> bool {
        let speed = ray.dir.as_dvec3().length();
        let far = found.into_iter().chain(root).fold(0.0, f64::max) * speed;
        let reach = (ROOT_REACH + allowance(far)) / speed;
        let moved = |t: f32, by: f64| (f64::from(t) + by * reach) as f32;
        let spans = [-1.0, 0.0, 1.0].into_iter().flat_map(|begin| {
            [-1.0, 0.0, 1.0].map(|end| (moved(ray.begin(), begin), moved(ray.t_max, end)))
        });
        spans.into_iter().any(|(t_min, t_max)| {
            let ray = ray.with_span(t_min, t_max);
            let judged = standard::judge(&self.roots, &ray, found, NOISE, 0.5 + granted);
            match judged.0 {
                SurfaceVerdict::BothMiss => true,
                SurfaceVerdict::Off(off) => off <= FARTHEST_OFF + granted,
                _ => false,
            }
        })
    }

    /// How far a normal is off, in degrees, and whether it is right only because one close by is
    /// granted. `None`, where there is none.
    fn normal_error(&self, ray: &Ray, root: &SurfaceHit, own: DVec3) -> Option<(f64, bool)> {
        let angle = angle(own, root.normal()?);
        let is_steep = angle > NORMAL;
        let least = if is_steep {
            self.least_angle(ray, root.t, own, ROOT_REACH).min(angle)
        } else {
            angle
        };
        Some((least, is_steep && least <= NORMAL))
    }

    /// Whether close to a place on a ray the interpolant comes within its noise of the iso-value,
    /// with a gradient like the one that was found.
    fn is_near(&self, ray: &Ray, t: f64, reach: f64, own: DVec3) -> bool {
        let (start, speed) = (f64::from(ray.begin()), ray.dir.as_dvec3().length());
        let steps = (reach * 256.0).ceil().max(64.0) as i32;
        let step = reach / f64::from(steps) / speed;
        let at = |i: i32| (t + f64::from(i) * step).max(start);
        let off = |t: f64| self.over_noise(ray, t);
        // Each place that is closer than those beside it, and the closest around it.
        (-steps..=steps).any(|i| {
            let (before, here, after) = (at(i - 1), at(i), at(i + 1));
            let is_within =
                |t: f64| off(t) <= 1.0 && self.least_angle(ray, t, own, FARTHEST_OFF) <= NORMAL;
            let is_least = off(here) <= off(before) && off(here) <= off(after);
            is_within(here) || is_least && is_within(least(before, after, off))
        })
    }

    /// Whether the interpolant is within its noise all the way between two places, as far as a sample every 256th of it
    /// tells.
    fn is_near_between(&self, ray: &Ray, first: f64, last: f64) -> bool {
        (0..256).all(|i| self.over_noise(ray, first + (last - first) * f64::from(i) / 256.0) <= 1.0)
    }

    /// The distance of the interpolant from the iso-value, in parts of its noise.
    fn over_noise(&self, ray: &Ray, t: f64) -> f64 {
        let (value, largest) = self.roots.value(ray, t);
        value.abs() / (NOISE * largest).max(f64::MIN_POSITIVE)
    }

    /// The smallest angle, in degrees, between a gradient and any true gradient within `reach` voxels
    /// of a place on a ray.
    fn least_angle(&self, ray: &Ray, t: f64, own: DVec3, reach: f64) -> f64 {
        let reach = reach / ray.dir.as_dvec3().length();
        // One that changes the value by less than its noise has no direction.
        let least_length = NOISE * self.roots.value(ray, t).1 / ROOT_REACH;
        let at = |t: f64| self.angle_at(ray, t, own, least_length);
        // The best of a few places, then ever closer around it: between the faces of cells, a
        // gradient turns steadily along a ray.
        let places = (-16..=16).map(|i| t + reach * f64::from(i) / 16.0);
        // And where it comes to another cell, which it may touch only there.
        let (point, dir) = (ray.at(t), ray.dir.as_dvec3());
        let faces = (0..3).map(|axis| t + (point[axis].round() - point[axis]) / dir[axis]);
        let faces = faces.filter(|place| (place - t).abs() <= reach);
        let places = places.chain(faces);
        let best = places.min_by(|a, b| at(*a).total_cmp(&at(*b))).unwrap_or(t);
        at(best).min(at(least(best - reach / 16.0, best + reach / 16.0, at)))
    }

    /// The angle between a gradient and the true one at a place on a ray, or in a cell that touches
    /// it, in degrees.
    fn angle_at(&self, ray: &Ray, t: f64, own: DVec3, least_length: f64) -> f64 {
        let point = ray.at(t);
        let beside = (0..8).map(|i| {
            let side = DVec3::from_array([0, 1, 2].map(|axis| f64::from(2 * (i >> axis & 1) - 1)));
            let truth = self.gradients.gradient(point, point + side * TOUCHING);
            let none = own.length().max(truth.length()) <= least_length;
            if none { 0.0 } else { angle(own, truth) }
        });
        beside.fold(f64::INFINITY, f64::min)
    }
}

/// Where a function with one minimum between two places is least.
fn least(low: f64, high: f64, of: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (low, high);
    for _ in 0..40 {
        let third = (high - low) / 3.0;
        let keep_low = of(low + third) <= of(high - third);
        (low, high) = if keep_low { (low, high - third) } else { (low + third, high) };
    }
    (low + high) / 2.0
}

/// Between two directions, in degrees; infinite where one is none.
fn angle(a: DVec3, b: DVec3) -> f64 {
    // Exact for small angles, where the cosine is not.
    let angle = a.cross(b).length().atan2(a.dot(b)).to_degrees();
    if a == DVec3::ZERO || b == DVec3::ZERO || !angle.is_finite() { f64::INFINITY } else { angle }
}
