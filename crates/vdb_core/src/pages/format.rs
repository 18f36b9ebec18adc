//! Reading and writing of the index.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use glam::DAffine3;

use super::error::PageIndexError;
use super::id::PageId;
use super::index::{PageEntry, PageIndex};
use crate::cooked::checksum;
use crate::cooked::signature::{BadHead, CHECKED_FROM, checked_bytes};
use crate::format::save::save_bytes;
use crate::format::transform;
use crate::pack::PackKind;
use crate::{Limits, Transform};

/// The first bytes of an index; the last four show whether a transfer has changed line ends.
const MAGIC: [u8; 8] = *b"VDBP\r\n\x1a\n";
/// The version of the format.
const VERSION: u32 = 1;
/// Bytes of an entry.
const ENTRY: usize = 32;
/// The VDB file version whose encoding of transforms the index uses.
const TRANSFORM_VERSION: u32 = 224;
/// The most pages of the coarsest level, which are always in memory. Cooking ends at eight.
const MOST_ROOTS: usize = 4096;
/// The most levels: a page of the smallest edge then spans half of the index space.
pub(super) const MOST_LEVELS: u32 = 25;
/// No page takes more bytes: words are numbered in 32 bits.
const MOST_BYTES: u64 = 4 << 32;

impl PageIndex {
    /// Reads an index, and checks that it is whole and sound.
    ///
    /// # Errors
    /// If the bytes are no index of this version, are damaged, list a page without its parent, or
    /// exceed [`Limits::file_bytes`] or [`Limits::metadata_bytes`].
    pub fn read(bytes: &[u8], limits: &Limits) -> Result<Self, PageIndexError> {
        read(bytes, limits)
    }

    /// Serialises the index. Parents that are missing are added, without content of their own.
    pub fn write(&self) -> Vec<u8> {
        write(self)
    }

    /// Writes the index to disk as safely as [`VdbFile::save`](crate::VdbFile::save) does: the path
    /// always has either the old file or the new one. Returns the number of its bytes.
    ///
    /// # Errors
    /// Those of the operating system, without the path.
    pub fn save(&self, path: impl AsRef<Path>) -> io::Result<u64> {
        let bytes = self.write();
        save_bytes(path.as_ref(), &bytes).map_err(io::Error::other)?;
        Ok(bytes.len() as u64)
    }
}

/// Whether pages can have this edge.
pub(super) fn is_edge(edge: u32) -> bool {
    (128..=1024).contains(&edge) && edge.is_multiple_of(128)
}

fn write(index: &PageIndex) -> Vec<u8> {
    let pages = with_parents(index);
    let mut out = Vec::with_capacity(256 + index.name.len() + ENTRY * pages.len());
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    out.extend([0; 4]);
    out.extend((index.name.len() as u32).to_le_bytes());
    out.extend(index.name.as_bytes());
    let (kind, iso) = match index.kind {
        PackKind::Surface { iso } => (0_u32, iso),
        PackKind::Smooth { iso } => (1, iso),
        PackKind::Fog => (2, 0.0),
    };
    out.extend(kind.to_le_bytes());
    out.extend(iso.to_le_bytes());
    write_transform(&mut out, index.world_from_index);
    for number in [index.edge, index.levels, pages.len() as u32] {
        out.extend(number.to_le_bytes());
    }
    for (id, entry) in &pages {
        out.extend(id.level.to_le_bytes());
        out.extend(id.at.to_array().map(i32::to_le_bytes).as_flattened());
        out.extend(entry.packed_bytes.to_le_bytes());
        out.extend(entry.file_bytes.to_le_bytes());
    }
    let sum = checksum(&out[CHECKED_FROM..]);
    out[CHECKED_FROM - 4..CHECKED_FROM].copy_from_slice(&sum.to_le_bytes());
    out
}

/// All pages, and the parents that are missing.
fn with_parents(index: &PageIndex) -> BTreeMap<PageId, PageEntry> {
    let mut pages = index.pages.clone();
    for id in index.pages.keys() {
        let mut id = *id;
        while id.level + 1 < index.levels {
            id = id.parent();
            let none = PageEntry { packed_bytes: 0, file_bytes: 0 };
            pages.entry(id).or_insert(none);
        }
    }
    pages
}

/// Appends a transform as a cooked file has it. A transform that has no inverse is refused when it is
/// read.
fn write_transform(out: &mut Vec<u8>, world_from_index: DAffine3) {
    let written = Transform::affine(world_from_index)
        .is_some_and(|transform| transform::write(out, &transform).is_ok());
    if !written {
        out.extend(0_u32.to_le_bytes());
    }
}

