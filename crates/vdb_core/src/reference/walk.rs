//! A walk along a ray from box to box of a lattice, in integers.

use std::cmp::Ordering;

use super::{
    Ray,
    planes::{FAR, Plane, Planes},
};

/// A box of cells with both ends included; `-FAR` and `FAR` mean unbounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Span {
    pub low: [i64; 3],
    pub high: [i64; 3],
}

impl Span {
    /// A single cell.
    pub fn cell(cell: [i64; 3]) -> Self {
        Self { low: cell, high: cell }
    }

    /// All of space, restricted to `low..=high` on one axis.
    pub fn slab(axis: usize, low: i64, high: i64) -> Self {
        let mut span = Self { low: [-FAR; 3], high: [FAR; 3] };
        (span.low[axis], span.high[axis]) = (low, high);
        span
    }
}

/// The half-space outside the index space that contains a cell; `None` if the cell is in the index
/// space.
pub(super) fn outside_of_index_space(cell: [i64; 3]) -> Option<Span> {
    let (low, high) = (i64::from(i32::MIN), i64::from(i32::MAX));
    (0..3).find_map(|axis| match cell[axis] {
        c if c < low => Some(Span::slab(axis, -FAR, low - 1)),
        c if c > high => Some(Span::slab(axis, high + 1, FAR)),
        _ => None,
    })
}

/// The position of a walk on a ray: a cell, and the plane through which it was entered.
///
/// Crossings are ordered by `t`, and at equal `t` by axis, x before y before z. The walk visits
/// cells in that order, so at an edge or a corner it also visits the cells between. As every plane
/// is crossed once, in one direction, a box of cells that has been left is never entered again.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    planes: Planes,
    cell: [i64; 3],
    entered: Option<Plane>,
    t_min: f32,
    t_max: f32,
}

impl Walk {
    /// Starts at the cell that contains the start of the ray, `floor(p(t_min) + h)`; `None` for an
    /// invalid ray.
    pub fn new(ray: &Ray, planes: Planes) -> Option<Self> {
        if !ray.is_valid() {
            return None;
        }
        let t_min = ray.begin();
        let mut cell = [0; 3];
        for (axis, cell) in cell.iter_mut().enumerate() {
            let above = planes.coordinate(axis, f64::from(t_min)).floor();
            // A saturating cast, so that no sum overflows, corrected by exact comparisons. A start
            // beyond FAR is moved there: it is outside the index space either way.
            let guess = planes.origin(axis) + (above as i64).clamp(-2 * FAR, 2 * FAR);
            *cell = guess.clamp(-FAR, FAR);
            let is_below = |n| planes.side(Plane { axis, n }, t_min) == Ordering::Less;
            while *cell > -FAR && is_below(*cell) {
                *cell -= 1;
            }
            while *cell < FAR && !is_below(*cell + 1) {
                *cell += 1;
            }
        }
        Some(Self { planes, cell, entered: None, t_min, t_max: ray.t_max })
    }

    /// The current cell of the lattice.
    pub fn cell(&self) -> [i64; 3] {
        self.cell
    }

    /// The axis and direction of the last crossing; `None` at the start.
    pub fn entered(&self) -> Option<(usize, i64)> {
        self.entered.map(|plane| (plane.axis, self.planes.step(plane.axis)))
    }

    /// The parameter at which the cell was entered, with a relative error of at most 2.1 · 2⁻⁵³.
    pub fn t(&self) -> f64 {
        let t_min = f64::from(self.t_min);
        self.entered.map_or(t_min, |plane| self.planes.t(plane).max(t_min))
    }

    /// The plane through which the ray leaves a box around the cell; `None` if the ray ends inside.
    /// A crossing at exactly `t_max` still counts.
    pub fn exit(&self, span: Span) -> Option<Plane> {
        let mut first: Option<Plane> = None;
        for axis in 0..3 {
            let n = match self.planes.step(axis) {
                1 if span.high[axis] < FAR => span.high[axis] + 1,
                -1 if span.low[axis] > -FAR => span.low[axis],
                _ => continue,
            };
            let plane = Plane { axis, n };
            // Strictly earlier, so that ties go to the first axis.
            if first.is_none_or(|first| self.planes.compare(plane, first).is_lt()) {
                first = Some(plane);
            }
        }
        first.filter(|plane| {
            self.t_max == f32::INFINITY || self.planes.compare_with(*plane, self.t_max).is_le()
        })
    }

    /// The parameter at which a plane is crossed, with a relative error of at most 2.1 · 2⁻⁵³; at
    /// least that at which the cell was entered.
    pub fn t_of(&self, plane: Plane) -> f64 {
        self.planes.t(plane).max(self.t())
    }

    /// Leaves a box through the plane returned by [`Walk::exit`].
    pub fn cross(&mut self, span: Span, exit: Plane) {
        let t = self.planes.t(exit);
        for axis in 0..3 {
            let (from, low, high) = (self.cell[axis], span.low[axis], span.high[axis]);
            let step = self.planes.step(axis);
            if axis == exit.axis {
                self.cell[axis] = if step > 0 { exit.n } else { exit.n - 1 };
                continue;
            }
            // The range from the current cell to the end of the box ahead.
            let (low, high) = match step {
                1 => (from, high),
                -1 => (low, from),
                _ => continue,
            };
            if low == high {
                continue;
            }
            let crossed = |n| match self.planes.compare(Plane { axis, n }, exit) {
                Ordering::Less => true,
                Ordering::Equal => axis < exit.axis,
                Ordering::Greater => false,
            };
            let guess = self.planes.coordinate(axis, t).floor() as i64;
            let guess = self.planes.origin(axis) + guess.clamp(-2 * FAR, 2 * FAR);
            let mut cell = guess.clamp(low, high);
            // The guess is off by at most one, and is corrected by exact comparisons, forwards
            // first.
            if step > 0 {
                while cell < high && crossed(cell + 1) {
                    cell += 1;
                }
                while cell > low && !crossed(cell) {
                    cell -= 1;
                }
            } else {
                while cell > low && crossed(cell) {
                    cell -= 1;
                }
                while cell < high && !crossed(cell + 1) {
                    cell += 1;
                }
            }
            self.cell[axis] = cell;
        }
        self.entered = Some(exit);
    }
}
