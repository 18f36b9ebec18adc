//! The pages of a volume that are in memory.

use std::sync::Arc;

use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use vdb_core::pages::{PageId, PageIndex};

/// The pages of a volume that are in memory.
#[derive(Component, Debug, Default)]
pub(super) struct PagesInMemory {
    /// The index that they belong to, as it was loaded.
    pub of: Option<Arc<PageIndex>>,
    pub pages: HashMap<PageId, LoadedPage>,
    /// Pages that could not be loaded, which are not tried again.
    pub failed: HashSet<PageId>,
    /// Whether a warning about one of them has been logged.
    pub has_warned: bool,
    /// Counts updates.
    pub frame: u64,
    /// Updates until Bevy has dropped the pages of an earlier index, whose files may have the same names.
    pub wait: u32,
}

/// A page that is loaded, or being loaded.
#[derive(Debug)]
pub(super) struct LoadedPage {
    pub entity: Entity,
    /// Its size on the GPU.
    pub bytes: u64,
    /// The last update in which a camera needed it.
    pub wanted: u64,
    /// Whether it is on the GPU.
    pub is_ready: bool,
}

impl PagesInMemory {
    pub fn bytes(&self) -> u64 {
        self.pages.values().map(|page| page.bytes).sum()
    }

    pub fn is_ready(&self, id: PageId) -> bool {
        self.pages.get(&id).is_some_and(|page| page.is_ready)
    }

    /// The page that has not been needed for longest; `None` if all are needed in this update.
    pub fn oldest(&self) -> Option<PageId> {
        let unneeded = self.pages.iter().filter(|(_, page)| page.wanted < self.frame);
        // The order of a hash map is random, and what leaves should not be.
        unneeded.min_by_key(|(id, page)| (page.wanted, **id)).map(|(id, _)| *id)
    }
}
