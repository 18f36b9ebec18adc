//! The vertices and triangles of a block of 8³ cells.

use glam::{DMat3, DVec3, IVec3, Vec3};

use super::cases::{CASES, EDGES};
use crate::Transform;
use crate::tools::nodes::Leaf;
use crate::tree::{Found, Node, Vdb543};

const EDGE: i32 = 8;

/// Values along an edge of the surroundings: those of the voxels from -1 to 9.
const WIDE: usize = EDGE as usize + 3;

/// What is the same for all blocks.
pub(super) struct Placement<'a> {
    pub transform: &'a Transform,
    /// From gradients in index space to normals in world space.
    pub normal_from_gradient: DMat3,
    pub iso: f32,
    /// Whether triangles are to be turned around.
    pub flip: bool,
}

/// A block with a part of the surface. It owns the edges from its voxels to the next ones.
pub(super) struct Block {
    pub origin: IVec3,
    /// Which voxels of 9³ are below the value of the surface, by x and y.
    below: [[u16; 9]; 9],
    /// The owned edges that cross the surface, by axis, by x and y.
    crossed: [[u64; 8]; 3],
    /// The number of vertices before each word of `crossed`.
    ranks: [[u16; 8]; 3],
    pub positions: Vec<[f32; 3]>,
    pub normals: Vec<[f32; 3]>,
}

impl Block {
    /// `None` if no cell crosses the surface.
    pub(super) fn new(tree: &Vdb543<f32>, origin: IVec3, placement: &Placement) -> Option<Self> {
        if is_uniform(tree, origin, placement.iso) {
            return None;
        }
        let values = surroundings(tree, origin);
        let value = |x: usize, y: usize, z: usize| values[(x * WIDE + y) * WIDE + z];
        let mut below = [[0; 9]; 9];
        for (x, plane) in below.iter_mut().enumerate() {
            for (y, row) in plane.iter_mut().enumerate() {
                for z in 0..9 {
                    *row |= u16::from(value(x + 1, y + 1, z + 1) < placement.iso) << z;
                }
            }
        }
        let all = below.as_flattened();
        if all.iter().all(|&row| row == 0) || all.iter().all(|&row| row == 0x1FF) {
            return None;
        }
        let (mut crossed, mut ranks) = ([[0_u64; 8]; 3], [[0; 8]; 3]);
        for x in 0..8 {
            for y in 0..8 {
                let row = below[x][y];
                let others = [below[x + 1][y], below[x][y + 1], row >> 1];
                for axis in 0..3 {
                    crossed[axis][x] |= u64::from((row ^ others[axis]) & 0xFF) << (8 * y);
                }
            }
        }
        let mut count = 0;
        for axis in 0..3 {
            for x in 0..8 {
                ranks[axis][x] = count;
                count += crossed[axis][x].count_ones() as u16;
            }
        }
        let mut block = Self {
            origin,
            below,
            crossed,
            ranks,
            positions: Vec::with_capacity(count.into()),
            normals: Vec::with_capacity(count.into()),
        };
        block.place(&values, placement);
        Some(block)
    }

    /// Bytes of memory that the block and its part of the mesh take.
    pub(super) fn bytes(&self) -> u64 {
        // Each vertex is copied once, and has about two triangles.
        (size_of::<Self>() + self.positions.len() * (2 * 24 + 2 * 12)) as u64
    }

