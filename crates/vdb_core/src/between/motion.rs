//! The motion from one frame to the next, as seen from the time in between.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::lattice::{Field, Lattice};
use super::place::{Pair, union};
use super::register::registered;
use super::trace::traced;
use super::velocity::Flow;
use crate::tree::{LeafNode, Node};
use crate::{Error, Limits};

/// The parts of the velocities from which registration starts. Two frames of a fast jet are too far
/// apart for their velocities to describe what happens between them: there, rest is the better
/// start.
const PARTS: [f64; 3] = [0.0, 0.5, 1.0];
/// The stiffness of registration from rest, and from a motion along velocities.
const STIFFNESS: [f64; 2] = [1e-3, 1e-2];
/// The standard deviation, in nodes, of the window in which the agreement of frames is measured.
const WINDOW: f64 = 1.0;
/// The squared difference below which frames agree, for values of the order of 1.
const AGREEMENT: f32 = 1e-3;
/// The squared value below which two frames have nothing to agree on. That both are empty at the
/// ends of a path says less for it than the same smoke at the ends of another one.
const CONTENT: f32 = 1e-2;
/// How much more frames are believed that agree where they are than along a path: registration
/// always finds something, and sharp smoke in the wrong place is worse than a cross-fade.
const REST: f32 = 30.0;
/// Voxels around everything that moves.
const MARGIN: f64 = 4.0;
/// At most as many points of each frame are followed to find out how far the motion leads.
const SCOUTS: u64 = 4096;

/// Where the content of a node comes from.
pub(super) struct Path {
    /// From the node to its place in each frame, in voxels of the first frame.
    pub to: [Vec<Vec3>; 2],
    /// How far this path is to be believed, from 0 to 1; all paths together have 1.
    pub weight: Field,
}

/// Paths to both frames.
pub(super) struct Motion {
    /// `None` if nothing moves.
    pub lattice: Option<Lattice>,
    pub paths: Vec<Path>,
    /// The weight of what does not move.
    pub rest: Field,
}

impl Motion {
    /// No motion.
    pub fn none() -> Self {
        Self { lattice: None, paths: Vec::new(), rest: Vec::new() }
    }

    /// Along velocities.
    pub fn advected(
        pair: &Pair,
        flow: Option<&Flow>,
        t: f64,
        limits: &Limits,
    ) -> Result<Self, Error> {
        let (Some(flow), Some(bounds)) = (flow, bounds(pair, flow, t)) else {
            return Ok(Self::none());
        };
        let lattice = Lattice::over(bounds, limits)?;
        let to = traces(&lattice, Some((flow, 1.0)), t, None);
        let path = Path { to, weight: vec![1.0; lattice.len()] };
        Ok(Self { rest: vec![0.0; lattice.len()], lattice: Some(lattice), paths: vec![path] })
    }

    /// Along velocities and what registration finds.
    pub fn registered(
        pair: &Pair,
        flow: Option<&Flow>,
        t: f64,
        limits: &Limits,
    ) -> Result<Self, Error> {
        if [&pair.from, &pair.to].iter().any(|frame| frame.tree.active_voxel_count() == 0) {
            // An empty frame matches nothing.
            return Self::advected(pair, flow, t, limits);
        }
        let Some(bounds) = bounds(pair, flow, t) else { return Ok(Self::none()) };
        let lattice = Lattice::over(bounds, limits)?;
        let mut means = lattice.means(pair);
        normalize(&mut means);
        let mut paths = Vec::new();
        for part in PARTS {
            let flow = flow.filter(|_| part > 0.0).map(|flow| (flow, part));
            if flow.is_some() || part == 0.0 {
                paths.push(path(&lattice, &means, flow, t));
            }
        }
        let mut rest = belief(&lattice, &means);
        rest.par_iter_mut().for_each(|rest| *rest *= REST);
        share(&mut paths, &mut rest);
        Ok(Self { lattice: Some(lattice), paths, rest })
    }
}

