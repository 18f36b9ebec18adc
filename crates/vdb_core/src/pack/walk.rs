//! The shader's walk on the CPU, function by function: the twin of `assets/shaders/tree.wgsl`,
//! `hdda.wgsl` and, for a grid's own values in full, of `fog.wgsl`. Same names, same order of operations, f32; read them side by side.
//!
//! A ray is given in *local lattice* coordinates of one grid: `p(t) = cell + frac + t · dir`. It is
//! walked as a [`Course`], which runs upwards on every axis.

use glam::{BVec3, DVec3, IVec3, UVec3, Vec3};

use super::PackedGrid;
use super::anchor::{Anchor, anchored};
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

/// A ray turned over on the axes where it runs down, so that it runs up on all of them: cell `c`
/// becomes `!c`, and all that is ahead has larger coordinates. Cells are counted from the ray's own.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    /// -1 on the axes that are turned over, else 0.
    pub flip: IVec3,
    /// The ray's own cell, turned over.
    pub cell: IVec3,
    /// Where in that cell the ray begins, from 0 to 1: a multiple of 2⁻²⁴.
    pub frac: Vec3,
    /// Cells per unit of `t`, 0 or more; what hardware may take for zero is zero.
    pub speed: Vec3,
    /// One over that, or over `IDLE`, the least speed that counts, where it is less.
    pub inverse: Vec3,
    /// The grid's box: its first cells ahead (0 where the ray is in or beyond them) and its last.
    pub first: UVec3,
    /// The last cells of the box.
    pub last: UVec3,
    /// Whether the box is ahead of the ray on an axis.
    before: BVec3,
    /// Whether the ray can meet the box at all.
    meets: bool,
    /// The octant of its direction.
    pub octant: u32,
    t_min: f32,
    t_max: f32,
}

/// Slower than this a ray reaches no other cell within the index space, but on the spot; dividing by
/// less could exceed what f32 holds.
const IDLE: f32 = 1.0 / (1_u128 << 88) as f32;
/// `t` of planes that are never reached.
const FAR: f32 = 1e30;
/// The largest component of a direction is not smaller than this.
const SLOWEST: f32 = 1.0 / (1 << 30) as f32;

impl Course {
    /// The course of a ray through a grid.
    pub fn new(grid: &PackedGrid, ray: &Ray) -> Self {
        let bounds = grid.occupied.unwrap_or(crate::tree::CoordBox::voxel(IVec3::ZERO));
        let zero = BVec3::from_array(ray.dir.to_array().map(is_zero));
        let down = ray.dir.cmplt(Vec3::ZERO) & !zero;
        let flip = IVec3::select(down, IVec3::NEG_ONE, IVec3::ZERO);
        let cell = ray.cell ^ flip;
        let min = IVec3::select(down, !bounds.max, bounds.min);
        let max = IVec3::select(down, !bounds.min, bounds.max);
        let speed = Vec3::select(zero, Vec3::ZERO, ray.dir.abs());
        let before = cell.cmplt(min);
        let rel = |ahead: IVec3| ahead.wrapping_sub(cell).as_uvec3();
        Self {
            flip,
            cell,
            frac: Vec3::select(down, 1.0 - ray.frac, ray.frac),
            speed,
            inverse: 1.0 / speed.max(Vec3::splat(IDLE)),
            first: UVec3::select(before, rel(min), UVec3::ZERO),
            last: rel(max),
            before,
            meets: grid.occupied.is_some()
                && cell.cmple(max).all()
                && speed.max_element() >= SLOWEST,
            octant: u32::from(down.x) << 2 | u32::from(down.y) << 1 | u32::from(down.z),
            t_min: ray.t_min,
            t_max: ray.t_max,
        }
    }

    /// The local cell that is so many cells ahead.
    pub fn local(&self, rel: UVec3) -> IVec3 {
        self.cell.wrapping_add(rel.as_ivec3()) ^ self.flip
    }

    /// A place within a cell as the lattice has it.
    fn unturned(&self, u: Vec3) -> Vec3 {
        Vec3::select(self.flip.cmpne(IVec3::ZERO), 1.0 - u, u)
    }

    /// Where the course crosses planes ahead of it, one on each axis, to within [`T_ERROR`]. The
    /// integers are exact; the ray's own numbers come in only at the end.
    fn plane_t(&self, plane: UVec3) -> Vec3 {
        (plane.as_vec3() - self.frac) * self.inverse
    }
}

/// What covers a cell: everything alike over a cube of `2^log_dim` cells per edge, and over `reach`
/// more such cubes ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// log₂ of the edge, in cells.
    pub log_dim: u32,
    /// Cubes ahead on each axis that are empty, too.
    pub reach: u32,
    /// The word of a tile or a leaf that a ray meets; 0 where nothing is.
    pub word: u32,
    /// The number of the leaf; of a cell of a mixed tile, the axes on which it is the tile's last: 4, 2
    /// and 1 for x, y and z.
    pub leaf: u32,
}

