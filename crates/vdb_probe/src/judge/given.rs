//! Sources of test rays: random, hard, with ends, from far away almost along an axis, and through centres of cells.

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;
use vdb_core::pack::{PackedGrid, traverse};
use vdb_core::reference::Ray;
use vdb_core::synth::{Random, rays};
use vdb_core::tree::{CoordBox, Node, Vdb543};

use crate::probe::ProbeRay;

/// How far from a grid's own origin a ray may begin, in voxels: as far as cameras may be.
const FARTHEST: i32 = 1 << 30;

/// What rays are aimed at: one box around all there is, or, where that is mostly void, boxes around
/// some of it. In index space.
pub struct Targets(Vec<CoordBox>);

impl Targets {
    /// Of a grid with something to see.
    pub fn new(tree: &Vdb543<f32>, grid: &PackedGrid) -> Self {
        /// Voxels along an edge up to which a box is one target.
        const SMALL: u64 = 6000;
        /// Targets in the void.
        const SOME: usize = 256;
        let bounds = grid.occupied.expect("there is something to see");
        if bounds.dim().into_iter().all(|edge| edge <= SMALL) {
            let bbox = CoordBox { min: bounds.min + grid.base, max: bounds.max + grid.base };
            // The box of cells has whole leaves in it where tiles are boundary.
            let active = tree.active_bbox().and_then(|active| active.intersection(bbox));
            return Self(vec![active.unwrap_or(bbox)]);
        }
        let mut boxes: Vec<CoordBox> = tree.leaves().filter_map(Node::active_bbox).collect();
        boxes.extend(tree.active_values().filter(|v| v.log2_dim > 0).map(|v| v.bbox()));
        let step = boxes.len().div_ceil(SOME).max(1);
        // A ray cannot begin near what is farther away than that.
        let near = |b: &CoordBox| (b.min - grid.base).abs().max_element() < FARTHEST - 100_000;
        Self(boxes.into_iter().step_by(step).filter(near).collect())
    }

    /// Whether nothing is near enough to be aimed at.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Voxels from end to end of the first.
    pub fn reach(&self) -> f64 {
        DVec3::from_array(self.0[0].dim().map(|edge| edge as f64)).length()
    }

    /// One of them.
    pub fn pick(&self, random: &mut Random) -> CoordBox {
        self.0[random.below(self.0.len() as u64) as usize]
    }
}

/// A source of rays.
pub type Make = fn(&mut Random, &Targets, &PackedGrid) -> ProbeRay;

/// A ray of the shader from one in index space, unless it begins where none can.
fn made(grid: &PackedGrid, cell: IVec3, frac: Vec3, dir: Vec3) -> Option<ProbeRay> {
    let dir = rays::normalized(dir)?;
    let ray = traverse::Ray::from_index(grid, cell, frac, dir);
    let fits = ray.cell.checked_add(grid.base).is_some()
        && ray.cell.to_array().iter().all(|c| c.unsigned_abs() <= FARTHEST as u32);
    fits.then(|| ray.into())
}

/// The same from a point in index space, which may be beyond its ends.
fn made_from(grid: &PackedGrid, origin: DVec3, dir: Vec3) -> Option<ProbeRay> {
    let cell = origin.floor();
    if cell.abs().max_element() >= f64::from(i32::MAX - 1) {
        return None;
    }
    made(grid, cell.as_ivec3(), (origin - cell).as_vec3(), dir)
}

/// Tries again until there is a ray.
fn persist(mut attempt: impl FnMut() -> Option<ProbeRay>) -> ProbeRay {
    (0..10_000).find_map(|_| attempt()).expect("some ray fits")
}

/// From outside a target and sometimes from inside, through it.
pub fn plain(random: &mut Random, targets: &Targets, grid: &PackedGrid) -> ProbeRay {
    persist(|| {
        let target = targets.pick(random);
        plain_at(random, target, grid)
    })
}

fn plain_at(random: &mut Random, target: CoordBox, grid: &PackedGrid) -> Option<ProbeRay> {
    let center = (target.min.as_dvec3() + target.max.as_dvec3()) * 0.5;
    let radius = target.dim().map(|edge| edge as f64);
    let radius = DVec3::from_array(radius).length() * 0.5 + 1.0;
    let mut vector = || DVec3::from_array([0; 3].map(|_| random.range(-1.0, 1.0)));
    let origin = center + vector() * radius * 3.0;
    let dir = center + vector() * radius * 0.6 - origin;
    made_from(grid, origin, dir.as_vec3())
}

