//! The shader's walk on the CPU, function by function: the twin of `assets/shaders/tree.wgsl`,
//! `hdda.wgsl` and `fog.wgsl`. Same names, same order of operations, f32; read them side by side.
//!
//! A ray is given in *local lattice* coordinates of one grid: `p(t) = cell + frac + t · dir`.

use glam::{BVec3, DVec3, IVec3, Vec3};

use super::PackedGrid;
use super::anchor::anchored;
use super::exact::{FRAC_BITS, T_ERROR, is_zero, plane_before};
use super::layout::*;

/// A ray in local lattice coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// The cell of the origin.
    pub cell: IVec3,
    /// Where in that cell the origin lies: a multiple of 2⁻²⁴, from 0 up to but not 1.
    pub frac: Vec3,
    /// Cells per unit of `t`; the largest component must be of a size between 2⁻³⁰ and 2³⁰. A ray
    /// that is slower meets nothing.
    pub dir: Vec3,
    /// Where the ray starts.
    pub t_min: f32,
    /// Where it ends.
    pub t_max: f32,
}

impl Ray {
    /// The ray of a grid nearest to one in index space, `p(t) = cell + frac + t · dir`: the fraction
    /// is rounded down to 24 bits, the direction is as it is. From `t = 0` on without an end.
    pub fn from_index(grid: &PackedGrid, cell: IVec3, frac: Vec3, dir: Vec3) -> Self {
        let from = frac.as_dvec3() - grid.kind.lattice_origin();
        let units = f64::from(1 << FRAC_BITS);
        // Just below a whole number, the difference rounds up to 1.
        let frac = ((from - from.floor()) * units).floor().min(DVec3::splat(units - 1.0)) / units;
        let cell = cell.wrapping_add(from.floor().as_ivec3()).wrapping_sub(grid.base);
        Self { cell, frac: frac.as_vec3(), dir, t_min: 0.0, t_max: FAR }
    }
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
    /// Where the ray ends.
    pub t_end: f32,
    /// The axis of the face that the ray entered by; 3 where it started inside.
    pub axis: u32,
    /// Whether the cell is in the grid's box and before the ray's end.
    pub inside: bool,
}

/// `t` of planes that are never reached.
const FAR: f32 = 1e30;
/// How far from the grid's origin, and from the cells it is asked about, an eye may be, in cells.
const MAX_CELLS: f32 = (1 << 30) as f32;
/// Direction components smaller than this, relative to the largest, never reach another cell within
/// the index space, but on the spot; dividing by them could exceed what f32 holds.
const IDLE: f32 = 1.0 / (1_u64 << 58) as f32;
/// The largest component of a direction is not smaller than this.
const SLOWEST: f32 = 1.0 / (1 << 30) as f32;

fn select(mask: BVec3, a: BVec3, b: BVec3) -> BVec3 {
    mask & a | !mask & b
}

/// Where the ray crosses planes ahead of it, one on each axis, to within [`T_ERROR`]. The
/// difference of the integers is exact; the ray's own numbers come in only at the end.
fn plane_t(ray: &Ray, plane: IVec3) -> Vec3 {
    let forward = ray.dir.cmpgt(Vec3::ZERO);
    let cells = IVec3::select(forward, plane.wrapping_sub(ray.cell), ray.cell.wrapping_sub(plane));
    let distance = cells.as_uvec3().as_vec3() + Vec3::select(forward, -ray.frac, ray.frac);
    let idle = ray.dir.abs().cmplt(Vec3::splat(IDLE * ray.dir.abs().max_element()));
    let t = distance / Vec3::select(idle, Vec3::ONE, ray.dir.abs());
    let zero = BVec3::from_array(ray.dir.to_array().map(is_zero));
    let never = zero | (idle & distance.cmpne(Vec3::ZERO));
    Vec3::select(never, Vec3::splat(FAR), t)
}

