//! The key of the shaders that traverse grids but do not shade them.

use bevy::shader::ShaderDefVal;

use super::layout::{page_defs, sample_format_def};
use super::materials::kind_defs;
use crate::quality::features::Features;

/// The key of a pipeline variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct TraversalKey {
    pub features: Features,
    /// log₂ of the number of words per page, if the pool has several pages.
    pub page_bits: Option<u32>,
    /// The sample format, if all grids have the same.
    pub sample_format: Option<u32>,
    /// The kinds of custom materials, a bit each.
    pub materials: u32,
}

impl TraversalKey {
    pub fn defs(&self) -> Vec<ShaderDefVal> {
        let features = self.features.defs().map(Into::into);
        features
            .chain(page_defs(self.page_bits))
            .chain(sample_format_def(self.sample_format))
            .chain(kind_defs(self.materials))
            .collect()
    }
}
