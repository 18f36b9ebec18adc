//! Where a smooth surface is, and its normals.

use glam::{DVec3, Vec3};
use vdb_core::pack::PackKind;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::{Blocky, Occupied, Ray, Smooth, SurfaceHit, SurfaceVerdict, standard};
use vdb_core::synth::Random;
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::{Scene, Suite, hash, reproduced, send};
use crate::given::{self, Targets};
use crate::grids::{self, Named, Tree, Upper};
use crate::report::{Bound, Row};
use crate::tally::Tally;

pub const KIND: PackKind = PackKind::Smooth { iso: 0.0 };

/// Of a voxel: of 99.99 % of the positions, and of all.
pub const POSITION: Bound = Bound::Quantile(1e-3, 1e-2);
const FARTHEST_OFF: f64 = 1e-2;
/// Degrees that a normal may be off.
pub const NORMAL: f64 = 0.1;
/// A normal is held to the true ones so near the root, in voxels along the ray: where a gradient is
/// small or jumps from cell to cell, it turns by any angle within the error of a position. A place
/// so near one where the interpolant is within its noise of the iso-value counts as near-double.
const ROOT_REACH: f64 = 1e-3;
/// Voxels across the ray within which it touches another cell.
const TOUCHING: f64 = 1.0 / (1 << 20) as f64;
/// A dip past the surface, or a distance from it, that may be overlooked or taken for a root, in
/// units of the grid's background: a few roundings of an f32 interpolant.
const NOISE: f64 = 1e-6;
/// Voxels from the eye up to which positions are held to their bound as they are. Farther away, an
/// f32 has no room for it: 2⁻²⁰ of the way is taken off.
const NEAR: f64 = 1000.0;

/// Rays of each grid of the matrix in the short form, of either kind.
const RAYS: usize = 6_000;

/// What judges the answers about a grid.
pub struct Judge<'a> {
    scene: &'a Scene<'a>,
    roots: Smooth<'a, Upper>,
    gradients: Blocky<'a, Upper>,
    noise: f64,
}

impl<'a> Judge<'a> {
    pub fn new(scene: &'a Scene<'a>) -> Self {
        let tree = scene.tree;
        Self {
            scene,
            roots: Smooth::new(tree, scene.iso()),
            gradients: Blocky::new(tree, Occupied::Active),
            noise: NOISE * f64::from(tree.background().abs()),
        }
    }

    /// Holds an answer against the reference tracer.
    pub fn judge(&self, ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally) {
        let exact = self.scene.exact(ray);
        let speed = exact.dir.as_dvec3().length();
        let found = (hit.hit != 0).then_some(f64::from(hit.t));
        let granted = found.map_or(0.0, |t| match t * speed {
            way if way <= NEAR => 0.0,
            way => way * f64::from(T_ERROR),
        });
        let (verdict, root) =
            standard::judge(&self.roots, &exact, found, self.noise, 0.5 + granted);
        tally.met += u64::from(verdict != SurfaceVerdict::BothMiss);
        let is_near = || found.is_some_and(|t| self.is_near(&exact, t, ROOT_REACH + granted));
        let mut wrong = !self.scene.is_sound(hit);
        match verdict {
            SurfaceVerdict::BothMiss => {}
            SurfaceVerdict::NearDouble => tally.near_double += 1,
            SurfaceVerdict::Missed => wrong = true,
            SurfaceVerdict::Invented if is_near() => tally.near_double += 1,
            SurfaceVerdict::Invented => wrong = true,
            SurfaceVerdict::Off(off) if off - granted > ROOT_REACH && is_near() => {
                tally.near_double += 1;
            }
            SurfaceVerdict::Off(off) => {
                let error = (off - granted).max(0.0);
                tally.errors.add(error);
                wrong |= error > FARTHEST_OFF;
                if let Some(root) = root {
                    self.judge_normal(&exact, &root, hit, tally);
                }
            }
        }
        if wrong {
            tally.wrong += 1;
            tally.show(|| format!("{}: {verdict:?}, {hit:?}, not {root:?}", reproduced(ray)));
        }
    }

    /// Whether the interpolant is within its noise of the iso-value close to a place on a ray.
    fn is_near(&self, ray: &Ray, t: f64, reach: f64) -> bool {
        let start = f64::from(ray.t_min);
        let step = reach / 16.0 / ray.dir.as_dvec3().length();
        (-16..=16).any(|i| {
            self.roots.value(ray, (t + f64::from(i) * step).max(start)).abs() <= self.noise
        })
    }

