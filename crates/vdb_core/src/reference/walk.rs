//! A walk along a ray from box to box of a lattice, in integers.

use std::cmp::Ordering;

use super::{
    Ray,
    planes::{FAR, Plane, Planes},
};

/// A box of cells, both ends included; `-FAR` and `FAR` stand for no end.
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

    /// Everything, but only `low..=high` on one axis.
    pub fn slab(axis: usize, low: i64, high: i64) -> Self {
        let mut span = Self { low: [-FAR; 3], high: [FAR; 3] };
        (span.low[axis], span.high[axis]) = (low, high);
        span
    }
}

/// The half-space without voxels and cells in which a cell lies, if it does not lie in the index space.
pub(super) fn outside_of_index_space(cell: [i64; 3]) -> Option<Span> {
    let (low, high) = (i64::from(i32::MIN), i64::from(i32::MAX));
    (0..3).find_map(|axis| match cell[axis] {
        c if c < low => Some(Span::slab(axis, -FAR, low - 1)),
        c if c > high => Some(Span::slab(axis, high + 1, FAR)),
        _ => None,
    })
}

/// Where on a ray the walk stands: a cell, and the plane through which it was entered.
///
/// Crossings are ordered by `t`, and at the same `t` by axis, x before y before z. The walk visits
/// the cells in that order, so at an edge or a corner it visits the cells between, too. As every
/// plane is crossed once, in one direction, a box of cells that has been left is never met again.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    planes: Planes,
    cell: [i64; 3],
    entered: Option<Plane>,
    t_min: f32,
    t_max: f32,
}

impl Walk {
    /// At the cell that holds the ray's beginning, `floor(p(t_min) + h)`; `None` for a ray that is
    /// not valid.
    pub fn new(ray: &Ray, planes: Planes) -> Option<Self> {
        if !ray.is_valid() {
            return None;
        }
        let t_min = ray.begin();
        let mut cell = [0; 3];
        for (axis, cell) in cell.iter_mut().enumerate() {
            let above = planes.coordinate(axis, f64::from(t_min)).floor();
            // A saturating cast, so that no sum overflows; then corrected by exact questions. A
            // start beyond FAR stays there: it is outside of the index space either way.
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

    /// The cell of the lattice.
    pub fn cell(&self) -> [i64; 3] {
        self.cell
    }

    /// The axis of the last crossing and the direction in which it went; `None` at the beginning.
    pub fn entered(&self) -> Option<(usize, i64)> {
        self.entered.map(|plane| (plane.axis, self.planes.step(plane.axis)))
    }

    /// Where the cell was entered, good to 2.1 · 2⁻⁵³ of itself.
    pub fn t(&self) -> f64 {
        let t_min = f64::from(self.t_min);
        self.entered.map_or(t_min, |plane| self.planes.t(plane).max(t_min))
    }

    /// The plane through which the ray leaves a box around the cell, and when; `None` when it
    /// ends inside. A crossing at exactly `t_max` still counts.
    pub fn exit(&self, span: Span) -> Option<Plane> {
        let mut first: Option<Plane> = None;
        for axis in 0..3 {
            let n = match self.planes.step(axis) {
                1 if span.high[axis] < FAR => span.high[axis] + 1,
                -1 if span.low[axis] > -FAR => span.low[axis],
                _ => continue,
            };
            let plane = Plane { axis, n };
            // Only an earlier crossing takes the place of one on an axis before.
            if first.is_none_or(|first| self.planes.compare(plane, first).is_lt()) {
                first = Some(plane);
            }
        }
        first.filter(|plane| {
            self.t_max == f32::INFINITY || self.planes.compare_with(*plane, self.t_max).is_le()
        })
    }

    /// Where a plane is crossed, good to 2.1 · 2⁻⁵³ of itself; at least where the cell was entered.
    pub fn t_of(&self, plane: Plane) -> f64 {
        self.planes.t(plane).max(self.t())
    }

    /// Leaves a box through the plane that [`Walk::exit`] named.
    pub fn cross(&mut self, span: Span, exit: Plane) {
        let t = self.planes.t(exit);
        for axis in 0..3 {
            let (from, low, high) = (self.cell[axis], span.low[axis], span.high[axis]);
            let step = self.planes.step(axis);
            if axis == exit.axis {
                self.cell[axis] = if step > 0 { exit.n } else { exit.n - 1 };
                continue;
            }
            // Between where it stands and the end of the box that lies ahead.
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
            // The guess is off by one at most; exact questions put it right. Ahead first:
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
