//! The band of a level set, and what is inside.

/// What counts as inside, by the winding number: how often the surface goes around a point, counter-
/// clockwise seen from outside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InsideRule {
    /// Any number but zero, so that parts may be inside out.
    #[default]
    NonZero,
    /// Positive numbers: parts that are inside out cut holes into others.
    Positive,
    /// Odd numbers: a shell within a shell is hollow, whatever the orientation of both.
    Odd,
}

impl InsideRule {
    fn is_inside(self, winding: i32) -> bool {
        match self {
            Self::NonZero => winding != 0,
            Self::Positive => winding > 0,
            Self::Odd => winding % 2 != 0,
        }
    }
}

/// The band of a level set.
pub(super) struct Band {
    /// In voxels.
    pub half_width: f64,
    /// What a voxel is in the units of the values.
    pub scale: f64,
    /// The half width in the units of the values.
    pub background: f32,
    pub inside: InsideRule,
}

impl Band {
    /// The value far from the surface.
    pub(super) fn far(&self, winding: i32) -> f32 {
        if self.inside.is_inside(winding) { -self.background } else { self.background }
    }
}
