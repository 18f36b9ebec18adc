//! The journal of pages that are finished, for cooking that is interrupted.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::id::PageId;
use super::index::PageEntry;
use crate::cooked::checksum;
use crate::format::cursor::Cursor;

/// The first bytes of a journal; the last four show whether a transfer has changed line ends.
const MAGIC: [u8; 8] = *b"VDBJ\r\n\x1a\n";
/// Bytes of a record: the page, its two sizes, the checksum of its file and that of the record.
const RECORD: usize = 40;
/// A longer journal is not read: no index can list that many pages.
const MOST_BYTES: u64 = (RECORD as u64) << 24;

/// A file with a record of each page that is stored.
pub(super) struct Journal {
    path: PathBuf,
    file: Mutex<File>,
}

/// A page that is stored.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Record {
    pub entry: PageEntry,
    /// The checksum of the page's file.
    pub checksum: u32,
}

impl Journal {
    /// Opens the journal with this signature, or begins one if there is none, and returns its records.
    /// What follows a damaged record is forgotten. While it is open, nobody else can open it.
    pub fn open(path: &Path, signature: &[u8]) -> io::Result<(Self, BTreeMap<PageId, Record>)> {
        let mut head = MAGIC.to_vec();
        head.extend(checksum(signature).to_le_bytes());
        head.extend((signature.len() as u64).to_le_bytes());
        head.extend(signature);
        // Not truncated: the records of an interrupted cooking count.
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(path)?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => {
                return Err(io::Error::other("another program is cooking pages here"));
            }
            // Some file systems cannot lock.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        let old = read(&file)?;
        let (records, length) = match old.strip_prefix(&head[..]) {
            Some(rest) => records(rest),
            None => {
                file.set_len(0)?;
                file.seek(SeekFrom::Start(0))?;
                file.write_all(&head)?;
                (BTreeMap::new(), 0)
            }
        };
        file.set_len((head.len() + length) as u64)?;
        file.seek(SeekFrom::End(0))?;
        Ok((Self { path: path.to_owned(), file: Mutex::new(file) }, records))
    }

    /// Appends a record. It is written after the page, so a page with a record is complete.
    pub fn add(&self, id: PageId, record: &Record) -> io::Result<()> {
        let mut bytes = Vec::with_capacity(RECORD);
        bytes.extend(id.level.to_le_bytes());
        bytes.extend(id.at.to_array().map(i32::to_le_bytes).as_flattened());
        bytes.extend(record.entry.packed_bytes.to_le_bytes());
        bytes.extend(record.entry.file_bytes.to_le_bytes());
        bytes.extend(record.checksum.to_le_bytes());
        bytes.extend(checksum(&bytes).to_le_bytes());
        self.file.lock().unwrap_or_else(PoisonError::into_inner).write_all(&bytes)
    }

    /// Deletes the journal.
    pub fn remove(self) -> io::Result<()> {
        drop(self.file);
        fs::remove_file(self.path)
    }
}

/// The bytes of a journal; none if it is too long for one.
fn read(file: &File) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    if file.metadata()?.len() <= MOST_BYTES {
        file.take(MOST_BYTES).read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}

/// The sound records at the start of bytes, and the number of their bytes.
fn records(bytes: &[u8]) -> (BTreeMap<PageId, Record>, usize) {
    let mut records = BTreeMap::new();
    let all = bytes.as_chunks::<RECORD>().0;
    let sound = all.iter().map_while(|bytes| record(bytes).ok().flatten());
    let mut count = 0;
    for (id, record) in sound {
        count += 1;
        records.insert(id, record);
    }
    (records, count * RECORD)
}

fn record(bytes: &[u8; RECORD]) -> Result<Option<(PageId, Record)>, crate::Error> {
    let mut cursor = Cursor::new(bytes);
    let id = PageId { level: cursor.u32()?, at: cursor.ivec3()? };
    let [packed_bytes, file_bytes] = [cursor.array()?, cursor.array()?].map(u64::from_le_bytes);
    let record = Record { entry: PageEntry { packed_bytes, file_bytes }, checksum: cursor.u32()? };
    let is_sound = cursor.u32()? == checksum(&bytes[..RECORD - 4]);
    Ok(is_sound.then_some((id, record)))
}