/// The axis of the plane that is crossed first of three, one on each axis. At once means x before y
/// before z.
fn first_axis(ray: &Ray, plane: IVec3, t: Vec3) -> usize {
    let first = if t.x <= t.y && t.x <= t.z {
        0
    } else if t.y <= t.z {
        1
    } else {
        2
    };
    let others = t[(first + 1) % 3].min(t[(first + 2) % 3]);
    if others > t[first] * (1.0 + T_ERROR) {
        return first;
    }
    let of_two = if plane_before(ray, (0, plane.x), (1, plane.y)) { 0 } else { 1 };
    if plane_before(ray, (of_two, plane[of_two]), (2, plane.z)) { of_two } else { 2 }
}

/// The cells that the ray is in, on each axis, when it has crossed a plane of one of them at about
/// `t`; between `first` and `last`, which the ray passes in that order.
fn cells_behind(ray: &Ray, crossed: (usize, i32), t: f32, first: IVec3, last: IVec3) -> IVec3 {
    let way = t * ray.dir;
    let at = ray.frac + way;
    let error = (way.abs() + 1.0) * T_ERROR;
    let cell = |x: Vec3| {
        // Kept to what an integer holds; the eye is no farther away than that.
        let cells = x.floor().clamp(Vec3::splat(-MAX_CELLS), Vec3::splat(MAX_CELLS));
        cells.as_ivec3().wrapping_add(ray.cell).clamp(first.min(last), first.max(last))
    };
    let (mut low, mut high) = (cell(at - error), cell(at + error));
    for axis in 0..3 {
        let forward = ray.dir[axis] > 0.0;
        // Which of the planes in doubt are crossed before? Those that are come first.
        while low[axis] < high[axis] && axis != crossed.0 {
            let middle = low[axis] + (high[axis] - low[axis]) / 2;
            if plane_before(ray, (axis, middle + 1), crossed) == forward {
                low[axis] = middle + 1;
            } else {
                high[axis] = middle;
            }
        }
    }
    low
}

/// The start of the walk: the first cell of the grid's box on the ray.
pub fn enter(grid: &PackedGrid, ray: &Ray) -> Walk {
    let nothing = Walk { cell: ray.cell, t: 0.0, t_end: 0.0, axis: 3, inside: false };
    let Some(bounds) = grid.occupied else { return nothing };
    let forward = ray.dir.cmpgt(Vec3::ZERO);
    // The planes by which the ray comes into the box, on the axes where it is before it.
    let before = select(forward, ray.cell.cmplt(bounds.min), ray.cell.cmpgt(bounds.max));
    let beyond = select(forward, ray.cell.cmpgt(bounds.max), ray.cell.cmplt(bounds.min));
    let plane = IVec3::select(forward, bounds.min, bounds.max + IVec3::ONE);
    let near = Vec3::select(before, plane_t(ray, plane), Vec3::NEG_ONE);
    let slow = ray.dir.abs().max_element() < SLOWEST;
    if slow || beyond.any() || near.max_element() >= FAR {
        return nothing;
    }
    let mut walk = Walk { t: ray.t_min, t_end: ray.t_max, inside: true, ..nothing };
    if near.max_element() < ray.t_min || !before.any() {
        let at = (ray.frac + ray.t_min * ray.dir).floor();
        walk.cell = ray.cell + at.as_ivec3();
        walk.inside = ray.t_min <= ray.t_max && bounds.contains(walk.cell);
        return walk;
    }
    // The last of them; at once means x before y before z.
    let mut axis = usize::MAX;
    for other in 0..3 {
        if before.test(other)
            && (axis == usize::MAX
                || !plane_before(ray, (other, plane[other]), (axis, plane[axis])))
        {
            axis = other;
        }
    }
    let first = ray.cell.clamp(bounds.min, bounds.max);
    // One cell more: the ray may have left the box on another axis before it comes in on this one.
    let last = IVec3::select(forward, bounds.max + IVec3::ONE, bounds.min - IVec3::ONE);
    let t = near[axis];
    let mut cell = cells_behind(ray, (axis, plane[axis]), t, first, last);
    cell[axis] = first[axis];
    let inside = t <= ray.t_max && bounds.contains(cell);
    Walk { cell, t, axis: axis as u32, inside, ..walk }
}

