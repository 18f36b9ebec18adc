//! Indexes of pages: what is written comes back, and what is read is sound.

use std::sync::OnceLock;

use arbitrary::{Result, Unstructured};
use glam::{DAffine3, DMat3, DVec3, IVec3};
use vdb_core::Limits;
use vdb_core::cooked::checksum;
use vdb_core::pack::PackKind;
use vdb_core::pages::{FunctionSource, PageEntry, PageId, PageIndex, PageOptions, cook_pages};

use super::{CORNERS, damage};

/// The first bytes of an index.
const MAGIC: &[u8] = b"VDBP";

/// Bytes that an index may have. Everything after reading costs a multiple of that.
const FILE_BYTES: u64 = 1 << 16;

/// Runs an index given by its bytes, or one made of choices that they stand for and damaged.
pub fn pages(bytes: &[u8]) {
    if bytes.starts_with(MAGIC) {
        return read(bytes.to_vec());
    }
    let mut choices = Unstructured::new(bytes);
    let Ok(index) = generate(&mut choices) else { return };
    let mut written = index.write();
    // A transform or a kind that cannot be read is refused. Whatever is read is what was written,
    // with the parents that were missing.
    if let Ok(again) = PageIndex::read(&written, &limits()) {
        assert_eq!(again.write(), written);
        assert_eq!((again.name, again.kind), (index.name, index.kind));
        assert!(index.pages.iter().all(|(id, page)| again.pages.get(id) == Some(page)));
    }
    if damage::damage(&mut written, &mut choices).is_ok() {
        read(written);
    }
}

fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.file_bytes = FILE_BYTES;
    limits.metadata_bytes = FILE_BYTES;
    limits
}

/// An index of any kind, with pages anywhere.
fn generate(choices: &mut Unstructured) -> Result<PageIndex> {
    let iso = *choices.choose(&[0.0, -1.5, f32::MAX, f32::NAN])?;
    let mut index = cooked()?;
    index.name = choices.arbitrary::<&str>()?.to_owned();
    index.world_from_index = transform(choices)?;
    if choices.arbitrary()? {
        index.pages.clear();
    }
    index.kind =
        *choices.choose(&[PackKind::Surface { iso }, PackKind::Smooth { iso }, PackKind::Fog])?;
    index.edge = *choices.choose(&[128, 256, 1024, 0, 130, u32::MAX])?;
    index.levels = choices.int_in_range(0..=26)?;
    for _ in 0..choices.int_in_range(0..=30)? {
        let level = choices.int_in_range(0..=26)?;
        let at = IVec3::new(place(choices)?, place(choices)?, place(choices)?);
        let sizes = [choices.arbitrary::<u16>()?, choices.arbitrary()?].map(u64::from);
        let entry = PageEntry { packed_bytes: sizes[0], file_bytes: sizes[1] };
        index.pages.insert(PageId { level, at }, entry);
    }
    Ok(index)
}

/// The index of a small ball: an index is only made by cooking, which is done once.
fn cooked() -> Result<PageIndex> {
    static COOKED: OnceLock<Option<PageIndex>> = OnceLock::new();
    let cook = || {
        let bounds = [DVec3::splat(-5.0), DVec3::splat(5.0)];
        let ball = FunctionSource::new("ball", DAffine3::IDENTITY, bounds, |p| p.length() - 3.0);
        let options = PageOptions { edge: 128, ..PageOptions::default() };
        cook_pages(&ball, &options, &|_, _| Ok(())).ok()
    };
    COOKED.get_or_init(cook).clone().ok_or(arbitrary::Error::IncorrectFormat)
}

fn place(choices: &mut Unstructured) -> Result<i32> {
    match choices.arbitrary()? {
        true => choices.int_in_range(-9..=9),
        false => Ok(*choices.choose(&CORNERS)?),
    }
}

fn transform(choices: &mut Unstructured) -> Result<DAffine3> {
    let scale = *choices.choose(&[1.0, 0.01, -2.0, 1e-300, 1e300])?;
    let matrix3 = DMat3::from_rotation_x(f64::from(choices.int_in_range(0..=6)?)) * scale;
    Ok(DAffine3 { matrix3, translation: DVec3::splat(*choices.choose(&[0.0, 1e6, -1e300])?) })
}

/// Reads bytes after correcting their checksum, and follows all pages.
fn read(mut bytes: Vec<u8>) {
    let Some((head, rest)) = bytes.split_first_chunk_mut::<16>() else { return };
    head[12..].copy_from_slice(&checksum(rest).to_le_bytes());
    let Ok(index) = PageIndex::read(&bytes, &limits()) else { return };
    assert!(index.name.len() < bytes.len());
    let mut found: Vec<PageId> = index.roots().collect();
    let mut next = 0;
    while let Some(&id) = found.get(next) {
        next += 1;
        found.extend(index.children(id));
    }
    // Each page once, as the reader promises.
    found.sort();
    assert!(found.iter().eq(index.pages.keys()), "not all pages are found");
    for (id, page) in &index.pages {
        let (low, high) = index.index_bounds(*id);
        assert!(low.is_finite() && high.is_finite() && low.cmplt(high).all(), "{low} {high}");
        assert_eq!(index.has_grid(*id), page.file_bytes > 0);
        let _ = (index.world_from_level(id.level), id.file());
    }
    let again = PageIndex::read(&index.write(), &limits());
    assert_eq!(again.as_ref(), Ok(&index));
}
