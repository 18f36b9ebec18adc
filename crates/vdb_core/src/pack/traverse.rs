//! The shader's traversal on the CPU, function by function: the twin of
//! `assets/shaders/traversal/tree.wgsl`, `hdda.wgsl` and, for exact trilinear fog, `fog.wgsl`. It
//! uses f32, the same names and the same order of operations; read them side by side.
//!
//! A ray is given in *local lattice* coordinates of one grid: `p(t) = cell + frac + t · dir`. It is
//! traversed as a [`MirroredRay`], which runs upwards on every axis.

use glam::{IVec3, UVec3, Vec3};

use super::exact::{T_ERROR, WHOLE, plane_before};
use super::grid::PackedGrid;
use super::layout::*;
use super::mirrored_ray::FAR;
pub use super::mirrored_ray::{Dda, MirroredRay};
pub use super::ray::Ray;
use super::rebase::{Rebased, rebased_at};

/// A region around a cell in which all cells are equal: a cube of `2^log_dim` cells per edge, and
/// `skip` more such cubes ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// log₂ of the edge, in cells.
    pub log_dim: u32,
    /// The number of further cubes ahead on each axis that are also empty.
    pub skip: u32,
    /// The word of the tile or leaf that a ray meets; 0 if there is none.
    pub word: u32,
    /// The number of the leaf. For a cell of a boundary tile, the axes on which it is the tile's
    /// last cell: 4, 2 and 1 for x, y and z.
    pub leaf: u32,
}

impl Span {
    const fn empty(log_dim: u32, skip: u32) -> Self {
        Self { log_dim, skip, word: 0, leaf: 0 }
    }

    /// Whether a ray meets something here.
    pub fn occupied(&self) -> bool {
        self.word != 0
    }

    /// Whether all of the cube is occupied with one value.
    pub fn constant(&self) -> bool {
        self.word & (CHILD | BOUNDARY) == 0
    }
}

/// The word of the top-level tree that covers a local cell, and its level; `None` outside the
/// top-level tree.
fn find_top(grid: &PackedGrid, cell: IVec3) -> Option<(u32, u32)> {
    let header = grid.header(0);
    let at = (cell >> LOWER_BITS as i32) - IVec3::from_array(header.top_origin);
    if (at.x | at.y | at.z) >> (2 * header.top_levels) != 0 {
        return None;
    }
    let mut level = header.top_levels - 1;
    let mut node = header.top as usize;
    loop {
        let word = grid.words[node + top_slot(at, level)];
        if word & CHILD == 0 || level == 0 {
            return Some((word, level));
        }
        node = header.top as usize + (word & PAYLOAD) as usize * TOP_WORDS;
        level -= 1;
    }
}

/// The span of a tile around a local cell.
fn tile_span(word: u32, log_dim: u32, octant: u32, cell: IVec3) -> Span {
    if word & OCCUPIED == 0 {
        return Span::empty(log_dim, skip(word, octant));
    }
    if word & BOUNDARY == 0 {
        return Span { log_dim, skip: 0, word, leaf: 0 };
    }
    // The number of further cells of the tile on each axis.
    let after = !cell & ((1 << log_dim) - 1);
    let sides = after.cmpeq(IVec3::ZERO);
    if sides.any() {
        let sides = u32::from(sides.x) << 2 | u32::from(sides.y) << 1 | u32::from(sides.z);
        return Span { log_dim: 0, skip: 0, word, leaf: sides };
    }
    // The largest cube around the cell without cells on the high sides.
    let log_dim = after.min_element().ilog2();
    if word & FILLED == 0 {
        return Span::empty(log_dim, 0);
    }
    Span { log_dim, skip: 0, word: word & !BOUNDARY, leaf: 0 }
}

/// The span at a local cell. (The shader caches the last result.)
pub fn locate(grid: &PackedGrid, cell: IVec3, octant: u32) -> Span {
    let header = grid.header(0);
    // Traversal only visits cells of the grid's box, which the top-level tree covers.
    let Some((word, level)) = find_top(grid, cell) else { return Span::empty(0, 0) };
    if word & CHILD == 0 {
        return tile_span(word, LOWER_BITS + 2 * level, octant, cell);
    }
    let lower_node = (word & PAYLOAD) as usize;
    let word =
        grid.words[header.lower_nodes as usize + lower_node * LOWER_WORDS + lower_slot(cell)];
    if word & CHILD == 0 {
        return tile_span(word, LEAF_BITS, octant, cell);
    }
    let number = word & ((1 << LEAF_NUMBER_BITS) - 1);
    let leaf = grid.words[header.heads as usize + lower_node] + number;
    let (index, bit) = mask_bit(cell);
    if word >> (LEAF_NUMBER_BITS + index as u32 / 2) & 1 == 0 {
        return Span::empty(2, 0);
    }
    let mask = header.masks as usize + leaf as usize * LEAF_MASK_WORDS;
    let on = grid.words[mask + index] >> bit & 1 == 1;
    if on { Span { log_dim: 0, skip: 0, word, leaf } } else { Span::empty(0, 0) }
}

