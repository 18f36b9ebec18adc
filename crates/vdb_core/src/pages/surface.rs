//! What pages need to know about a grid beside its samples.

use glam::DAffine3;

use super::error::PagesError;
use crate::pack::PackKind;
use crate::{GridClass, Transform};

/// A level set that pages can be cut from.
pub(super) struct Surface {
    pub name: String,
    pub kind: PackKind,
    pub iso: f32,
    /// Whether samples are distances.
    pub is_distance: bool,
    pub world_from_index: DAffine3,
}

impl Surface {
    /// Checks that a grid is a level set with an outside and a linear transform.
    pub fn new(
        name: String,
        class: GridClass,
        kind: PackKind,
        transform: &Transform,
        background: f32,
    ) -> Result<Self, PagesError> {
        let PackKind::Surface { iso } = kind else { return Err(PagesError::Fog { grid: name }) };
        let Some(world_from_index) = transform.linear() else {
            return Err(PagesError::NotLinear { grid: name });
        };
        if background < iso {
            return Err(PagesError::Unbounded { grid: name });
        }
        let is_distance = class == GridClass::LevelSet && iso == 0.0;
        Ok(Self { name, kind, iso, is_distance, world_from_index })
    }
}