impl Span {
    const fn empty(log_dim: u32, reach: u32) -> Self {
        Self { log_dim, reach, word: 0, leaf: 0 }
    }

    /// Whether a ray meets something here.
    pub fn occupied(&self) -> bool {
        self.word != 0
    }

    /// Whether the cube is occupied all over with one value.
    pub fn constant(&self) -> bool {
        self.word & (CHILD | MIXED) == 0
    }
}

/// The word of the crown over a local cell, and its level; `None` outside of the crown.
fn find_crown(grid: &PackedGrid, cell: IVec3) -> Option<(u32, u32)> {
    let header = grid.header(0);
    let at = (cell >> REGION_BITS as i32) - IVec3::from_array(header.crown_origin);
    if (at.x | at.y | at.z) >> (2 * header.crown_levels) != 0 {
        return None;
    }
    let mut level = header.crown_levels - 1;
    let mut node = header.crown as usize;
    loop {
        let word = grid.words[node + crown_slot(at, level)];
        if word & CHILD == 0 || level == 0 {
            return Some((word, level));
        }
        node = header.crown as usize + (word & PAYLOAD) as usize * CROWN_WORDS;
        level -= 1;
    }
}

/// The span of a tile around a local cell.
fn tile_span(word: u32, log_dim: u32, octant: u32, cell: IVec3) -> Span {
    if word & OCCUPIED == 0 {
        return Span::empty(log_dim, reach(word, octant));
    }
    if word & MIXED == 0 {
        return Span { log_dim, reach: 0, word, leaf: 0 };
    }
    // How many cells of the tile follow on each axis.
    let after = !cell & ((1 << log_dim) - 1);
    let sides = after.cmpeq(IVec3::ZERO);
    if sides.any() {
        let sides = u32::from(sides.x) << 2 | u32::from(sides.y) << 1 | u32::from(sides.z);
        return Span { log_dim: 0, reach: 0, word, leaf: sides };
    }
    // The largest cube around the cell without cells on the high sides.
    let log_dim = after.min_element().ilog2();
    if word & FILLED == 0 {
        return Span::empty(log_dim, 0);
    }
    Span { log_dim, reach: 0, word: word & !MIXED, leaf: 0 }
}

/// What a ray meets at a local cell. (The shader keeps what it has found while the ray stays near.)
pub fn locate(grid: &PackedGrid, cell: IVec3, octant: u32) -> Span {
    let header = grid.header(0);
    // A ray looks at cells of the box only, which the crown covers.
    let Some((word, level)) = find_crown(grid, cell) else { return Span::empty(0, 0) };
    if word & CHILD == 0 {
        return tile_span(word, REGION_BITS + 2 * level, octant, cell);
    }
    let region = (word & PAYLOAD) as usize;
    let word = grid.words[header.regions as usize + region * REGION_WORDS + region_slot(cell)];
    if word & CHILD == 0 {
        return tile_span(word, LEAF_BITS, octant, cell);
    }
    let number = word & ((1 << LEAF_NUMBER_BITS) - 1);
    let leaf = grid.words[header.heads as usize + region] + number;
    let (index, bit) = mask_bit(cell);
    if word >> (LEAF_NUMBER_BITS + index as u32 / 2) & 1 == 0 {
        return Span::empty(2, 0);
    }
    let mask = header.masks as usize + leaf as usize * LEAF_MASK_WORDS;
    let on = grid.words[mask + index] >> bit & 1 == 1;
    if on { Span { log_dim: 0, reach: 0, word, leaf } } else { Span::empty(0, 0) }
}

/// A value of the palette.
fn palette(grid: &PackedGrid, index: u32) -> f32 {
    f32::from_bits(grid.words[(grid.header(0).palette + index) as usize])
}

fn half(bits: u32) -> f32 {
    half::f16::from_bits(bits as u16).to_f32()
}

/// A value that is kept in 32 bits, in 16, or in a byte of steps.
fn sample(grid: &PackedGrid, first: u32, index: u32, steps: (f32, f32)) -> f32 {
    let word = |per_word: u32| grid.words[(first + index / per_word) as usize];
    match grid.header(0).format {
        0 => f32::from_bits(word(1)),
        1 => half(word(2) >> (16 * (index & 1))) * grid.header(0).scale,
        _ => steps.0 + (word(4) >> (8 * (index & 3)) & 0xff) as f32 * steps.1,
    }
}

