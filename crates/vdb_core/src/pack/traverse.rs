//! The shader's traversal on the CPU, function by function: the twin of
//! `assets/shaders/traversal/hdda.wgsl` and, for exact trilinear fog, `fog.wgsl`. It uses f32, the
//! same names and the same order of operations; read them side by side. What a grid has at a cell
//! is in `cells.rs`.
//!
//! A ray is given in *local lattice* coordinates of one grid: `p(t) = cell + frac + t · dir`. It is
//! traversed as a [`MirroredRay`], which runs upwards on every axis.

use glam::{IVec3, UVec3, Vec3};

pub use super::cells::{Span, corners, locate};
use super::cells::{palette, trilinear};
use super::exact::{T_ERROR, WHOLE, plane_before};
use super::grid::PackedGrid;
use super::layout::PAYLOAD;
use super::mirrored_ray::FAR;
pub use super::mirrored_ray::{Dda, MirroredRay};
pub use super::ray::Ray;
use super::rebase::{Rebased, rebased_at};

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
