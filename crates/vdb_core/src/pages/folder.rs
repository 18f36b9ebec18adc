//! Pages in a folder, kept when cooking is interrupted.

use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::UNIX_EPOCH;

use super::cook::{PageStore, checked_kind, cook_to};
use super::error::PagesError;
use super::id::PageId;
use super::index::{PageEntry, PageIndex};
use super::journal::{Journal, Record};
use super::options::PageOptions;
use super::source::PageSource;
use crate::cooked::checksum;
use crate::cooked::signature::VERSION;
use crate::save_bytes;

/// The suffix of the journal's name, after the name of the index.
const JOURNAL: &str = ".cooking";
/// Bytes at the start of a file that its stamp depends on: the unique tag of a `.vdb` file is there, and
/// the head of its first grid.
const STAMPED: u64 = 64 << 10;

/// Pages on disk.
#[derive(Debug)]
#[non_exhaustive]
pub struct PagesOnDisk {
    /// The index, as written.
    pub index: PageIndex,
    /// How many pages were already there, from cooking that was interrupted.
    pub kept: u64,
}

/// Cooks all pages of a surface to the folder of the file `index`, and writes that last. The folder
/// must exist.
///
/// If cooking is interrupted, finished pages stay, and a journal beside the index, with `.cooking` after
/// its name, lists them. Cooking from the same input with the same options then keeps those that are as
/// the journal says, and cooks the rest; the result is the same. `stamp` identifies the input: see
/// [`file_stamp`]. An index that is already there is deleted first, so that an index never refers to
/// pages of another cooking.
///
/// # Errors
/// Those of [`cook_pages`](super::cook_pages), and [`PagesError::Folder`] if the index or the journal
/// cannot be read or written.
pub fn cook_pages_to_disk(
    source: &impl PageSource,
    options: &PageOptions,
    index: impl AsRef<Path>,
    stamp: &[u8],
) -> Result<PagesOnDisk, PagesError> {
    // Before anything is deleted.
    checked_kind(source, options)?;
    let index = index.as_ref();
    let about = |path: &Path| {
        let path = path.to_owned();
        move |source| PagesError::Folder { path, source }
    };
    match fs::remove_file(index) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(about(index)(error)),
        _ => {}
    }
    let mut journal_path = index.as_os_str().to_owned();
    journal_path.push(JOURNAL);
    let journal_path = PathBuf::from(journal_path);
    let (journal, records) = Journal::open(&journal_path, &signature(source, options, stamp))
        .map_err(about(&journal_path))?;
    let folder = Folder {
        path: index.parent().unwrap_or(Path::new("")).to_owned(),
        journal,
        records,
        made: Mutex::default(),
        kept: AtomicU64::new(0),
    };
    let made = cook_to(source, options, &folder)?;
    made.save(index).map_err(about(index))?;
    let Folder { journal, kept, .. } = folder;
    journal.remove().map_err(about(&journal_path))?;
    Ok(PagesOnDisk { index: made, kept: kept.into_inner() })
}

/// Identifies the content of a file by its length, the time of its last change and the checksum of its
/// first 64 KiB, without reading the rest.
///
/// # Errors
/// If the file cannot be read.
pub fn file_stamp(path: impl AsRef<Path>) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let metadata = file.metadata()?;
    // Not every system knows when a file was changed.
    let changed = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    let mut start = Vec::new();
    file.take(STAMPED).read_to_end(&mut start)?;
    let mut stamp = metadata.len().to_le_bytes().to_vec();
    stamp.extend(changed.unwrap_or_default().as_nanos().to_le_bytes());
    stamp.extend(checksum(&start).to_le_bytes());
    Ok(stamp)
}

/// Everything that pages depend on.
fn signature(source: &impl PageSource, options: &PageOptions, stamp: &[u8]) -> Vec<u8> {
    let PageOptions { edge, smooth, format, .. } = options;
    let (name, kind, place) = (source.name(), source.kind(), source.world_from_index());
    let program = env!("CARGO_PKG_VERSION");
    let text = format!(
        "{program} {VERSION} {name:?} {kind:?} {place:?} {edge} smooth {smooth} {format:?} "
    );
    [text.as_bytes(), stamp].concat()
}

/// Pages in a folder, and the journal of those that are finished.
struct Folder {
    path: PathBuf,
    journal: Journal,
    records: BTreeMap<PageId, Record>,
    /// The levels whose folders have been made.
    made: Mutex<HashSet<u32>>,
    kept: AtomicU64,
}

impl Folder {
    /// Whether the file of a page is the one that the journal lists.
    fn is_sound(&self, id: PageId, record: &Record) -> bool {
        let PageEntry { file_bytes, .. } = record.entry;
        let read = || -> io::Result<bool> {
            let file = File::open(self.path.join(id.file()))?;
            if file.metadata()?.len() != file_bytes {
                return Ok(false);
            }
            let mut bytes = Vec::new();
            file.take(file_bytes).read_to_end(&mut bytes)?;
            Ok(bytes.len() as u64 == file_bytes && checksum(&bytes) == record.checksum)
        };
        // A page that cannot be read is cooked again.
        file_bytes == 0 || read().unwrap_or(false)
    }
}

impl PageStore for Folder {
    fn kept(&self, id: PageId) -> Option<PageEntry> {
        let record = self.records.get(&id).filter(|record| self.is_sound(id, record))?;
        self.kept.fetch_add(u64::from(record.entry.file_bytes > 0), Ordering::Relaxed);
        Some(record.entry.clone())
    }

    fn store(&self, id: PageId, entry: &PageEntry, bytes: &[u8]) -> io::Result<()> {
        if entry.file_bytes > 0 {
            let path = self.path.join(id.file());
            let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(folder) = path.parent()
                && made.insert(id.level)
            {
                fs::create_dir_all(folder)?;
            }
            drop(made);
            save_bytes(&path, bytes).map_err(io::Error::other)?;
        }
        let record = Record { entry: entry.clone(), checksum: checksum(bytes) };
        self.journal.add(id, &record)
    }
}