fn read(bytes: &[u8], limits: &Limits) -> Result<PageIndex, PageIndexError> {
    if bytes.len() as u64 > limits.file_bytes {
        let what = format!("{} bytes of an index of pages", bytes.len());
        let limit = limits.file_bytes;
        return Err(PageIndexError::LimitExceeded { what, name: "file_bytes", limit });
    }
    let mut cursor = checked_bytes(bytes, (MAGIC, VERSION), refused)?;
    let name = cursor.string(limits)?;
    let (kind, iso) = (cursor.u32()?, f32::from_bits(cursor.u32()?));
    let kind = match kind {
        0 => PackKind::Surface { iso },
        1 => PackKind::Smooth { iso },
        _ => return Err(PageIndexError::damaged("the kind is not that of a surface")),
    };
    require(iso.is_finite(), "the iso-value is not finite")?;
    let transform = transform::read(&mut cursor, TRANSFORM_VERSION, limits)?;
    let world_from_index =
        transform.linear().ok_or_else(|| PageIndexError::damaged("the transform is a frustum"))?;
    let [edge, levels, count] = [cursor.u32()?, cursor.u32()?, cursor.u32()?];
    require(is_edge(edge), "the page edge is not a multiple of 128 between 128 and 1024")?;
    require((1..=MOST_LEVELS).contains(&levels), "the number of levels is not possible")?;
    require(
        count as usize == cursor.remaining() / ENTRY && cursor.remaining().is_multiple_of(ENTRY),
        "the number of pages is not that of the bytes that follow",
    )?;
    let mut pages = BTreeMap::new();
    let mut last = None;
    for _ in 0..count {
        let id = PageId { level: cursor.u32()?, at: cursor.ivec3()? };
        require(last < Some(id), "pages are listed twice or out of order")?;
        last = Some(id);
        let sizes = [u64::from_le_bytes(cursor.array()?), u64::from_le_bytes(cursor.array()?)];
        pages.insert(id, entry(id, sizes, edge, levels)?);
    }
    let index = PageIndex { name, kind, world_from_index, edge, levels, pages };
    let has_parent = |id: &PageId| id.level + 1 == levels || index.pages.contains_key(&id.parent());
    require(index.pages.keys().all(has_parent), "the parent of a page is not listed")?;
    let has_child = |id: &PageId| {
        id.level > 0 && id.children().iter().any(|child| index.pages.contains_key(child))
    };
    let is_needed = |(id, page): (&PageId, &PageEntry)| page.packed_bytes > 0 || has_child(id);
    require(index.pages.iter().all(is_needed), "a page has nothing to show and covers no other")?;
    require(index.roots().count() <= MOST_ROOTS, "the coarsest level has too many pages")?;
    Ok(index)
}

fn refused(head: BadHead) -> PageIndexError {
    match head {
        BadHead::Foreign => PageIndexError::NotPages,
        BadHead::Version(found) => PageIndexError::Version { found, read: VERSION },
        BadHead::Checksum => PageIndexError::damaged("the checksum is wrong"),
    }
}

/// Checks a page and its sizes.
fn entry(
    id: PageId,
    [packed_bytes, file_bytes]: [u64; 2],
    edge: u32,
    levels: u32,
) -> Result<PageEntry, PageIndexError> {
    require(id.level < levels, "a page belongs to a level that does not exist")?;
    let most = (1_i64 << 32) / (i64::from(edge) << id.level);
    let is_inside = |at: i32| (-most..most).contains(&i64::from(at));
    require(id.at.to_array().into_iter().all(is_inside), "a page is outside of the index space")?;
    require(
        (packed_bytes == 0) == (file_bytes == 0) && packed_bytes.max(file_bytes) <= MOST_BYTES,
        "the sizes of a page are not possible",
    )?;
    Ok(PageEntry { packed_bytes, file_bytes })
}

fn require(holds: bool, fault: &'static str) -> Result<(), PageIndexError> {
    if holds { Ok(()) } else { Err(PageIndexError::damaged(fault)) }
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::*;

    #[test]
    fn all_levels_of_the_smallest_pages_lie_in_the_index_space() {
        let place = |level: u32, at: i32| {
            entry(PageId { level, at: IVec3::splat(at) }, [8, 8], 128, MOST_LEVELS).is_ok()
        };
        assert!(place(0, i32::MIN / 128) && place(0, i32::MAX / 128));
        assert!(place(MOST_LEVELS - 1, -1) && place(MOST_LEVELS - 1, 0));
        assert!(!place(0, i32::MIN / 32) && !place(MOST_LEVELS, 0) && !place(3, i32::MAX));
        for edge in (128..=1024).step_by(128) {
            for level in 0..MOST_LEVELS {
                for at in [i32::MIN, i32::MAX] {
                    let id = PageId { level, at: IVec3::new(0, at, 0) };
                    assert!(entry(id, [8, 8], edge, MOST_LEVELS).is_err(), "{edge} {level} {at}");
                }
            }
        }
    }
}
