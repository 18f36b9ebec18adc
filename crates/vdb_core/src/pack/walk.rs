//! The shader's walk on the CPU, function by function: the twin of `assets/shaders/tree.wgsl`,
//! `hdda.wgsl` and `fog.wgsl`. Same names, same order of operations, f32; read them side by side.
//!
//! A ray is given in *local lattice* coordinates of one grid: `p(t) = cell + frac + t · dir`.

use glam::{BVec3, IVec3, Vec3};

use super::PackedGrid;
use super::layout::*;

/// A ray in local lattice coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// The cell of the origin.
    pub cell: IVec3,
    /// Where in that cell the origin lies, 0 to 1 on each axis.
    pub frac: Vec3,
    /// Cells per unit of `t`; any length but zero.
    pub dir: Vec3,
    /// Where the ray starts.
    pub t_min: f32,
    /// Where it ends.
    pub t_max: f32,
}

/// What covers a cell: everything alike over a cube of `2^log_dim` cells per edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// log₂ of the edge, in cells.
    pub log_dim: u32,
    /// The cell word of a tile, the leaf's word of a cell in a leaf, 0 where nothing is.
    pub word: u32,
}

impl Span {
    const fn empty(log_dim: u32) -> Self {
        Self { log_dim, word: 0 }
    }

    /// Whether a ray meets something here.
    pub fn occupied(&self) -> bool {
        self.word & OCCUPIED != 0
    }

    /// Whether the cube is occupied all over with one value.
    pub fn constant(&self) -> bool {
        self.word & (CHILD | MIXED) == 0
    }
}

/// The cell word over a local cell at the level of the root, and log₂ of what it covers.
fn find_root(grid: &PackedGrid, cell: IVec3) -> Span {
    let at = (cell >> UPPER_BITS as i32) - grid.crown_origin;
    let outside = (at.x | at.y | at.z) >> (2 * grid.crown_levels) != 0;
    if outside {
        return Span::empty(UPPER_BITS);
    }
    let mut node = 0;
    for level in (0..grid.crown_levels).rev() {
        let part = (at >> (2 * level) as i32) & 3;
        let bit = (part.x << 4 | part.y << 2 | part.z) as u32;
        let (low, high) = (grid.nodes[node], grid.nodes[node + 1]);
        let word = if bit < 32 { low } else { high };
        if word >> (bit & 31) & 1 == 0 {
            return Span::empty(UPPER_BITS + 2 * level);
        }
        let below = (word & ((1 << (bit & 31)) - 1)).count_ones();
        let rank = if bit < 32 { below } else { below + low.count_ones() } as usize;
        let stride = if level == 0 { 1 } else { CROWN_WORDS };
        node = grid.nodes[node + 2] as usize + rank * stride;
    }
    Span { log_dim: UPPER_BITS, word: grid.nodes[node] }
}

/// What a ray meets at a local cell.
pub fn locate(grid: &PackedGrid, cell: IVec3) -> Span {
    let root = find_root(grid, cell);
    if root.word & (OCCUPIED | CHILD) != OCCUPIED | CHILD {
        return tile_span(root.word, root.log_dim);
    }
    let upper = grid.uppers as usize + (root.word & PAYLOAD) as usize * UPPER_WORDS;
    let word = grid.nodes[upper + upper_slot(cell)];
    if word & (OCCUPIED | CHILD) != OCCUPIED | CHILD {
        return tile_span(word, LOWER_BITS);
    }
    let lower = grid.lowers as usize + (word & PAYLOAD) as usize * LOWER_WORDS;
    let word = grid.nodes[lower + lower_slot(cell)];
    if word & (OCCUPIED | CHILD) != OCCUPIED | CHILD {
        return tile_span(word, LEAF_BITS);
    }
    let mask = (word & PAYLOAD) as usize * LEAF_MASK_WORDS;
    let (index, bit) = mask_bit(cell);
    let block = mask + (index & !1);
    if grid.masks[block] | grid.masks[block + 1] == 0 {
        return Span::empty(2);
    }
    let on = grid.masks[mask + index] >> bit & 1 == 1;
    Span { log_dim: 0, word: if on { word } else { 0 } }
}