/// Steps out of the cube of `2^log_dim` cells that holds the walk's cell, into the next cell.
///
/// The cell changes by at least one along the axis crossed and never turns back along the others,
/// so a walk takes at most as many steps as the box has cells along its three edges.
pub fn advance(grid: &PackedGrid, ray: &Ray, walk: Walk, log_dim: u32) -> Walk {
    let size = 1 << log_dim;
    let low = walk.cell & -size;
    let last = low + (size - 1);
    let forward = ray.dir.cmpgt(Vec3::ZERO);
    let plane = IVec3::select(forward, last + 1, low);
    let exits = plane_t(ray, plane);
    let axis = first_axis(ray, plane, exits);
    let t = exits[axis].max(walk.t);
    let end = IVec3::select(forward, last, low);
    let mut cell = cells_behind(ray, (axis, plane[axis]), t, walk.cell, end);
    cell[axis] = end[axis] + if forward.test(axis) { 1 } else { -1 };
    let inside = t <= walk.t_end && grid.occupied.is_some_and(|bounds| bounds.contains(cell));
    Walk { cell, t, axis: axis as u32, inside, ..walk }
}

/// The first occupied cell on a ray.
pub fn first_hit(grid: &PackedGrid, ray: &Ray) -> Option<Walk> {
    let mut walk = enter(grid, ray);
    while walk.inside {
        let span = locate(grid, walk.cell);
        if span.occupied() {
            return Some(walk);
        }
        walk = advance(grid, ray, walk, span.log_dim);
    }
    None
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

/// Cells that a walk may be away from its anchor before it gets a new one.
const ANCHOR_RANGE: i32 = 64;

/// Where a ray that began before it leaves the cube of `2^log_dim` cells that holds a cell. By
/// whichever plane comes first for its own numbers: those of an anchor are rounded, and where the
/// ray hardly moves along the axis that the walk crosses, its plane can be far off.
fn exit_t(ray: &Ray, cell: IVec3, log_dim: u32) -> f32 {
    let size = 1 << log_dim;
    let low = cell & -size;
    plane_t(ray, IVec3::select(ray.dir.cmpgt(Vec3::ZERO), low + size, low)).min_element()
}

/// ∫ density dt along the ray. Within one trilinear cell the density is a cubic in `t`, which the
/// two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
///
/// Anchors stand where a run of cells with a density begins: a place that does not depend on how the tree
/// cuts the void into cubes, so that a grid looks the same, bit for bit, wherever it stands.
pub fn optical_length(grid: &PackedGrid, ray: &Ray) -> f32 {
    let mut walk = enter(grid, ray);
    let mut near = *ray;
    let mut in_run = false;
    let mut from = 0.0;
    let mut sum = 0.0;
    while walk.inside {
        let span = locate(grid, walk.cell);
        let here = walk;
        walk = advance(grid, ray, walk, span.log_dim);
        if !span.occupied() {
            in_run = false;
            continue;
        }
        if !in_run || (here.cell - near.cell).abs().max_element() > ANCHOR_RANGE {
            near = anchored(ray, here.cell, here.axis, here.t);
            from = 0.0;
        }
        let to = exit_t(&near, here.cell, span.log_dim).max(from);
        let end = to.min(near.t_max);
        let mean = mean_density(grid, &near, here.cell, span, from, end);
        sum += (end - from) * mean;
        from = to;
        // Of a mixed tile, cells without density count as void.
        in_run = mean > 0.0 && !span.constant();
    }
    sum
}

/// The mean density between two parameters within the cube of a span.
fn mean_density(grid: &PackedGrid, ray: &Ray, cell: IVec3, span: Span, from: f32, to: f32) -> f32 {
    if span.constant() {
        return grid.values[grid.palette as usize + (span.word & PAYLOAD) as usize];
    }
    let corners = corners(grid, cell);
    let origin = (ray.cell - cell).as_vec3() + ray.frac;
    let at = |s: f32| {
        let t = from + (to - from) * s;
        trilinear(&corners, (origin + t * ray.dir).clamp(Vec3::ZERO, Vec3::ONE))
    };
    0.5 * (at(0.5 - GAUSS) + at(0.5 + GAUSS))
}
