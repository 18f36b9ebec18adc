//! Options for cooking pages.

use std::sync::Arc;

use crate::pack::ValueFormat;
use crate::work::debug_options;
use crate::{Limits, ProgressFn};

/// Options for cooking pages.
#[derive(Clone)]
pub struct PageOptions {
    /// Cells along each edge of a page: a multiple of 128, from 128 to 1024; 256 by default.
    pub edge: u32,
    /// Whether pages become smooth surfaces instead of voxels.
    pub smooth: bool,
    /// The format of the samples of smooth surfaces. [`ValueFormat::Half`] by default, in which
    /// samples that two pages share have the same value. With [`ValueFormat::Byte`], each page has
    /// steps of its own, so the surface may be displaced at borders by a hundredth of a voxel.
    pub format: ValueFormat,
    /// Memory limits, for each page and each level of detail.
    pub limits: Limits,
    /// A callback for progress, in pages, which may cancel the work. The total is estimated from the
    /// number of pages of the finest level.
    pub progress: Option<Arc<ProgressFn>>,
}

impl Default for PageOptions {
    fn default() -> Self {
        let limits = Limits::default();
        Self { edge: 256, smooth: false, format: ValueFormat::Half, limits, progress: None }
    }
}

debug_options!(PageOptions { edge, smooth, format, limits });