/// A value of the palette.
fn palette(grid: &PackedGrid, index: u32) -> f32 {
    f32::from_bits(grid.words[(grid.header(0).palette + index) as usize])
}

fn half(bits: u32) -> f32 {
    half::f16::from_bits(bits as u16).to_f32()
}

/// Decodes a value stored in 32 bits, in 16, or in a byte.
fn sample(grid: &PackedGrid, first: u32, index: u32, steps: (f32, f32)) -> f32 {
    let word = |per_word: u32| grid.words[(first + index / per_word) as usize];
    match grid.header(0).format {
        0 => f32::from_bits(word(1)),
        1 => half(word(2) >> (16 * (index & 1))) * grid.header(0).scale,
        _ => steps.0 + (word(4) >> (8 * (index & 3)) & 0xff) as f32 * steps.1,
    }
}

/// The samples at the corners of an occupied cell outside constant tiles, `x·4 + y·2 + z`:
/// densities for fog, and values relative to the iso-value for a smooth surface.
pub fn corners(grid: &PackedGrid, span: Span, cell: IVec3) -> [f32; 8] {
    let header = grid.header(0);
    let corner = |i: usize| IVec3::new(i as i32 >> 2, i as i32 >> 1 & 1, i as i32 & 1);
    if span.word & CHILD == 0 {
        return std::array::from_fn(|i| {
            let value = palette(grid, (span.word & PAYLOAD) + (i as u32 & span.leaf));
            if grid.kind == super::PackKind::Fog { value } else { value * header.scale }
        });
    }
    if grid.kind == super::PackKind::Fog {
        let mut first = header.samples + span.leaf * header.brick_words;
        let mut steps = (0.0, 0.0);
        if header.format == 2 {
            let step = |i: u32| f32::from_bits(grid.words[(first + i) as usize]);
            steps = (step(0), step(1));
            first += 2;
        }
        let slot = brick_slot(cell) as u32;
        return std::array::from_fn(|i| {
            let at = corner(i);
            sample(grid, first, slot + (at.x * 90 + at.y * 10 + at.z) as u32, steps)
        });
    }
    let block = mask_bit(cell).0 / 2;
    let before = (span.word >> LEAF_NUMBER_BITS & ((1 << block) - 1)).count_ones();
    let number = grid.words[(header.leaf_records + span.leaf) as usize] + before;
    let record = header.records as usize + number as usize * RECORD_WORDS;
    let record = &grid.words[record..record + RECORD_WORDS];
    let low = cell & 3;
    std::array::from_fn(|i| {
        let at = low + corner(i);
        let plane = record[at.x as usize];
        let below = plane & ((1 << (at.y * 5 + at.z)) - 1);
        let index = record[RECORD_WORDS - 1] + (plane >> RECORD_COUNT) + below.count_ones();
        sample(grid, header.samples, index, (-127.5 * header.scale, header.scale))
    })
}

/// The axis of the plane that is crossed first of three, one on each axis. Ties are ordered x, y,
/// z.
fn first_axis(mirrored: &MirroredRay, plane: UVec3, t: Vec3) -> usize {
    let least = t.min_element();
    let first = axis_of(t, least);
    let others = t[(first + 1) % 3].min(t[(first + 2) % 3]);
    if others > least * (1.0 + T_ERROR) {
        return first;
    }
    let of_two = if plane_before(mirrored, (0, plane.x), (1, plane.y)) { 0 } else { 1 };
    if plane_before(mirrored, (of_two, plane[of_two]), (2, plane.z)) { of_two } else { 2 }
}

/// A lower bound on the cells that a mirrored ray has reached on each axis at about `t`, and at
/// least `before`. It may be one cell too low; the traversal then crosses the missing plane next.
///
/// The margin subtracted exceeds the possible error of f32, a sixteenth of [`T_ERROR`]: if `t` is
/// at or before the crossing of a plane, no cell behind that plane is returned.
fn cells_passed(mirrored: &MirroredRay, t: f32, before: UVec3) -> UVec3 {
    // Conversions saturate.
    let at = (mirrored.frac - T_ERROR) + (t * (1.0 - T_ERROR)) * mirrored.speed;
    at.as_uvec3().max(before)
}

/// The axis of a component that equals `t`.
fn axis_of(v: Vec3, t: f32) -> usize {
    if v.x == t {
        0
    } else if v.y == t {
        1
    } else {
        2
    }
}

/// A `t` later than all planes of the grid's box, whose product with a speed is still within f32.
const NEVER: f32 = (1_u128 << 64) as f32;