/// The span of a word that leads nowhere further.
fn tile_span(word: u32, log_dim: u32) -> Span {
    match word & (OCCUPIED | MIXED) {
        OCCUPIED => Span { log_dim, word },
        0 | MIXED => Span::empty(log_dim),
        _ => Span { log_dim: 0, word },
    }
}

/// The value at a local voxel.
pub fn value_at(grid: &PackedGrid, voxel: IVec3) -> f32 {
    let mut word = find_root(grid, voxel).word;
    if word & CHILD != 0 {
        let upper = grid.uppers as usize + (word & PAYLOAD) as usize * UPPER_WORDS;
        word = grid.nodes[upper + upper_slot(voxel)];
        if word & CHILD != 0 {
            let lower = grid.lowers as usize + (word & PAYLOAD) as usize * LOWER_WORDS;
            word = grid.nodes[lower + lower_slot(voxel)];
            if word & CHILD != 0 {
                let leaf = (word & PAYLOAD) as usize * LEAF_VALUES;
                return grid.values[leaf + leaf_slot(voxel)];
            }
        }
    }
    grid.values[grid.palette as usize + (word & PAYLOAD) as usize]
}

/// Where a ray is on its way through the lattice.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    /// The cell.
    pub cell: IVec3,
    /// Where the ray enters it.
    pub t: f32,
    /// Where the ray leaves the grid's box or ends.
    pub t_end: f32,
    /// The axis of the face that the ray entered by; 3 where it started inside.
    pub axis: u32,
}

const FAR: f32 = 1e30;
/// Direction components below this count as zero: their planes are never reached, and the distance
/// between any two cells over any other component stays finite.
const TINY: f32 = 1e-20;

fn is_parallel(dir: Vec3) -> BVec3 {
    dir.abs().cmplt(Vec3::splat(TINY))
}

/// Where the ray crosses a plane on each axis. The difference of the integers is exact; the ray's
/// own numbers come in only at the end.
fn plane_t(ray: &Ray, plane: IVec3) -> Vec3 {
    let parallel = is_parallel(ray.dir);
    let dir = Vec3::select(parallel, Vec3::ONE, ray.dir);
    let t = ((plane - ray.cell).as_vec3() - ray.frac) / dir;
    Vec3::select(parallel, Vec3::splat(FAR), t)
}

/// The start of the walk: the first cell of the grid's box on the ray. `None` where it passes by.
pub fn enter(grid: &PackedGrid, ray: &Ray) -> Option<Walk> {
    let bounds = grid.occupied?;
    let forward = ray.dir.cmpgt(Vec3::ZERO);
    let (low, high) = (bounds.min, bounds.max + IVec3::ONE);
    let parallel = is_parallel(ray.dir);
    let beside = ray.cell.cmplt(low) | ray.cell.cmpge(high);
    if (parallel & beside).any() {
        return None;
    }
    let near =
        Vec3::select(parallel, Vec3::splat(-FAR), plane_t(ray, IVec3::select(forward, low, high)));
    let far = plane_t(ray, IVec3::select(forward, high, low));
    let t_near = near.max_element();
    let t = t_near.max(ray.t_min);
    let t_end = far.min_element().min(ray.t_max);
    if t > t_end {
        return None;
    }
    let at = (ray.frac + t * ray.dir).floor().as_ivec3() + ray.cell;
    let axis = if t_near < ray.t_min { 3 } else { first_axis(near.cmpeq(Vec3::splat(t_near))) };
    Some(Walk { cell: at.clamp(bounds.min, bounds.max), t, t_end, axis })
}

/// The first axis of those that are set: x before y before z, wherever planes are crossed at once.
fn first_axis(axes: BVec3) -> u32 {
    if axes.x {
        0
    } else if axes.y {
        1
    } else {
        2
    }
}

