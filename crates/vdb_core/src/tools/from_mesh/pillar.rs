//! Pillars of 128² voxels in x and y: what is built at once.

use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::band::Band;
use super::close::Mesh;
use super::crossings::{Crossings, EDGE, LOG2_EDGE};
use super::leaf;
use super::pieces::pieces;
use super::triangle::Triangle;
use crate::tools::nodes::{Leaf, Lower};
use crate::tree::grow::{Built, internal};
use crate::tree::{IVec3, Node};
use crate::work::{Stop, Work};

/// The triangles whose band reaches the voxels from (x, y) to (x, y) + 127.
pub(super) struct Pillar {
    x: i32,
    y: i32,
    triangles: Vec<u32>,
}

/// The work done so far, in triangles of pillars.
pub(super) struct Progress<'a> {
    pub work: &'a Work<'a>,
    pub done: AtomicU64,
    /// Leaves that a thread builds without sharing them. A thread that waits for others takes up
    /// another node meanwhile, and the triangles of each take memory: where there are enough nodes
    /// for all threads, nothing is shared within them.
    pub leaves_at_once: usize,
}

impl Progress<'_> {
    fn add(&self, steps: u64) -> Result<(), Stop> {
        let before = self.done.fetch_add(steps, Ordering::Relaxed);
        self.work.report(before + steps)
    }
}

/// The leaves that a thread builds without sharing them, given the number of pillars.
pub(super) fn leaves_at_once(pillars: usize) -> usize {
    if pillars >= 4 * rayon::current_num_threads() { Lower::SIZE } else { 16 }
}

impl Pillar {
    /// The steps of building it.
    pub(super) fn steps(&self) -> u64 {
        self.triangles.len() as u64
    }
}

/// All pillars with triangles, in order.
pub(super) fn sorted(mesh: &Mesh, half_width: f64) -> Vec<Pillar> {
    let all = [DVec3::NEG_INFINITY, DVec3::INFINITY];
    let cells_of = |triangle: u32| {
        let mut cells = Vec::new();
        let corners = mesh.corners(triangle as usize);
        pieces(corners, f64::from(EDGE), half_width, all, &mut |low, high| {
            for x in cells_between(low.x - half_width, high.x + half_width, LOG2_EDGE) {
                for y in cells_between(low.y - half_width, high.y + half_width, LOG2_EDGE) {
                    cells.push((x, y, triangle));
                }
            }
        });
        if cells.len() > 1 {
            cells.sort_unstable();
            cells.dedup();
        }
        cells
    };
    let mut cells: Vec<(i32, i32, u32)> =
        (0..mesh.triangles.len() as u32).into_par_iter().flat_map_iter(cells_of).collect();
    cells.par_sort_unstable();
    let pillar = |own: &[(i32, i32, u32)]| Pillar {
        x: own[0].0 << LOG2_EDGE,
        y: own[0].1 << LOG2_EDGE,
        triangles: own.iter().map(|cell| cell.2).collect(),
    };
    cells.chunk_by(|one, other| (one.0, one.1) == (other.0, other.1)).map(pillar).collect()
}

/// The cells of `2^log2` voxels per edge with a voxel between two coordinates.
fn cells_between(low: f64, high: f64, log2: u32) -> RangeInclusive<i32> {
    low.ceil() as i32 >> log2..=high.floor() as i32 >> log2
}

