//! Cooking of pages.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::sync::Arc;

use rayon::prelude::*;

use super::counter::Counter;
use super::error::PagesError;
use super::format::is_edge;
use super::id::PageId;
use super::index::{PageEntry, PageIndex, world_from_level};
use super::options::PageOptions;
use super::source::PageSource;
use crate::cooked::{CookError, CookedFile, CookedGrid};
use crate::pack::{PackError, PackKind, PackOptions, PackedGrid};
use crate::{GridClass, Metadata, Transform};

/// Cooking goes on to coarser levels until no more pages than this are left.
const ROOTS: usize = 8;
/// Pages per thread that are cooked before the next are begun, which bounds memory.
const PAGES_PER_THREAD: usize = 2;

/// Where pages are stored.
pub(super) trait PageStore: Sync {
    /// The sizes of a page that is already there, and so is not cooked.
    fn kept(&self, id: PageId) -> Option<PageEntry>;

    /// Stores a page. One without anything to show has no bytes.
    fn store(&self, id: PageId, entry: &PageEntry, bytes: &[u8]) -> io::Result<()>;
}

/// Gets the bytes of the files of pages.
struct Sink<'a>(&'a (dyn Fn(PageId, &[u8]) -> io::Result<()> + Sync));

impl PageStore for Sink<'_> {
    fn kept(&self, _: PageId) -> Option<PageEntry> {
        None
    }

    fn store(&self, id: PageId, entry: &PageEntry, bytes: &[u8]) -> io::Result<()> {
        if entry.file_bytes > 0 { (self.0)(id, bytes) } else { Ok(()) }
    }
}

/// Cooks all pages of a surface, the finest level first. `sink` gets the bytes of each page's file,
/// from several threads at once and in no particular order; a page without anything to show has no
/// file. The index is complete only when all of them are stored, so write it last.
///
/// # Errors
/// If the source is fog or has no surface, a page cannot be made, packed or stored, or the callback
/// cancels.
pub fn cook_pages(
    source: &impl PageSource,
    options: &PageOptions,
    sink: &(dyn Fn(PageId, &[u8]) -> io::Result<()> + Sync),
) -> Result<PageIndex, PagesError> {
    cook_to(source, options, &Sink(sink))
}

/// The kind of the pages, if there can be any.
pub(super) fn checked_kind(
    source: &impl PageSource,
    options: &PageOptions,
) -> Result<PackKind, PagesError> {
    let kind = match source.kind() {
        PackKind::Surface { iso } if options.smooth => PackKind::Smooth { iso },
        PackKind::Fog => return Err(PagesError::Fog { grid: source.name().to_owned() }),
        kind => kind,
    };
    let PageOptions { edge, .. } = *options;
    if is_edge(edge) { Ok(kind) } else { Err(PagesError::Edge { edge }) }
}

/// Cooks all pages that are not yet stored.
pub(super) fn cook_to(
    source: &impl PageSource,
    options: &PageOptions,
    store: &dyn PageStore,
) -> Result<PageIndex, PagesError> {
    let kind = checked_kind(source, options)?;
    let edge = options.edge;
    let grid = || source.name().to_owned();
    let counter = Arc::new(Counter::new(options.progress.clone()));
    let cooking = Cooking { source, options, kind, store, counter };
    let mut pages = BTreeMap::new();
    let mut levels = 0;
    let mut parents = BTreeSet::new();
    while levels < source.levels().max(1) {
        let cooked = cooking.level(levels, &parents)?;
        if cooked.is_empty() {
            return Err(PagesError::Nothing { grid: grid() });
        }
        parents = cooked.keys().map(|id| id.parent()).collect();
        let is_last = cooked.len() <= ROOTS;
        pages.extend(cooked);
        levels += 1;
        if is_last {
            break;
        }
    }
    cooking.counter.finish();
    let world_from_index = source.world_from_index();
    Ok(PageIndex { name: grid(), kind, world_from_index, edge, levels, pages })
}

struct Cooking<'a, S> {
    source: &'a S,
    options: &'a PageOptions,
    kind: PackKind,
    store: &'a dyn PageStore,
    counter: Arc<Counter>,
}