/// The start of the traversal: a cell of the grid's box on the mirrored ray.
pub fn enter(mirrored: &MirroredRay) -> Dda {
    // The planes of the box that are crossed after the ray's start.
    let ahead = mirrored.begin.cmplt(mirrored.first);
    if !ahead.any() {
        let inside = mirrored.meets && mirrored.begin.cmple(mirrored.last).all();
        return Dda { rel: mirrored.begin, t: mirrored.t_min, axis: 3, inside };
    }
    let near = Vec3::select(ahead, mirrored.plane_t(mirrored.first), Vec3::NEG_ONE);
    let t = near.max_element();
    // Beyond the last cell if the ray has left the box on another axis before entering it on this
    // one.
    let rel = cells_passed(mirrored, t, mirrored.first.max(mirrored.begin));
    let inside = mirrored.meets && t < NEVER && rel.cmple(mirrored.last).all();
    Dda { rel, t: t.max(mirrored.t_min), axis: axis_of(near, t) as u32, inside }
}

/// The planes at the end of a span, one on each axis, modulo 2³². Planes beyond the index space
/// appear to lie behind the cell.
fn exit_planes(mirrored: &MirroredRay, rel: UVec3, span: Span) -> UVec3 {
    let offset = mirrored.cell.as_uvec3().wrapping_add(rel);
    let size = 1_u32 << span.log_dim;
    let ahead = UVec3::splat((span.skip + 1) << span.log_dim);
    rel.wrapping_add(ahead.wrapping_sub(offset & UVec3::splat(size - 1)))
}

/// Steps out of the span that contains the traversal's cell.
///
/// The plane that is crossed next is exact; the number of planes crossed by then on the other axes
/// is a lower bound. Where it is too low, the traversal crosses the missing planes next, through
/// cells beside the ray; every cell that the ray touches is visited. A mirrored ray never turns
/// back, and each step crosses at least one plane, the face of a span. A traversal therefore takes
/// at most as many steps as the spans in the box have faces along its three edges, which is at most
/// as many as its cells have.
pub fn advance(mirrored: &MirroredRay, dda: &Dda, span: Span) -> Dda {
    let mut plane = exit_planes(mirrored, dda.rel, span);
    let mut exits = mirrored.plane_t(plane);
    // A ray never goes back, but planes beyond the index space appear to lie behind it: it crosses
    // those at the end of the index space.
    let is_at_end = exits.min_element() < 0.5 * dda.t;
    if is_at_end {
        let beyond = plane.cmple(dda.rel);
        plane = UVec3::select(beyond, UVec3::ZERO, plane);
        exits = Vec3::select(beyond, (WHOLE - mirrored.frac) * mirrored.inverse, exits);
    }
    let axis = first_axis(mirrored, plane, exits);
    let t = exits[axis];
    let mut rel = cells_passed(mirrored, t, dda.rel);
    let passed = |own: usize| plane[own] != 0 && rel[own] >= plane[own];
    debug_assert!(!(0..3).any(passed), "beyond a plane that is not crossed yet");
    rel[axis] = plane[axis];
    let inside = rel.cmple(mirrored.last).all() && !(is_at_end && rel.cmplt(dda.rel).any());
    Dda { rel, t, axis: axis as u32, inside }
}

/// Whether the ray itself enters the traversal's cell, and at what `t` and by which face; there is
/// no face for a ray that begins there. The answer does not depend on the traversal's path.
fn confirm(mirrored: &MirroredRay, dda: &Dda) -> Dda {
    let crossed = dda.rel.cmpgt(mirrored.begin);
    if !crossed.any() {
        return Dda { rel: dda.rel, t: mirrored.t_min, axis: 3, inside: true };
    }
    let near = Vec3::select(crossed, mirrored.plane_t(dda.rel), Vec3::NEG_ONE);
    let t = near.max_element();
    let mut axis = axis_of(near, t);
    let second = near[(axis + 1) % 3].max(near[(axis + 2) % 3]);
    let behind = dda.rel.wrapping_add(UVec3::ONE);
    let at_end = (WHOLE - mirrored.frac) * mirrored.inverse;
    let exits = Vec3::select(behind.cmpeq(UVec3::ZERO), at_end, mirrored.plane_t(behind));
    let mut inside = true;
    if second * (1.0 + T_ERROR) >= t || exits.min_element() <= t * (1.0 + T_ERROR) {
        let plane = |own: usize| (own, dda.rel[own]);
        let later = |last, own| last == 3 || !plane_before(mirrored, plane(own), plane(last));
        let crossed = (0..3).filter(|&own| crossed.test(own));
        axis = crossed.fold(3, |last, own| if later(last, own) { own } else { last });
        let left = |own| own != axis && plane_before(mirrored, (own, behind[own]), plane(axis));
        inside = !(0..3).any(left);
    }
    Dda { rel: dda.rel, t: near[axis], axis: axis as u32, inside }
}