/// Through, along and beside faces, edges and corners of a target's voxels, every fourth from up to
/// 2²⁷ voxels away.
pub fn hard(random: &mut Random, targets: &Targets, grid: &PackedGrid) -> ProbeRay {
    persist(|| {
        let target = targets.pick(random);
        hard_at(random, target, grid)
    })
}

fn hard_at(random: &mut Random, target: CoordBox, grid: &PackedGrid) -> Option<ProbeRay> {
    let ray = match random.below(4) {
        0 => rays::far(random, target)?.0,
        _ => rays::adversarial(random, target),
    };
    made(grid, ray.cell, ray.frac, ray.dir)
}

/// Both kinds, beginning and ending at planes of the grid's box and of a target's cells, a step in the
/// last place beside them, and anywhere.
pub fn ended(random: &mut Random, targets: &Targets, grid: &PackedGrid) -> ProbeRay {
    persist(|| {
        let target = targets.pick(random);
        let mut ray = match random.below(4) {
            0 => plain_at(random, target, grid)?,
            _ => hard_at(random, target, grid)?,
        };
        let local = CoordBox { min: target.min - grid.base, max: target.max - grid.base };
        let whole = random.below(2) == 0;
        let bounds = grid.occupied.filter(|_| whole).unwrap_or(local);
        let of = Ray::new(ray.cell.into(), ray.frac.into(), ray.dir.into());
        let ended = rays::ended(random, of, bounds, 0.0);
        (ray.t_min, ray.t_max) = (ended.t_min, ended.t_max);
        Some(ray)
    })
}

/// From up to 2²⁸ voxels away along one axis, through a target; a ten millionth to a twentieth as fast
/// along the others.
pub fn creeping(random: &mut Random, targets: &Targets, grid: &PackedGrid) -> ProbeRay {
    persist(|| {
        let target = targets.pick(random);
        let swift = random.below(3) as usize;
        let mut sign = || if random.below(2) == 0 { 1.0 } else { -1.0 };
        let signs = DVec3::new(sign(), sign(), sign());
        let mut slow = || match random.below(8) {
            0 => 0.0,
            _ => 10.0_f64.powf(random.range(-7.0, -1.3)),
        };
        let mut dir = signs * DVec3::new(slow(), slow(), slow());
        dir[swift] = signs[swift] * random.range(1.0, 2.0);
        let dir: Vec3 = dir.as_vec3();
        let size = DVec3::from_array(target.dim().map(|edge| edge as f64));
        let at =
            target.min.as_dvec3() + size * DVec3::new(random.unit(), random.unit(), random.unit());
        let origin = at - 2.0_f64.powf(random.range(4.0, 26.9)) * dir.as_dvec3();
        made_from(grid, origin, dir)
    })
}

/// Through the centre of one of a target's cells, where samples of alternating sign, as in a checkerboard, give triple
/// roots; from up to 64 voxels away along each axis.
pub fn centred(random: &mut Random, targets: &Targets, grid: &PackedGrid) -> ProbeRay {
    persist(|| {
        let target = targets.pick(random);
        let mut along = |axis: usize| {
            f64::from(target.min[axis]) + random.below(target.dim()[axis]) as f64 + 0.5
        };
        let center = DVec3::new(along(0), along(1), along(2));
        let mut component = || random.range(-1.0, 1.0);
        let dir = DVec3::new(component(), component(), component());
        made_from(grid, center - dir * random.range(4.0, 64.0), dir.as_vec3())
    })
}

/// Rays with a sequence of random numbers of their own.
const CHUNK: usize = 4096;

/// Rays from a source, the same for the same seed.
pub fn chunks(
    seed: u64,
    first: usize,
    count: usize,
    make: &(dyn Fn(&mut Random) -> ProbeRay + Sync),
) -> Vec<ProbeRay> {
    let starts: Vec<usize> = (first..first + count).step_by(CHUNK).collect();
    let chunk = |start: usize| {
        let mut random = Random::new(seed ^ (start as u64).wrapping_mul(0xa24b_aed4_963e_e407));
        let rays = (start..(start + CHUNK).min(first + count)).map(|_| make(&mut random));
        rays.collect::<Vec<_>>()
    };
    starts.into_par_iter().flat_map_iter(chunk).collect()
}