impl<S: PageSource> Cooking<'_, S> {
    /// Cooks the pages of a level. Of those without anything to show, only `parents` are listed.
    fn level(
        &self,
        level: u32,
        parents: &BTreeSet<PageId>,
    ) -> Result<BTreeMap<PageId, PageEntry>, PagesError> {
        let transform =
            Transform::affine(world_from_level(self.source.world_from_index(), self.kind, level));
        let Some(transform) = transform else {
            return Err(PagesError::NotLinear { grid: self.source.name().to_owned() });
        };
        let found = self.source.pages(level, self.options.edge, self.kind);
        let found = found.map_err(|error| PagesError::Source(error.into()))?;
        let mut ids: BTreeSet<_> = found.into_iter().map(|at| PageId { level, at }).collect();
        ids.extend(parents);
        if level == 0 {
            // Every level of a surface has about a quarter of the pages of the level before.
            self.counter.expect(ids.len() as u64 * 4 / 3);
        }
        let ids: Vec<PageId> = ids.into_iter().collect();
        let mut pages = BTreeMap::new();
        for ids in ids.chunks(PAGES_PER_THREAD * rayon::current_num_threads()) {
            let cooked = ids.par_iter().map(|id| Ok((*id, self.page(*id, &transform)?)));
            let cooked: Vec<_> = cooked.collect::<Result<_, PagesError>>()?;
            let is_listed =
                |(id, entry): &(PageId, PageEntry)| entry.file_bytes > 0 || parents.contains(id);
            pages.extend(cooked.into_iter().filter(is_listed));
        }
        Ok(pages)
    }

    /// Cooks and stores a page.
    fn page(&self, id: PageId, transform: &Transform) -> Result<PageEntry, PagesError> {
        if self.counter.add(0).is_break() {
            return Err(PagesError::Cancelled);
        }
        let entry = match self.store.kept(id) {
            Some(entry) => entry,
            None => self.cooked(id, transform)?,
        };
        if self.counter.add(1).is_break() {
            return Err(PagesError::Cancelled);
        }
        Ok(entry)
    }

    fn cooked(&self, id: PageId, transform: &Transform) -> Result<PageEntry, PagesError> {
        let packed = self.packed(id)?;
        let mut entry = PageEntry { packed_bytes: 0, file_bytes: 0 };
        let mut bytes = Vec::new();
        if packed.occupied.is_some() {
            entry.packed_bytes = packed.bytes();
            let file = CookedFile {
                metadata: Metadata::default(),
                grids: vec![CookedGrid {
                    name: self.source.name().to_owned(),
                    class: GridClass::LevelSet,
                    transform: transform.clone(),
                    metadata: Metadata::default(),
                    packed,
                }],
            };
            bytes = file.write().map_err(|error| PagesError::Page { id, source: error.into() })?;
            entry.file_bytes = bytes.len() as u64;
        }
        let stored = self.store.store(id, &entry, &bytes);
        stored.map_err(|source| PagesError::Sink { id, source })?;
        Ok(entry)
    }

    fn packed(&self, id: PageId) -> Result<PackedGrid, PagesError> {
        let PageOptions { edge, format, ref limits, .. } = *self.options;
        let cells = id.cells(edge, 0);
        let mut samples = cells;
        if let PackKind::Smooth { .. } = self.kind {
            // The cells around the page, and the samples at their far corners.
            samples = id.cells(edge, 1);
            let last = samples.max.to_array().map(|c| c.saturating_add(1));
            samples.max = glam::IVec3::from_array(last);
        }
        let tree = self.source.samples(id.level, samples);
        let tree = tree.map_err(|error| PagesError::Source(error.into()))?;
        let options = PackOptions {
            format,
            limits: limits.clone(),
            progress: Some(self.counter.callback()),
            together: None,
            cells: Some(cells),
        };
        PackedGrid::with_options(&tree, self.kind, &options).map_err(|error| match error {
            PackError::Cancelled => PagesError::Cancelled,
            source => {
                let grid = self.source.name().to_owned();
                PagesError::Page { id, source: CookError::Pack { grid, source }.into() }
            }
        })
    }
}