/// The lower nodes of a pillar, and tiles of their size that are inside.
pub(super) fn build(
    mesh: &Mesh,
    pillar: &Pillar,
    band: &Band,
    progress: &Progress,
) -> Result<Vec<(IVec3, Built<Lower>)>, Stop> {
    let crossings = Crossings::new(mesh, &pillar.triangles, [pillar.x, pillar.y]);
    let reach = band.half_width;
    let edge = f64::from(EDGE - 1);
    let low = DVec3::new(f64::from(pillar.x), f64::from(pillar.y), f64::NEG_INFINITY);
    let bounds = [low, DVec3::new(low.x + edge, low.y + edge, f64::INFINITY)];
    let mut cells = Vec::new();
    for &triangle in &pillar.triangles {
        let before = cells.len();
        let corners = mesh.corners(triangle as usize);
        pieces(corners, f64::from(EDGE), reach, bounds, &mut |low, high| {
            let own = cells_between(low.z - reach, high.z + reach, LOG2_EDGE);
            cells.extend(own.map(|z| (z, triangle)));
        });
        cells[before..].sort_unstable();
    }
    cells.sort_unstable();
    cells.dedup();
    let at = |z: i32| IVec3::new(pillar.x, pillar.y, z << LOG2_EDGE);

    let mut nodes: Vec<(IVec3, Built<Lower>)> = cells
        .par_chunk_by(|one, other| one.0 == other.0)
        .map(|own| {
            let origin = at(own[0].0);
            let built =
                lower(mesh, own.iter().map(|cell| cell.1), origin, band, &crossings, progress);
            Ok((origin, built?))
        })
        .collect::<Result<_, _>>()?;

    // No surface is near the others, so that one voxel tells for all.
    if let Some((low, high)) = crossings.range() {
        let is_built: Vec<i32> = cells.chunk_by(|a, b| a.0 == b.0).map(|own| own[0].0).collect();
        for z in cells_between(low, high, LOG2_EDGE) {
            let value = band.far(crossings.at(pillar.x, pillar.y, z << LOG2_EDGE));
            if value < 0.0 && is_built.binary_search(&z).is_err() {
                nodes.push((at(z), Built::Tile(value, false)));
            }
        }
    }
    progress.add(pillar.steps())?;
    Ok(nodes)
}

/// A lower node near some triangles.
fn lower(
    mesh: &Mesh,
    triangles: impl Iterator<Item = u32>,
    origin: IVec3,
    band: &Band,
    crossings: &Crossings,
    progress: &Progress,
) -> Result<Built<Lower>, Stop> {
    progress.add(0)?;
    let triangles: Vec<u32> = triangles.collect();
    let (starts, sorted) = by_leaf(mesh, &triangles, origin, band.half_width);
    let built: Vec<Vec<Built<Leaf>>> = (0..SLABS)
        .into_par_iter()
        .with_min_len(progress.leaves_at_once.div_ceil(SLAB))
        .map(|slab| {
            let slots = slab * SLAB..(slab + 1) * SLAB;
            let own = &sorted[starts[slots.start] as usize..starts[slots.end] as usize];
            let prepared = Prepared::new(mesh, &triangles, own);
            let leaf = |slot: usize| {
                let own = &sorted[starts[slot] as usize..starts[slot + 1] as usize];
                let origin = origin + Lower::slot_offset(slot);
                if own.is_empty() {
                    let winding = crossings.at(origin.x, origin.y, origin.z);
                    return Ok(Built::Tile(band.far(winding), false));
                }
                leaf::build(prepared.all(own), origin, band, crossings, progress.work)
            };
            slots.into_par_iter().with_min_len(progress.leaves_at_once).map(leaf).collect()
        })
        .collect::<Result<_, _>>()?;
    let slots: Vec<Built<Leaf>> = built.into_iter().flatten().collect();
    // A node that has no leaf after all is a tile only where all its tiles are the same.
    let first = match &slots[0] {
        Built::Tile(value, _) => Some(*value),
        Built::Node(_) => None,
    };
    let is_first = |slot: &Built<Leaf>| matches!(slot, Built::Tile(v, _) if Some(*v) == first);
    if let Some(value) = first
        && slots.iter().all(is_first)
    {
        return Ok(Built::Tile(value, false));
    }
    progress.work.take((size_of::<Lower>() + Lower::SIZE * size_of::<f32>()) as u64)?;
    Ok(Built::Node(internal(origin, slots)))
}