/// The box that anything may be in at time `t`: `None` if there is nothing.
fn bounds(pair: &Pair, flow: Option<&Flow>, t: f64) -> Option<[DVec3; 2]> {
    let mut bounds = pair.bounds()?;
    if let Some(flow) = flow {
        let mut flow = flow.sampler(1.0);
        for (frame, time) in [(&pair.from, 0.0), (&pair.to, 1.0)] {
            let every = (frame.tree.active_voxel_count() / SCOUTS).max(1) as usize;
            let active = frame.tree.leaves().flat_map(|leaf| {
                let slots = leaf.value_mask().iter_on();
                slots.map(move |slot| leaf.origin() + LeafNode::<f32, 3>::slot_offset(slot))
            });
            for ijk in active.step_by(every) {
                let p = traced(&mut flow, frame.first(ijk.as_dvec3()), time, t);
                bounds = union(bounds, [p, p]);
            }
        }
    }
    Some([bounds[0] - MARGIN, bounds[1] + MARGIN])
}

/// Divides by a value of the order of the larger ones: three times the root of the mean square
/// where there is anything.
fn normalize(means: &mut [Field; 2]) {
    // One after another: the order of a sum in parallel, and so its last digits, would depend on
    // the number of cores.
    let (mut sum, mut nodes) = (0.0, 0.0);
    for value in means.iter().flatten().filter(|value| **value != 0.0) {
        sum += f64::from(*value).powi(2);
        nodes += 1.0;
    }
    let by = 3.0 * (sum / nodes).sqrt();
    if by > 0.0 {
        for value in means.iter_mut().flatten() {
            *value = (f64::from(*value) / by) as f32;
        }
    }
}

/// The paths of all nodes, moved at time `t` by `motion` in nodes of the lattice.
fn traces(
    lattice: &Lattice,
    flow: Option<(&Flow, f64)>,
    t: f64,
    motion: Option<&[Vec3]>,
) -> [Vec<Vec3>; 2] {
    [(0.0, -t), (1.0, 1.0 - t)].map(|(end, times)| {
        lattice.each(
            || flow.map(|(flow, part)| flow.sampler(part)),
            |flow, i| {
                let node = lattice.position(i);
                let moved = motion.map_or(Vec3::ZERO, |motion| motion[i]).as_dvec3();
                let p = node + times * lattice.spacing as f64 * moved;
                let p = flow.as_mut().map_or(p, |flow| traced(flow, p, t, end));
                (p - node).as_vec3()
            },
        )
    })
}

/// The means of both frames at the ends of paths.
fn ends(lattice: &Lattice, means: &[Field; 2], to: &[Vec<Vec3>; 2]) -> [Field; 2] {
    [0, 1].map(|frame: usize| {
        lattice.each(
            || (),
            |(), i| {
                let p = lattice.position(i) + to[frame][i].as_dvec3();
                lattice.interpolated([&means[frame]], lattice.local(p))[0]
            },
        )
    })
}

/// How far paths are to be believed at whose ends the frames have these values: by their squared
/// difference in a window, relative to their squared mean.
fn belief(lattice: &Lattice, [a, b]: &[Field; 2]) -> Field {
    let blurred = |value: fn(f32, f32) -> f32| {
        let values = a.par_iter().zip(b).map(|(a, b)| value(*a, *b)).collect();
        lattice.blurred(&values, WINDOW)
    };
    let differences = blurred(|a, b| (a - b) * (a - b));
    let content = blurred(|a, b| 0.25 * (a + b) * (a + b));
    lattice.each(|| (), |(), i| ((differences[i] + AGREEMENT) / (content[i] + CONTENT)).powi(-2))
}

/// The path found from a start along a part of the velocities.
fn path(lattice: &Lattice, means: &[Field; 2], flow: Option<(&Flow, f64)>, t: f64) -> Path {
    let [a, b] = ends(lattice, means, &traces(lattice, flow, t, None));
    let motion = registered(lattice, &a, &b, t, STIFFNESS[usize::from(flow.is_some())]);
    let to = traces(lattice, flow, t, Some(&motion));
    let weight = belief(lattice, &ends(lattice, means, &to));
    Path { to, weight }
}

/// Makes the weights of each node sum to 1.
fn share(paths: &mut [Path], rest: &mut Field) {
    for (i, rest) in rest.iter_mut().enumerate() {
        let total = paths.iter().map(|path| path.weight[i]).sum::<f32>() + *rest;
        *rest /= total;
        paths.iter_mut().for_each(|path| path.weight[i] /= total);
    }
}