/// The samples at the corners of an occupied cell that is no constant tile's, `x·4 + y·2 + z`: of fog
/// the densities, of a smooth surface the values above the iso-value.
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

/// Where a course is on its way through the lattice.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    /// The cell, counted from the course's own.
    pub rel: UVec3,
    /// Where the course enters it.
    pub t: f32,
    /// The axis of the face by which; 3 where it started inside.
    pub axis: u32,
    /// Whether the cell is in the grid's box and before the ray's end.
    pub inside: bool,
}

/// The axis of the plane that is crossed first of three, one on each axis. At once means x before y
/// before z.
fn first_axis(course: &Course, plane: UVec3, t: Vec3) -> usize {
    let least = t.min_element();
    let first = axis_of(t, least);
    let others = t[(first + 1) % 3].min(t[(first + 2) % 3]);
    if others > least * (1.0 + T_ERROR) {
        return first;
    }
    let of_two = if plane_before(course, (0, plane.x), (1, plane.y)) { 0 } else { 1 };
    if plane_before(course, (of_two, plane[of_two]), (2, plane.z)) { of_two } else { 2 }
}

/// Cells that a course has come to for certain at about `t`, on each axis, or the walk before. It may be
/// a cell further: then the walk crosses that plane next.
///
/// What f32 may get wrong, a sixteenth of [`T_ERROR`], is less than what is taken off: where `t` is that
/// of a plane or earlier, no cell behind that plane is reached.
fn cells_reached(course: &Course, t: f32, before: UVec3) -> UVec3 {
    // Conversions saturate.
    let at = (course.frac - T_ERROR) + (t * (1.0 - T_ERROR)) * course.speed;
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

/// The start of the walk: a cell of the grid's box on the course.
pub fn enter(course: &Course) -> Walk {
    let nothing = Walk { rel: UVec3::ZERO, t: 0.0, axis: 3, inside: false };
    if !course.meets {
        return nothing;
    }
    let near = Vec3::select(course.before, course.plane_t(course.first), Vec3::NEG_ONE);
    let t = near.max_element();
    if t < course.t_min || !course.before.any() {
        let at = course.frac + course.t_min * course.speed;
        // A place in a plane belongs to the cell above it, which is the one behind where turned over.
        let down = course.flip.cmpne(IVec3::ZERO);
        let cell = Vec3::select(down, at.ceil() - 1.0, at.floor());
        let rel = cell.as_uvec3();
        let in_box = rel.cmpge(course.first).all() && rel.cmple(course.last).all();
        let inside = course.t_min <= course.t_max && in_box;
        return Walk { rel, t: course.t_min, axis: 3, inside };
    }
    // Beyond the last, where the ray has left the box on another axis before it comes in on this one.
    let rel = cells_reached(course, t, course.first);
    let inside = t <= course.t_max && rel.cmple(course.last).all();
    Walk { rel, t, axis: axis_of(near, t) as u32, inside }
}

/// The planes at the end of a span, one on each axis.
pub(crate) fn planes_behind(course: &Course, rel: UVec3, span: Span) -> UVec3 {
    let size = 1_i32.wrapping_shl(span.log_dim);
    let low = course.cell.wrapping_add(rel.as_ivec3()) & size.wrapping_neg();
    let ahead = low.wrapping_add(IVec3::splat(size.wrapping_mul(1 + span.reach as i32)));
    ahead.wrapping_sub(course.cell).as_uvec3()
}

/// Steps out of the span that holds the walk's cell.
///
/// Which plane is crossed next is exact; how many planes of the other axes have been crossed by then
/// is a lower bound. Where it is too low, the walk crosses those planes next, in cells beside the ray
/// that it does not touch: all that it does touch are visited. The course never turns back and passes
/// at least one plane, so a walk takes at most as many steps as the box has cells along its three
/// edges.
pub fn advance(course: &Course, walk: &Walk, span: Span) -> Walk {
    let plane = planes_behind(course, walk.rel, span);
    let exits = course.plane_t(plane);
    let axis = first_axis(course, plane, exits);
    let t = exits[axis];
    let mut rel = cells_reached(course, t, walk.rel);
    debug_assert!(rel.cmplt(plane).all(), "beyond a plane that is not crossed yet");
    rel[axis] = plane[axis];
    let inside = t <= course.t_max && rel.cmple(course.last).all();
    Walk { rel, t, axis: axis as u32, inside }
}

/// The cell in which a ray begins: there, it comes in by no face.
fn begin_of(walk: &Walk) -> UVec3 {
    if walk.axis == 3 { walk.rel } else { UVec3::ZERO }
}

/// Whether the ray itself comes into the walk's cell, where and by which face: `begin` is the cell in
/// which the ray begins. The answer does not depend on the way by which the walk has come.
fn confirm(course: &Course, walk: &Walk, begin: UVec3) -> Walk {
    let crossed = walk.rel.cmpgt(begin);
    if !crossed.any() {
        return *walk;
    }
    let near = Vec3::select(crossed, course.plane_t(walk.rel), Vec3::NEG_ONE);
    let t = near.max_element();
    let mut axis = axis_of(near, t);
    let second = near[(axis + 1) % 3].max(near[(axis + 2) % 3]);
    let exits = course.plane_t(walk.rel.wrapping_add(UVec3::ONE));
    let mut inside = true;
    if second * (1.0 + T_ERROR) >= t || exits.min_element() <= t * (1.0 + T_ERROR) {
        let plane = |own: usize| (own, walk.rel[own]);
        let later = |last, own| last == 3 || !plane_before(course, plane(own), plane(last));
        let crossed = (0..3).filter(|&own| crossed.test(own));
        axis = crossed.fold(3, |last, own| if later(last, own) { own } else { last });
        let left = |own| {
            own != axis && plane_before(course, (own, walk.rel[own].wrapping_add(1)), plane(axis))
        };
        inside = !(0..3).any(left);
    }
    Walk { rel: walk.rel, t: near[axis], axis: axis as u32, inside }
}

/// The first occupied cell on a ray.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// The local cell.
    pub cell: IVec3,
    /// Where the ray enters it.
    pub t: f32,
    /// The axis of the face that the ray entered by; 3 where it started inside.
    pub axis: u32,
}