    fn judge_normal(&self, ray: &Ray, root: &SurfaceHit, hit: &ProbeHit, tally: &mut Tally) {
        let Some(truth) = root.normal() else { return };
        let own = Vec3::from_array(hit.gradient).as_dvec3();
        let angle = angle(own, truth);
        if angle <= NORMAL {
            return tally.angles.add(angle);
        }
        let least = self.least_angle(ray, root.t, own).min(angle);
        tally.angles.add(least);
        if least <= NORMAL {
            tally.steep += 1;
        } else {
            tally.wrong_normals += 1;
            tally.show(|| {
                format!("normal off by {angle}°, {least}° nearby: {ray:?}, {hit:?}, not {root:?}")
            });
        }
    }

    /// The least angle, in degrees, between a gradient and the true ones near a place on a ray.
    fn least_angle(&self, ray: &Ray, t: f64, own: DVec3) -> f64 {
        let reach = ROOT_REACH / ray.dir.as_dvec3().length();
        let at = |t: f64| self.angle_at(ray, t, own);
        // The best of a few places, then ever closer around it: between the faces of cells, a
        // gradient turns steadily along a ray.
        let places = (-16..=16).map(|i| t + reach * f64::from(i) / 16.0);
        let best = places.min_by(|a, b| at(*a).total_cmp(&at(*b))).unwrap_or(t);
        let (mut low, mut high) = (best - reach / 16.0, best + reach / 16.0);
        for _ in 0..40 {
            let third = (high - low) / 3.0;
            let keep_low = at(low + third) <= at(high - third);
            (low, high) = if keep_low { (low, high - third) } else { (low + third, high) };
        }
        at(best).min(at((low + high) / 2.0))
    }

    /// The angle between a gradient and the true one at a place on a ray, or in a cell that touches
    /// it, in degrees.
    fn angle_at(&self, ray: &Ray, t: f64, own: DVec3) -> f64 {
        let point = ray.at(t);
        let beside = (0..8).map(|i| {
            let side = DVec3::from_array([0, 1, 2].map(|axis| f64::from(2 * (i >> axis & 1) - 1)));
            angle(own, self.gradients.gradient(point + side * TOUCHING))
        });
        beside.fold(f64::INFINITY, f64::min)
    }
}

/// Between two directions, in degrees; infinite where one is none.
fn angle(a: DVec3, b: DVec3) -> f64 {
    // Exact for small angles, where the cosine is not.
    let angle = a.cross(b).length().atan2(a.dot(b)).to_degrees();
    if a == DVec3::ZERO || b == DVec3::ZERO || !angle.is_finite() { f64::INFINITY } else { angle }
}

/// The two rows of a case: positions, and normals.
pub fn add_rows(suite: &mut Suite, group: &'static str, case: &str, tally: &Tally) {
    let mut note = Vec::new();
    if tally.near_double > 0 {
        note.push(format!("{} near-double", tally.near_double));
    }
    let row = Row::new(group, case, "voxels", POSITION, tally).note(note.join(", "));
    suite.report.add(row, tally);
    let mut row = Row::of_errors(group, format!("{case}, normals"), "degrees", Bound::Max(NORMAL), &tally.angles);
    row.wrong = tally.wrong_normals;
    if tally.steep > 0 {
        row = row.note(format!("{} within 1e-3 voxel", tally.steep));
    }
    suite.report.add(row.again(), tally);
}

/// All rows of given rays.
pub fn run(suite: &mut Suite) {
    let offsets = grids::offsets().map(|(name, tree)| (format!("offset {name}"), tree));
    let named = grids::crossings().into_iter().map(|Named { name, make }| (name, make()));
    for (name, tree) in named.chain(offsets) {
        if suite.wants(&format!("smooth: {name}")) {
            given_rays(suite, &name, &tree);
        }
    }
}

fn given_rays(suite: &mut Suite, name: &str, tree: &Tree) {
    let scene = Scene::new(suite.gpu, tree, KIND).expect("there is a surface");
    let targets = Targets::new(tree, &scene.grid);
    let judge = Judge::new(&scene);
    for (kind, make) in [("random", given::plain as given::Make), ("hard", given::hard)] {
        let make = |random: &mut Random| make(random, &targets, &scene.grid);
        let seed = hash(name) ^ hash(kind);
        let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| judge.judge(ray, hit, tally);
        let tally = send(suite, &scene, seed, RAYS * suite.times, &make, &judge);
        add_rows(suite, "smooth", &format!("{name}, {kind}"), &tally);
    }
}
