//! Pages: level sets larger than the memory of a GPU, cut into pieces at every level of detail.
//!
//! A *page* is a cube of [`PageIndex::edge`] cells of one level of detail. Each page is a
//! [cooked file](crate::cooked) with one packed grid, and a camera needs only those that it sees at
//! the resolution that it can show. A small index, a `.vdbpages` file, lists them. `vdb cook --pages`
//! makes both; `docs/reference/cooked.md` describes the format and what it promises.
//!
//! [`cook_pages`] cuts pages from any [`PageSource`]: a [`TreeSource`] is a tree in memory. A
//! [`FileSource`] reads the nodes of a `.vdb` file where a page needs them, and a [`FunctionSource`]
//! evaluates a signed distance there, so that the whole never has to fit into memory.
//! [`cook_pages_to_disk`] also writes the index, and goes on with cooking that was interrupted.
//!
//! Pages are for surfaces. Fog is refused.
//!
//! # Spaces
//!
//! Level 0 has all samples, and level *l* has every 2^*l*-th of them. In index space of the finest
//! level, sample *i* of level *l* is at
//!
//! - 2^*l* · *i* for a smooth surface;
//! - 2^*l* · *i* + (2^*l* − 1)/2 for a surface of voxels. The voxel then covers exactly the (2^*l*)³
//!   voxels of the finest level that begin with the sample, and voxels of all levels share their
//!   planes.
//!
//! A voxel of a coarse level has the value of the sample in its low corner, so its surface can be off
//! by up to one voxel of that level, on each axis.
//!
//! # Borders
//!
//! Pages do not overlap: a ray meets only the cells of the page itself. Those of a smooth surface
//! are exactly the cells of the whole, and the page also stores the cells around them, which
//! interpolated normals depend on.
//!
//! ```
//! use std::sync::Mutex;
//! use glam::{DAffine3, DVec3};
//! use vdb_core::Limits;
//! use vdb_core::pages::{FunctionSource, PageIndex, PageOptions, cook_pages};
//!
//! let bounds = [DVec3::splat(-110.0), DVec3::splat(110.0)];
//! let ball = FunctionSource::new("ball", DAffine3::IDENTITY, bounds, |p| p.length() - 100.0);
//! let files = Mutex::new(Vec::new());
//! let index = cook_pages(&ball, &PageOptions { edge: 128, ..PageOptions::default() }, &|id, bytes| {
//!     files.lock().unwrap().push((id.file(), bytes.to_vec()));
//!     Ok(())
//! })?;
//! assert_eq!(index.roots().count(), 8);
//! assert_eq!(PageIndex::read(&index.write(), &Limits::default())?, index);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod coarser_file;
mod cook;
mod counter;
mod error;
mod file_source;
mod folder;
mod format;
mod function_source;
mod id;
mod index;
mod journal;
mod options;
mod places;
mod source;
mod surface;
mod tree_source;

pub use crate::format::streamed::{StreamedFile, StreamedGrid};
pub use cook::cook_pages;
pub use error::{PageIndexError, PagesError};
pub use file_source::FileSource;
pub use folder::{PagesOnDisk, cook_pages_to_disk, file_stamp};
pub use function_source::FunctionSource;
pub use id::PageId;
pub use index::{PageEntry, PageIndex};
pub use options::PageOptions;
pub use source::PageSource;
pub use tree_source::TreeSource;

/// The extension of the index of pages.
pub const EXTENSION: &str = "vdbpages";
