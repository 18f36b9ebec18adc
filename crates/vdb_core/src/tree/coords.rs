//! Boxes of voxels.

use glam::IVec3;

/// A box of voxels in index space, both corners included; never empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CoordBox {
    /// The lowest voxel.
    pub min: IVec3,
    /// The highest voxel.
    pub max: IVec3,
}

impl CoordBox {
    /// The box of one voxel.
    pub fn voxel(ijk: IVec3) -> Self {
        Self { min: ijk, max: ijk }
    }

    /// The cube of `2^log2_dim` voxels per edge whose lowest voxel is `origin`.
    pub fn cube(origin: IVec3, log2_dim: u32) -> Self {
        // Sets the bits below the edge, which cannot overflow because the origin is aligned.
        Self { min: origin, max: origin | ((1 << log2_dim) - 1) }
    }

    /// The smallest box that contains both.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The intersection, unless it is empty.
    pub fn intersection(self, other: Self) -> Option<Self> {
        let both = Self { min: self.min.max(other.min), max: self.max.min(other.max) };
        both.min.cmple(both.max).all().then_some(both)
    }

    /// Whether the voxel lies in the box.
    #[inline]
    pub fn contains(&self, ijk: IVec3) -> bool {
        self.min.cmple(ijk).all() && ijk.cmple(self.max).all()
    }

    /// Voxels per edge, in 64 bits because a box may span the whole 32-bit index space.
    pub fn dim(&self) -> [u64; 3] {
        let axis = |min: i32, max: i32| (i64::from(max) - i64::from(min) + 1) as u64;
        [axis(self.min.x, self.max.x), axis(self.min.y, self.max.y), axis(self.min.z, self.max.z)]
    }
}
