//! Identifiers of packed grids.

use std::any::TypeId;

use bevy::asset::UntypedAssetId;
use bevy::prelude::*;

use crate::{VdbGrid, VdbVectorGrid};

/// Identifies a packed grid: by its asset and, for a float grid, its level of detail (0 is the grid
/// itself) or, for a vector grid, its component.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct GridKey(UntypedAssetId, u32);

impl From<AssetId<VdbGrid>> for GridKey {
    fn from(id: AssetId<VdbGrid>) -> Self {
        Self(id.untyped(), 0)
    }
}

impl GridKey {
    /// The asset.
    pub fn asset(self) -> UntypedAssetId {
        self.0
    }

    /// The asset and the level of detail, for a float grid.
    pub fn float_level(self) -> Option<(AssetId<VdbGrid>, usize)> {
        Some((self.0.try_typed().ok()?, self.1 as usize))
    }

    /// The asset and the number of the component, for a vector grid.
    pub fn vector_part(self) -> Option<(AssetId<VdbVectorGrid>, usize)> {
        Some((self.0.try_typed().ok()?, self.1 as usize))
    }

    /// Whether this is a coarser level of a float grid.
    pub fn is_coarser(self) -> bool {
        self.1 > 0 && self.0.type_id() == TypeId::of::<VdbGrid>()
    }

    /// A level of detail of a float grid.
    pub fn level(self, level: usize) -> Self {
        Self(self.0, level as u32)
    }

    /// Whether this is a float grid itself, or the first component of a vector grid.
    pub fn is_first(self) -> bool {
        self.1 == 0
    }

    /// A component of a vector grid.
    pub fn component(id: AssetId<VdbVectorGrid>, component: u32) -> Self {
        Self(id.untyped(), component)
    }
}