/// Clamps a `t` to the span of a mirrored ray, which rounding must not leave.
fn clamp_to_ray(mirrored: &MirroredRay, t: f32) -> f32 {
    t.clamp(mirrored.t_min, mirrored.t_max)
}

/// The first occupied cell on a ray.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// The local cell.
    pub cell: IVec3,
    /// The `t` at which the ray enters the cell.
    pub t: f32,
    /// The axis of the face through which the ray entered; 3 if it began inside.
    pub axis: u32,
}

/// The first occupied cell on a ray.
pub fn first_hit(grid: &PackedGrid, ray: &Ray) -> Option<Hit> {
    let mirrored = MirroredRay::new(grid, ray);
    let mut dda = enter(&mirrored);
    while dda.inside {
        let cell = mirrored.local(dda.rel);
        let mut span = locate(grid, cell, mirrored.octant);
        if span.occupied() {
            let hit = confirm(&mirrored, &dda);
            if hit.inside {
                return Some(Hit { cell, t: clamp_to_ray(&mirrored, hit.t), axis: hit.axis });
            }
            span = Span::empty(0, 0);
        }
        dda = advance(&mirrored, &dda, span);
    }
    None
}

fn trilinear(corners: &[f32; 8], u: Vec3) -> f32 {
    let mix = |a: f32, b: f32, u: f32| a + (b - a) * u;
    let z = |i: usize| mix(corners[i], corners[i + 1], u.z);
    let y = |i: usize| mix(z(i), z(i + 2), u.y);
    mix(y(0), y(4), u.x)
}

/// Half the distance between the two Gauss–Legendre points on an interval of length 1.
const GAUSS: f32 = 0.288_675_13;

/// Distance in cells from a rebased origin after which the traversal takes a new one.
const REBASE_RANGE: u32 = 64;

/// The upper bound of `∫ density dt`, which could overflow f32 for the greatest densities on a slow
/// ray.
const MAX_LENGTH: f32 = 3e38;

/// ∫ density dt along the ray. In a trilinear cell the density is a cubic in `t`, which two-point
/// Gauss–Legendre quadrature integrates exactly, so there is no step size.
///
/// The origin is rebased where a run of cells with density begins. This position does not depend on
/// how the tree divides empty space into cubes, so a grid looks the same, bit for bit, wherever it
/// is in index space.
pub fn optical_length(grid: &PackedGrid, ray: &Ray) -> f32 {
    let mirrored = MirroredRay::new(grid, ray);
    let mut dda = enter(&mirrored);
    let mut near = Rebased { cell: UVec3::ZERO, frac: Vec3::ZERO, t: 0.0, end: FAR };
    let mut in_run = false;
    let mut from = 0.0;
    let mut sum = 0.0;
    while dda.inside {
        let span = locate(grid, mirrored.local(dda.rel), mirrored.octant);
        let here = dda;
        if !span.occupied() {
            dda = advance(&mirrored, &here, span);
            in_run = false;
            continue;
        }
        if !in_run || here.rel.wrapping_sub(near.cell).max_element() > REBASE_RANGE {
            let own = confirm(&mirrored, &here);
            if !own.inside {
                dda = advance(&mirrored, &here, Span::empty(0, 0));
                continue;
            }
            near = rebased_at(&mirrored, &own);
            from = 0.0;
        }
        dda = advance(&mirrored, &here, span);
        let plane = exit_planes(&mirrored, here.rel, span);
        let to = near.exit(&mirrored, plane, dda.axis as usize).max(from);
        let end = to.min(near.end);
        let mean = mean_density(grid, &mirrored, &near, &here, span, (from, end));
        sum += (end - from) * mean;
        from = to;
        // Cells of a boundary tile without density count as empty.
        in_run = mean > 0.0 && !span.constant();
    }
    sum.min(MAX_LENGTH)
}

/// The mean density between two parameters from the rebased origin, within the cube of a span.
fn mean_density(
    grid: &PackedGrid,
    mirrored: &MirroredRay,
    near: &Rebased,
    dda: &Dda,
    span: Span,
    (from, to): (f32, f32),
) -> f32 {
    if span.constant() {
        return palette(grid, span.word & PAYLOAD);
    }
    let corners = corners(grid, span, mirrored.local(dda.rel));
    let origin = near.frac - dda.rel.wrapping_sub(near.cell).as_vec3();
    let at = |s: f32| {
        let t = from + (to - from) * s;
        let u = (origin + t * mirrored.speed).clamp(Vec3::ZERO, Vec3::ONE);
        trilinear(&corners, mirrored.unmirrored(u))
    };
    0.5 * (at(0.5 - GAUSS) + at(0.5 + GAUSS))
}
