//! Samples of a tree, sanitised as for packing.

use glam::{DVec3, IVec3};

use crate::pack::{PackKind, density, distance};
use crate::tree::{Accessor, Found, InternalNode, LeafNode, Node, Vdb543};

type Leaf = LeafNode<f32, 3>;
type Upper = InternalNode<InternalNode<Leaf, 4>, 5>;

/// Reads samples, caching the last leaf.
#[derive(Debug)]
pub(super) struct Samples<'a> {
    accessor: Accessor<'a, Upper>,
    background: f32,
    kind: PackKind,
}

impl<'a> Samples<'a> {
    pub fn new(tree: &'a Vdb543<f32>, kind: PackKind) -> Self {
        Self { accessor: tree.accessor(), background: tree.background(), kind }
    }

    fn sound(&self, value: f32) -> f32 {
        match self.kind {
            PackKind::Fog => density(value),
            PackKind::Surface { iso } | PackKind::Smooth { iso } => distance(value, iso),
        }
    }

    /// One sample; the background outside the 32-bit index space.
    pub fn value(&mut self, ijk: [i64; 3]) -> f32 {
        let value = match ijk.map(i32::try_from) {
            [Ok(x), Ok(y), Ok(z)] => self.accessor.get(IVec3::new(x, y, z)),
            _ => self.background,
        };
        self.sound(value)
    }

    /// The samples `ijk + {0, 1}³`.
    pub fn corners(&mut self, ijk: [i64; 3]) -> Corners {
        let inner = ijk.iter().all(|c| c & 7 != 7);
        if inner && let [Ok(x), Ok(y), Ok(z)] = ijk.map(i32::try_from) {
            // The common case: all samples are in one leaf or one tile.
            let cell = IVec3::new(x, y, z);
            return Corners(match self.accessor.find(cell) {
                Found::Leaf(leaf) => {
                    let (values, slot) = (leaf.values_slice(), Leaf::slot(cell));
                    CORNERS.map(|[x, y, z]| self.sound(values[slot + 64 * x + 8 * y + z]).into())
                }
                Found::Tile(tile) => [self.sound(tile.value).into(); 8],
            });
        }
        Corners(CORNERS.map(|corner| {
            let [x, y, z] = corner.map(|c| c as i64);
            // The index space ends long before i64 does.
            let at = [ijk[0].saturating_add(x), ijk[1].saturating_add(y), ijk[2].saturating_add(z)];
            self.value(at).into()
        }))
    }
}

const CORNERS: [[usize; 3]; 8] =
    [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]];

/// The samples at the corners of a trilinear cell, `x·4 + y·2 + z`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners([f64; 8]);

fn mix(a: f64, b: f64, u: f64) -> f64 {
    a + (b - a) * u
}

impl Corners {
    /// The interpolant at a position in the cell, from 0 to 1 on each axis.
    pub fn at(&self, u: DVec3) -> f64 {
        let c = &self.0;
        let z = |i: usize| mix(c[i], c[i + 1], u.z);
        let y = |i: usize| mix(z(i), z(i + 2), u.y);
        mix(y(0), y(4), u.x)
    }

    /// The gradient of the interpolant at a position in the cell, per voxel.
    pub fn gradient(&self, u: DVec3) -> DVec3 {
        let c = &self.0;
        let along = |step: usize, a: (usize, f64), b: (usize, f64)| {
            let slope = |i: usize| c[i + step] - c[i];
            let near = mix(slope(0), slope(a.0), a.1);
            let far = mix(slope(b.0), slope(a.0 + b.0), a.1);
            mix(near, far, b.1)
        };
        let (x, y, z) = ((4, u.x), (2, u.y), (1, u.z));
        DVec3::new(along(4, y, z), along(2, x, z), along(1, x, y))
    }
}
