//! The sections of a packed grid's words, from the numbers of its parts.

use glam::IVec3;

use super::assemble::NOWHERE;
use super::bricks;
use super::detail::FogDetail;
use super::grid::{GridHeader, PackedGrid};
use super::kind::PackKind;
use super::layout::*;
use super::values::Stored;
use crate::tree::CoordBox;

/// Everything about a packed grid except its words. The sections of the words follow from it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Outline {
    pub kind: PackKind,
    pub base: IVec3,
    pub occupied: Option<CoordBox>,
    pub majorant: f32,
    pub top_origin: IVec3,
    pub top_levels: u32,
    /// The sample format; see [`GridHeader::format`].
    pub format: u32,
    pub scale: f32,
    /// Nodes of the top-level tree.
    pub top_nodes: u32,
    pub lower_nodes: u32,
    pub leaves: u32,
    /// Records of a smooth surface.
    pub records: u32,
    /// Words of samples.
    pub sample_words: u32,
    /// Values of tiles.
    pub palette: u32,
}

/// Where the sections of a packed grid are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sections {
    pub header: GridHeader,
    /// Words of the traversal tree and of the records, before the samples.
    pub tree: usize,
    /// The words before the palette.
    pub samples_end: usize,
    /// All words.
    pub all: usize,
}

impl Outline {
    /// The outline of a packed grid that has not been edited.
    pub fn of(grid: &PackedGrid) -> Self {
        let header = grid.header(0);
        let is_sampled = grid.sample_format().is_some();
        let is_smooth = matches!(grid.kind, PackKind::Smooth { .. });
        let after_masks = match grid.kind {
            PackKind::Surface { .. } => header.palette,
            PackKind::Smooth { .. } => header.leaf_records,
            PackKind::Fog => header.samples,
        };
        let after_samples = grid.words.len() as u32 - header.palette;
        let record_words = if is_smooth { header.samples - header.records } else { 0 };
        Self {
            kind: grid.kind,
            base: grid.base,
            occupied: grid.occupied,
            majorant: grid.majorant,
            top_origin: IVec3::from_array(header.top_origin),
            top_levels: header.top_levels,
            format: header.format,
            scale: header.scale,
            top_nodes: header.heads / TOP_WORDS as u32,
            lower_nodes: header.lower_nodes - header.heads,
            leaves: (after_masks - header.masks) / LEAF_MASK_WORDS as u32,
            records: record_words / RECORD_WORDS as u32,
            sample_words: if is_sampled { header.palette - header.samples } else { 0 },
            palette: if is_sampled { after_samples - 1 } else { 0 },
        }
    }

    pub fn is_smooth(&self) -> bool {
        matches!(self.kind, PackKind::Smooth { .. })
    }

    fn is_sampled(&self) -> bool {
        !matches!(self.kind, PackKind::Surface { .. })
    }

    /// The encoding of samples; `None` if the format is unknown.
    pub fn stored(&self) -> Option<Stored> {
        [Stored::Float, Stored::Half, Stored::Byte].into_iter().find(|s| *s as u32 == self.format)
    }

    /// Words of a brick of fog; 0 for surfaces.
    pub fn brick_words(&self) -> usize {
        let stored = self.stored().unwrap_or(Stored::Float);
        if self.kind == PackKind::Fog { bricks::brick_words(stored) } else { 0 }
    }

    /// The sections; `None` if they take more than 2³² words.
    pub fn sections(&self) -> Option<Sections> {
        let mut header = GridHeader {
            top_origin: self.top_origin.to_array(),
            top_levels: self.top_levels,
            occupied_min: self.occupied.unwrap_or(NOWHERE).min.to_array(),
            occupied_max: self.occupied.unwrap_or(NOWHERE).max.to_array(),
            format: self.format,
            brick_words: self.brick_words() as u32,
            scale: self.scale,
            ..GridHeader::default()
        };
        let mut end = 0_u64;
        let mut section = |items: u32, words: usize| {
            let first = end as u32;
            end += u64::from(items) * words as u64;
            first
        };
        header.top = section(self.top_nodes, TOP_WORDS);
        header.heads = section(self.lower_nodes, 1);
        header.lower_nodes = section(self.lower_nodes, LOWER_WORDS);
        header.masks = section(self.leaves, LEAF_MASK_WORDS);
        if self.is_smooth() {
            header.leaf_records = section(self.leaves, 1);
            header.records = section(self.records, RECORD_WORDS);
        }
        let tree = section(self.sample_words, 1);
        header.samples = if self.is_sampled() { tree } else { 0 };
        header.palette = section(self.palette, 1);
        // The last word is padding.
        section(self.is_sampled().into(), 1);
        let all = u32::try_from(end).ok()? as usize;
        Some(Sections { header, tree: tree as usize, samples_end: header.palette as usize, all })
    }

    /// The packed grid of an outline and of words that have been
    /// [checked](super::checked::complete).
    pub fn into_grid(self, header: GridHeader, words: Vec<u32>) -> PackedGrid {
        let Self { kind, base, occupied, majorant, .. } = self;
        let detail = FogDetail::EVEN;
        let grid =
            PackedGrid { kind, base, occupied, words, header, majorant, detail, spare: None };
        bricks::with_detail(grid)
    }
}