/// The first occupied cell on a ray.
pub fn first_hit(grid: &PackedGrid, ray: &Ray) -> Option<Hit> {
    let course = Course::new(grid, ray);
    let mut walk = enter(&course);
    let begin = begin_of(&walk);
    while walk.inside {
        let cell = course.local(walk.rel);
        let mut span = locate(grid, cell, course.octant);
        if span.occupied() {
            let hit = confirm(&course, &walk, begin);
            if hit.inside {
                let found = Hit { cell, t: hit.t, axis: hit.axis };
                return Some(found).filter(|hit| hit.t <= course.t_max);
            }
            span = Span::empty(0, 0);
        }
        walk = advance(&course, &walk, span);
    }
    None
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
const ANCHOR_RANGE: u32 = 64;

/// ∫ density dt along the ray. Within one trilinear cell the density is a cubic in `t`, which the
/// two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
///
/// Anchors stand where a run of cells with a density begins: a place that does not depend on how the
/// tree cuts the void into cubes, so that a grid looks the same, bit for bit, wherever it stands.
pub fn optical_length(grid: &PackedGrid, ray: &Ray) -> f32 {
    let course = Course::new(grid, ray);
    let mut walk = enter(&course);
    let begin = begin_of(&walk);
    let mut near = Anchor { cell: UVec3::ZERO, frac: Vec3::ZERO, t: 0.0 };
    let mut in_run = false;
    let mut from = 0.0;
    let mut sum = 0.0;
    while walk.inside {
        let span = locate(grid, course.local(walk.rel), course.octant);
        let here = walk;
        if !span.occupied() {
            walk = advance(&course, &here, span);
            in_run = false;
            continue;
        }
        if !in_run || here.rel.wrapping_sub(near.cell).max_element() > ANCHOR_RANGE {
            let own = confirm(&course, &here, begin);
            if !own.inside {
                walk = advance(&course, &here, Span::empty(0, 0));
                continue;
            }
            near = anchored(&course, &own);
            from = 0.0;
        }
        walk = advance(&course, &here, span);
        let plane = planes_behind(&course, here.rel, span);
        let to = near.exit(&course, plane, walk.axis as usize, walk.t).max(from);
        let end = to.min(course.t_max - near.t);
        let mean = mean_density(grid, &course, &near, &here, span, (from, end));
        sum += (end - from) * mean;
        from = to;
        // Of a mixed tile, cells without density count as void.
        in_run = mean > 0.0 && !span.constant();
    }
    sum
}

/// The mean density between two parameters from the anchor on, within the cube of a span.
fn mean_density(
    grid: &PackedGrid,
    course: &Course,
    near: &Anchor,
    walk: &Walk,
    span: Span,
    (from, to): (f32, f32),
) -> f32 {
    if span.constant() {
        return palette(grid, span.word & PAYLOAD);
    }
    let corners = corners(grid, span, course.local(walk.rel));
    let origin = near.frac - (walk.rel - near.cell).as_vec3();
    let at = |s: f32| {
        let t = from + (to - from) * s;
        let u = (origin + t * course.speed).clamp(Vec3::ZERO, Vec3::ONE);
        trilinear(&corners, course.unturned(u))
    };
    0.5 * (at(0.5 - GAUSS) + at(0.5 + GAUSS))
}