/// Steps out of the cube of `2^log_dim` cells that holds the walk's cell, into the next cell.
///
/// The cell changes by at least one along the axis crossed and never turns back along the others,
/// so a walk takes at most as many steps as the box has cells along its three edges.
pub fn advance(ray: &Ray, walk: Walk, log_dim: u32) -> Walk {
    let size = 1 << log_dim;
    let low = walk.cell & !(size - 1);
    let last = low + (size - 1);
    let forward = ray.dir.cmpgt(Vec3::ZERO);
    let exits = plane_t(ray, IVec3::select(forward, last + 1, low));
    let t_next = exits.min_element();
    let axis = first_axis(exits.cmpeq(Vec3::splat(t_next)));
    let t = t_next.max(walk.t);
    // Along the other axes: where the ray is, but within the cube and not behind the cell.
    let at = (ray.frac + t * ray.dir).floor().as_ivec3() + ray.cell;
    let from = IVec3::select(forward, walk.cell, low);
    let to = IVec3::select(forward, last, walk.cell);
    let mut cell = at.clamp(from, to);
    cell[axis as usize] = if forward.test(axis as usize) { last } else { low }[axis as usize]
        + if forward.test(axis as usize) { 1 } else { -1 };
    Walk { cell, t, axis, ..walk }
}

/// The first occupied cell on a ray.
pub fn first_hit(grid: &PackedGrid, ray: &Ray) -> Option<Walk> {
    let bounds = grid.occupied?;
    let mut walk = enter(grid, ray)?;
    loop {
        let span = locate(grid, walk.cell);
        if span.occupied() {
            return Some(walk);
        }
        walk = advance(ray, walk, span.log_dim);
        if walk.t > walk.t_end || !bounds.contains(walk.cell) {
            return None;
        }
    }
}

/// The samples at the corners of a trilinear cell, `x·4 + y·2 + z`.
fn corners(grid: &PackedGrid, cell: IVec3) -> [f32; 8] {
    std::array::from_fn(|i| {
        let i = i as i32;
        value_at(grid, cell + IVec3::new(i >> 2, i >> 1 & 1, i & 1))
    })
}

fn trilinear(corners: &[f32; 8], u: Vec3) -> f32 {
    let mix = |a: f32, b: f32, u: f32| a + (b - a) * u;
    let z = |i: usize| mix(corners[i], corners[i + 1], u.z);
    let y = |i: usize| mix(z(i), z(i + 2), u.y);
    mix(y(0), y(4), u.x)
}

/// Half the distance between the two points of Gauss and Legendre on an interval of length 1.
const GAUSS: f32 = 0.288_675_13;

/// ∫ density dt along the ray. Within one trilinear cell the density is a cubic in `t`, which the
/// two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
pub fn optical_length(grid: &PackedGrid, ray: &Ray) -> f32 {
    let (Some(bounds), Some(mut walk)) = (grid.occupied, enter(grid, ray)) else { return 0.0 };
    let mut sum = 0.0;
    loop {
        let span = locate(grid, walk.cell);
        let next = advance(ray, walk, span.log_dim);
        if span.occupied() {
            let (from, to) = (walk.t, next.t.min(walk.t_end));
            sum += (to - from) * mean_density(grid, ray, &walk, span, from, to);
        }
        walk = next;
        if walk.t >= walk.t_end || !bounds.contains(walk.cell) {
            return sum;
        }
    }
}

fn mean_density(grid: &PackedGrid, ray: &Ray, walk: &Walk, span: Span, from: f32, to: f32) -> f32 {
    if span.constant() {
        return grid.values[grid.palette as usize + (span.word & PAYLOAD) as usize];
    }
    let corners = corners(grid, walk.cell);
    let origin = (ray.cell - walk.cell).as_vec3() + ray.frac;
    let at = |s: f32| {
        let t = from + (to - from) * s;
        trilinear(&corners, (origin + t * ray.dir).clamp(Vec3::ZERO, Vec3::ONE))
    };
    0.5 * (at(0.5 - GAUSS) + at(0.5 + GAUSS))
}