    /// Computes the vertices.
    fn place(&mut self, values: &[f32], placement: &Placement) {
        const STEPS: [usize; 3] = [WIDE * WIDE, WIDE, 1];
        let gradient = |at: usize| -> DVec3 {
            let along = |step: usize| f64::from(values[at + step]) - f64::from(values[at - step]);
            DVec3::new(along(STEPS[0]), along(STEPS[1]), along(STEPS[2])) / 2.0
        };
        for axis in 0..3 {
            for x in 0..8 {
                let mut rest = self.crossed[axis][x];
                while rest != 0 {
                    let bit = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let (y, z) = (bit >> 3, bit & 7);
                    let at = ((x + 1) * WIDE + y + 1) * WIDE + z + 1;
                    let next = at + STEPS[axis];
                    let [a, b] = [at, next].map(|at| f64::from(values[at]));
                    let t = (f64::from(placement.iso) - a) / (b - a);
                    // Where a value is infinite or NaN, there is no root.
                    let t = if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.5 };
                    let mut p = (self.origin + IVec3::new(x as i32, y as i32, z as i32)).as_dvec3();
                    p[axis] += t;
                    let slope = gradient(at).lerp(gradient(next), t);
                    let normal = (placement.normal_from_gradient * slope).normalize_or_zero();
                    let position = placement.transform.world_from_index(p).as_vec3();
                    self.positions.push(position.to_array());
                    self.normals.push(Vec3::to_array(&normal.as_vec3()));
                }
            }
        }
    }

    /// The index of the vertex on an owned edge, from that of the first one.
    fn vertex(&self, axis: usize, [x, y, z]: [usize; 3]) -> u32 {
        let before = self.crossed[axis][x] & ((1 << (8 * y + z)) - 1);
        u32::from(self.ranks[axis][x]) + before.count_ones()
    }

    /// The triangles of the cells. `neighbour` is the block at an offset, with the index of its
    /// first vertex.
    pub(super) fn triangles<'a>(
        &self,
        neighbour: impl Fn(IVec3) -> Option<(&'a Self, u32)>,
        flip: bool,
    ) -> Vec<[u32; 3]> {
        let around: [_; 8] = std::array::from_fn(|bits| {
            let bits = bits as i32;
            neighbour(IVec3::new(bits >> 2, bits >> 1 & 1, bits & 1))
        });
        let mut triangles = Vec::with_capacity(2 * self.positions.len());
        for x in 0..8 {
            for y in 0..8 {
                let rows = [
                    self.below[x][y],
                    self.below[x][y + 1],
                    self.below[x + 1][y],
                    self.below[x + 1][y + 1],
                ];
                if rows.iter().all(|&row| row == 0) || rows.iter().all(|&row| row == 0x1FF) {
                    continue;
                }
                for z in 0..8 {
                    let pair = |row: u16| usize::from(row >> z & 3);
                    // Corner `4x + 2y + z` has that bit.
                    let case = rows.iter().rev().fold(0, |case, &row| case << 2 | pair(row));
                    for triangle in &CASES[case] {
                        let vertex = |edge: u8| {
                            let (corner, axis) = EDGES[usize::from(edge)];
                            let bits = [corner >> 2, corner >> 1 & 1, corner & 1];
                            let at = [0, 1, 2].map(|i| [x, y, z][i] + usize::from(bits[i]));
                            let owner = at.iter().fold(0, |owner, c| owner << 1 | c >> 3);
                            let (block, first) = around[owner]?;
                            Some(first + block.vertex(axis.into(), at.map(|c| c & 7)))
                        };
                        let [a, b, c] = triangle.map(vertex);
                        // All are there: a block with a crossed edge is near the surface.
                        if let (Some(a), Some(b), Some(c)) = (a, b, c) {
                            triangles.push(if flip { [a, c, b] } else { [a, b, c] });
                        }
                    }
                }
            }
        }
        triangles
    }
}

/// Whether 8³ cells surely do not cross the surface, because they are in tiles on one side.
fn is_uniform(tree: &Vdb543<f32>, origin: IVec3, iso: f32) -> bool {
    let side = |bits: i32| {
        let offset = IVec3::new(bits >> 2, bits >> 1 & 1, bits & 1) * EDGE;
        match tree.find(origin + offset) {
            Found::Tile(tile) => Some(tile.value < iso),
            Found::Leaf(_) => None,
        }
    };
    let first = side(0);
    first.is_some() && (1..8).all(|bits| side(bits) == first)
}

/// The values of the voxels from -1 to 9 around a block, z fastest.
fn surroundings(tree: &Vdb543<f32>, origin: IVec3) -> Vec<f32> {
    let mut values = vec![0.0; WIDE * WIDE * WIDE];
    // What each block along an axis contributes: the first voxel, and their number, there and here.
    let parts = [(7, 1, 0), (0, 8, 1), (0, 2, 9)];
    for (i, (from_x, count_x, to_x)) in parts.into_iter().enumerate() {
        for (j, (from_y, count_y, to_y)) in parts.into_iter().enumerate() {
            for (k, (from_z, count_z, to_z)) in parts.into_iter().enumerate() {
                let offset = IVec3::new(i as i32 - 1, j as i32 - 1, k as i32 - 1) * EDGE;
                let found = tree.find(origin + offset);
                for x in 0..count_x {
                    for y in 0..count_y {
                        let to = ((to_x + x) * WIDE + to_y + y) * WIDE + to_z;
                        let row = &mut values[to..to + count_z];
                        match &found {
                            Found::Tile(tile) => row.fill(tile.value),
                            Found::Leaf(leaf) => {
                                let from = ((from_x + x) * Leaf::DIM as usize + from_y + y) * 8;
                                let own = &leaf.values_slice()[from + from_z..][..count_z];
                                row.copy_from_slice(own);
                            }
                        }
                    }
                }
            }
        }
    }
    values
}
