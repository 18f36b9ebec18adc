//! Options of cooking.

use std::sync::Arc;

use crate::pack::{PackKind, ValueFormat};
use crate::work::debug_options;
use crate::{Limits, ProgressFn};

/// Options for cooking a file.
#[derive(Clone)]
pub struct CookOptions {
    /// The format of samples. [`ValueFormat::Byte`] by default; the others lose no more than
    /// packing does.
    pub format: ValueFormat,
    /// How grids interact with rays; `None` for the kind that [suits](PackKind::suited) each.
    pub kind: Option<PackKind>,
    /// Whether grids that suit a surface of voxels become smooth surfaces instead.
    pub smooth: bool,
    /// Memory limits, as for [packing](crate::pack::PackOptions::limits). They apply to all grids together.
    pub limits: Limits,
    /// A callback for the progress of packing each of the grids, as in
    /// [`PackOptions::progress`](crate::pack::PackOptions::progress).
    pub progress: Option<Arc<ProgressFn>>,
}

impl Default for CookOptions {
    fn default() -> Self {
        let (format, limits) = (ValueFormat::Byte, Limits::default());
        Self { format, kind: None, smooth: false, limits, progress: None }
    }
}

debug_options!(CookOptions { format, kind, smooth, limits });