/// Slots of a lower node with the same x, which are next to each other.
const SLAB: usize = (Lower::DIM * Lower::DIM) as usize;
const SLABS: usize = Lower::DIM as usize;

/// The triangles of a slab, prepared for distances. One takes 350 bytes: those of a whole node, on each
/// thread, would be most of the memory that a fine surface takes.
struct Prepared {
    triangles: Vec<Triangle>,
    /// Where each triangle of the node is among these.
    places: Vec<u32>,
}

impl Prepared {
    /// Those triangles of a node that are among `own`, which are indices into `of_node`.
    fn new(mesh: &Mesh, of_node: &[u32], own: &[u32]) -> Self {
        const NONE: u32 = u32::MAX;
        let mut triangles = Vec::new();
        let mut places = if own.is_empty() { Vec::new() } else { vec![NONE; of_node.len()] };
        for &index in own {
            let place = &mut places[index as usize];
            if *place == NONE {
                *place = triangles.len() as u32;
                triangles.push(Triangle::new(mesh.corners(of_node[index as usize] as usize)));
            }
        }
        Self { triangles, places }
    }

    fn all<'a>(&'a self, own: &'a [u32]) -> impl Iterator<Item = &'a Triangle> {
        own.iter().map(|&index| &self.triangles[self.places[index as usize] as usize])
    }
}

/// The triangles of a node by leaf, as indices into `of_node`: where those of each slot begin, and all
/// of them.
fn by_leaf(mesh: &Mesh, of_node: &[u32], origin: IVec3, reach: f64) -> (Vec<u32>, Vec<u32>) {
    let log2 = Leaf::TOTAL_LOG2_DIM;
    let edge = f64::from((1 << log2) - 1);
    let low = origin.as_dvec3();
    let bounds = [low, low + f64::from(EDGE - 1)];
    let clip = |low: f64, high: f64, start: i32| {
        let cells = cells_between(low - reach, high + reach, log2);
        let start = start >> log2;
        (cells.start() - start).max(0)..=(cells.end() - start).min(Lower::DIM as i32 - 1)
    };
    let mut pairs: Vec<(u16, u32)> = Vec::new();
    for (&triangle, index) in of_node.iter().zip(0..) {
        let corners = mesh.corners(triangle as usize);
        let before = pairs.len();
        let mut piece_count = 0;
        pieces(corners, edge, reach, bounds, &mut |low, high| {
            piece_count += 1;
            for x in clip(low.x, high.x, origin.x) {
                for y in clip(low.y, high.y, origin.y) {
                    for z in clip(low.z, high.z, origin.z) {
                        pairs.push(((x << 8 | y << 4 | z) as u16, index));
                    }
                }
            }
        });
        if piece_count > 1 {
            pairs[before..].sort_unstable();
            // Only the pairs of this triangle are the same.
            pairs.dedup();
            let radius = edge / 2.0 * 3.0_f64.sqrt() + reach;
            let triangle = Triangle::new(corners);
            let is_near = |slot: u16| {
                let center = (origin + Lower::slot_offset(slot.into())).as_dvec3() + edge / 2.0;
                triangle.distance_squared(center) < radius * radius
            };
            let near: Vec<_> = pairs.drain(before..).filter(|pair| is_near(pair.0)).collect();
            pairs.extend(near);
        }
    }
    let mut starts = vec![0_u32; Lower::SIZE + 1];
    for (slot, _) in &pairs {
        starts[usize::from(*slot) + 1] += 1;
    }
    for slot in 0..Lower::SIZE {
        starts[slot + 1] += starts[slot];
    }
    let mut next = starts.clone();
    let mut sorted = vec![0_u32; pairs.len()];
    for (slot, triangle) in pairs {
        let at = &mut next[usize::from(slot)];
        sorted[*at as usize] = triangle;
        *at += 1;
    }
    (starts, sorted)
}
